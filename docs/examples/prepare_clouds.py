"""Prepare clouds for a network of `tuberline export-onnx`, all in one batch.

python prepare_clouds.py WEIGHTS.safetensors BELT_DISTANCE_M OUT.npz FOLDER
"""

import sys
from pathlib import Path

import numpy as np

import tuberline

weights = tuberline.load_weights(sys.argv[1])
clouds = sorted(Path(sys.argv[4]).rglob("*.ply"))
feeds = [tuberline.prepare(cloud, float(sys.argv[2]), weights=weights).feed() for cloud in clouds]
np.savez(sys.argv[3], **{name: np.concatenate([feed[name] for feed in feeds]) for name in feeds[0]})
print(f"{len(clouds)} clouds in {sys.argv[3]}, for {weights.model}")
