"""PointRAFT: the readable network, its sampling, its fast forms, its checkpoints."""
