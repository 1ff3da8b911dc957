"""A belt of tubers under D405 cameras, with the truth of every one; deterministic by seed."""
