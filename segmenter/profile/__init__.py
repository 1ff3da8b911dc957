"""What a camera's depth is like, measured on its own frames: noise, steps, holes, islands of mismatch, bow."""
