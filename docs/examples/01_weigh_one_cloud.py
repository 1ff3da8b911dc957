"""Weigh one point cloud. The cloud is made here: the upper side of an ellipsoid of 91 x 68 x 58 mm on the belt."""

import numpy as np

import tuberline

BELT_DISTANCE_M = 0.345

# What a camera 345 mm above the belt sees of it: (N, 3), metres, x right, y down, z away from the camera.
x, y = np.meshgrid(np.arange(-0.05, 0.05, 0.0006), np.arange(-0.05, 0.05, 0.0006))
inside = (x / 0.0455) ** 2 + (y / 0.034) ** 2
on_top = inside < 0.9
height_m = 0.029 + 0.029 * np.sqrt(1 - inside[on_top])
cloud = np.stack([x[on_top], y[on_top], BELT_DISTANCE_M - height_m], axis=1)

weight = tuberline.weigh(cloud, belt_distance_m=BELT_DISTANCE_M)

print(f"{weight.weight_g:.1f} g, 90 % interval {weight.low_g:.1f} to {weight.high_g:.1f} g")
print(f"weighed by {weight.method}, {weight.model}; flags: {', '.join(weight.flags) or 'none'}")
print(f"the network alone {weight.network_g:.1f} g, the visible volume alone {weight.volume_g:.1f} g")

# The same from a file: tuberline.weigh("tuber.ply", belt_distance_m=0.345)
