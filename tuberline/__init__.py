"""Tuberline: counts and weighs every potato on a conveyor, from depth cameras."""
