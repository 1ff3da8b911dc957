"""Evaluation, baselines, ablations, searches. No node imports them."""
