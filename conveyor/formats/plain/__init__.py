"""Depth frames as any camera's software saves them: one file per frame, and the camera's intrinsics beside them."""
