"""Ask PointRAFT itself: prepare its inputs, call the readable network, compare with what `weigh` says of it."""

import numpy as np
import torch

import tuberline

rng = np.random.default_rng(1)
x, y = rng.uniform(-0.045, 0.045, (2, 6000))
inside = (x / 0.045) ** 2 + (y / 0.035) ** 2
x, y, inside = x[inside < 0.9], y[inside < 0.9], inside[inside < 0.9]
cloud = np.stack([x, y, 0.460 - 0.03 - 0.03 * np.sqrt(1 - inside)], axis=1)

weights = tuberline.load_weights()  # or a .safetensors or .pth file of your own
network: tuberline.PointRaft = weights.network
inputs = tuberline.prepare(cloud, 0.460, weights=weights)
print(f"{weights.model}: {inputs.points.shape} points, {1000 * inputs.height_m:.1f} mm above the belt")

with torch.no_grad():
    grams = network([torch.from_numpy(inputs.points)], torch.tensor([inputs.height_m]))
weight = tuberline.weigh(cloud, belt_distance_m=0.460, weights=weights)
print(f"the network: {grams.item():.2f} g; weigh has it as {weight.network_g:.2f} g")
assert abs(grams.item() - weight.network_g) < 0.01
