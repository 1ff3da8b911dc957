"""Training of PointRAFT and calibration of its intervals. No node imports it."""
