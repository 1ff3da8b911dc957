"""Rerun: draws primitives into a file or a live hub, and starts its programs."""
