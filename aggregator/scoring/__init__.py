"""A run against the truth: matching by place, alignment, score. No node imports it."""
