"""A body of known size in view: it tells a mount that moved from a depth scale that drifted."""
