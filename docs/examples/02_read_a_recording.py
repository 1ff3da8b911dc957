"""Read a recording frame by frame and weigh the tubers that its own masks show.

The recording is simulated here; give the path of one of your own instead.
"""

import sys
import tempfile
from pathlib import Path

import tuberline

with tempfile.TemporaryDirectory() as folder:
    if len(sys.argv) > 1:
        recording = tuberline.open_recording(sys.argv[1])
    else:
        recording = tuberline.simulate(Path(folder) / "belt", seed=3, tubers=2, scene="singulated", fps=5, masks=True)
    for camera in recording.cameras:
        print(f"{camera.name}: {camera.intrinsics.width} x {camera.intrinsics.height}, {camera.frames} frames")

    for frame in recording.frames():
        if frame.mask is None:
            print(f"frame {frame.seq} has no masks: tuberline.replay finds the tubers")
            break
        middle = frame.mask[frame.intrinsics.height // 2]
        for label in sorted(set(middle.tolist()) - {0}):
            weight = tuberline.weigh_depth(
                frame.depth,
                mask=frame.mask == label,
                intrinsics=frame.intrinsics,
                depth_scale_m=frame.depth_scale_m,
                belt_distance_m=frame.belt_distance_m if frame.belt_from_camera is None else None,
                belt_from_camera=frame.belt_from_camera,
            )
            print(
                f"frame {frame.seq}, tuber {label}: {weight.weight_g:.1f} g ({weight.low_g:.1f} to {weight.high_g:.1f})"
            )

    for tuber in (recording.truth() or {"tubers": []})["tubers"]:
        print(f"in truth, tuber {tuber['id']}: {tuber['weight_g']:.1f} g")
