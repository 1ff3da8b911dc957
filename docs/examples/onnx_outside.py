"""Weigh outside Tuberline: onnxruntime, numpy, and two files that Tuberline wrote.

tuberline export-onnx --out tuberline-sim.onnx
python -c 'import numpy, tuberline; numpy.savez("tuber.npz", **tuberline.prepare("tuber.ply", 0.345).feed())'
python onnx_outside.py tuberline-sim.onnx tuber.npz
"""

import json
import sys

import numpy as np
import onnxruntime

session = onnxruntime.InferenceSession(sys.argv[1], providers=["CPUExecutionProvider"])
about = session.get_modelmeta().custom_metadata_map
names = [output.name for output in session.get_outputs()]

weights = dict(zip(names, session.run(names, dict(np.load(sys.argv[2]))), strict=True))
for weight, low, high in zip(weights["weight_g"], weights["low_g"], weights["high_g"], strict=True):
    print(f"{weight:.1f} g, 90 % interval {low:.1f} to {high:.1f} g")

seen = json.loads(about["ranges"])["weight_g"]
print(f"by {about['model']} ({about['licence']}), trained on tubers of {seen['low']:.0f} to {seen['high']:.0f} g")
