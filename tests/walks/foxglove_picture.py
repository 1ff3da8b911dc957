"""A frame of a file for Foxglove with its boxes, drawn by nothing but what the file says: images, calibration,
transforms and scene, read by the mcap package and protobuf's decoder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

NEAREST_M = 0.12
"""The colours span so much above the farthest depth."""


def weights_in(path: Path) -> dict[int, float]:
    """Grams of every tuber that has a box in the file, by its number."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    found: dict[int, float] = {}
    with path.open("rb") as file:
        for *_, update in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(["/tubers"]):
            for entity in update.entities:
                said = {pair.key: float(pair.value) for pair in entity.metadata}
                if "tuber_id" in said:
                    found[int(said["tuber_id"])] = said["weight_g"]
    return found


def foxglove_picture(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) BGR: the frame with most tubers in it, their boxes projected and labelled."""
    best: tuple[int, Any] = (-1, None)
    for state in _states(path):
        seen = sum(bool(_corners(entity, state)) for entity in state["scene"].values())
        if seen > best[0]:
            best = seen, {**state, "scene": dict(state["scene"]), "tf": dict(state["tf"])}
    return _drawn(best[1])


def _states(path: Path) -> Any:
    """What is shown at each depth image."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    state: dict[str, Any] = {"scene": {}, "tf": {}, "calibration": None, "image": None}
    with path.open("rb") as file:
        for _, channel, _, message in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
            topics=["/tubers", "/tf", "/front/depth/image", "/front/depth/calibration"]
        ):
            if channel.topic == "/tubers":
                for gone in message.deletions:
                    state["scene"].pop(gone.id, None)
                state["scene"] |= {entity.id: entity for entity in message.entities if "/tuber/" in entity.id}
            elif channel.topic == "/tf":
                state["tf"][message.child_frame_id] = _matrix(message)
            elif channel.topic.endswith("calibration"):
                state["calibration"] = message
            else:
                state["image"] = message
                if state["calibration"] is not None:
                    yield state


def _matrix(transform: Any) -> NDArray[np.float64]:
    matrix = np.eye(4)
    q, t = transform.rotation, transform.translation
    matrix[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    matrix[:3, 3] = t.x, t.y, t.z
    return matrix


def _corners(entity: Any, state: dict[str, Any]) -> list[tuple[int, int]]:
    """Pixels of the upper face of a box; [] where it is not wholly in the picture."""
    (cube,) = entity.cubes
    p, q, size = cube.pose.position, cube.pose.orientation, cube.size
    turn = Rotation.from_quat([q.x, q.y, q.z, q.w])
    signs = np.array([(1, 1, 1), (1, -1, 1), (-1, -1, 1), (-1, 1, 1)])
    local = turn.apply(signs * [size.x / 2, size.y / 2, size.z / 2]) + np.array([p.x, p.y, p.z])
    belt = state["tf"].get(entity.frame_id, np.eye(4)) @ np.column_stack([local, np.ones(4)]).T
    x, y, z, _ = np.linalg.inv(state["tf"]["camera/front"]) @ belt
    k, image = state["calibration"].K, state["image"]
    u, v = k[0] * x / z + k[2], k[4] * y / z + k[5]
    inside = (u >= 0).all() and (u < image.width).all() and (v >= 0).all() and (v < image.height).all()
    return [(round(float(a)), round(float(b))) for a, b in zip(u, v, strict=True)] if inside else []


def _drawn(state: dict[str, Any]) -> NDArray[np.uint8]:
    image = state["image"]
    depth = np.frombuffer(image.data, "<u2").reshape(image.height, image.width).astype(float)
    farthest = float(np.median(depth[depth > 0]))
    height = np.where(depth > 0, (farthest - depth) / farthest / NEAREST_M, 0.0)
    picture = cv2.applyColorMap((255 * height.clip(0, 1)).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    for entity in state["scene"].values():
        corners = _corners(entity, state)
        if corners:
            cv2.polylines(picture, [np.array(corners)], True, (255, 255, 255), 1, cv2.LINE_AA)
            at = (min(u for u, _ in corners), min(v for _, v in corners) - 4)
            cv2.putText(
                picture, entity.texts[0].text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (255, 255, 255), 1, cv2.LINE_AA
            )
    return np.asarray(picture, np.uint8)
