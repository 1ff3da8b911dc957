"""Compile the kernels before the node says that it is ready: the first frame must not wait for the compiler."""

from __future__ import annotations

import cv2
import numpy as np

from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import Frame
from segmenter.classify.patch import Patch
from segmenter.outline.body import Body
from segmenter.outline.compare import compare
from segmenter.outline.flanks import risen_m
from segmenter.pipeline import Segmenter, Settings


def warm_up(pixel_mm: float) -> None:
    """Run the core over two frames of two touching boxes on a belt, with one thread per library: every kernel that
    frames of a line call has been called then.
    """
    cv2.setNumThreads(1)
    core = Segmenter(Settings())
    for seq, row in enumerate((40, 44)):
        depth = np.full((160, 200), 460, np.uint16)
        depth[row : row + 24, 80:110] = 420
        depth[row : row + 24, 110:128] = 430
        frame = Frame(
            camera="warmup",
            run="warmup",
            seq=seq,
            captured_ns=seq * 33_000_000,
            travel_m=None,
            depth_scale_m=0.001,
            intrinsics=Intrinsics(200, 160, 460.0 / pixel_mm, 460.0 / pixel_mm, 100.0, 80.0),
            belt_distance_m=None,
            belt_from_camera=straight_down_belt_from_camera(0.46),
            depth=depth,
        )
        # As it comes from the wire: its arrays are read-only, which is another type to the compiler.
        core.step(Frame.decode(frame.encode()))
    # What is asked of a track at its end, and of a tuber seen from two sides, which two frames have none of.
    Patch(observations=1).channels()
    depth_m = np.full((24, 24), 0.42, np.float32)
    body = Body(
        travel_m=0.0,
        belt_from_camera=straight_down_belt_from_camera(0.46),
        camera=np.array([460.0, 460.0, 12.0, 12.0]),
        depth_m=depth_m,
        soft_m=depth_m,
        rim_px=np.full(depth_m.shape, 9.0, np.float32),
        beside=np.zeros(depth_m.shape, np.bool_),
    )
    compare(body, body)
    risen_m(body, body, np.eye(3), np.zeros(3))
