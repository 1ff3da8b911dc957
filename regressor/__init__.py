"""PointRAFT and everything about it: model, sampling, training, evaluation, the shipped weights, the worker process."""
