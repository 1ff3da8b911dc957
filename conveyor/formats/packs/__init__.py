"""Packs of simulated and labelled data: arrays in .npz shards, and meta.json with a version."""
