"""The segmenter over whole recordings, and its scores. No node imports them."""
