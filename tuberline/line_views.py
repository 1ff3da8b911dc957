"""Views as a line cuts them: whole recordings are simulated, and its segmenter finds, follows and cuts their tubers.

The masks of `simulate-views` are the simulator's own, made worse at random. A line's outlines are its segmenter's: they
follow what the camera saw, and are larger than the silhouette more often than smaller. Rules that only know the former
read a line's small tubers heavy.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camera_sim.sim.conditions import UNKNOWN_SD_M, WORLDS, Conditions, StatedRest
from camera_sim.sim.optics import D405_848, D405_1280
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.scenes import SceneSettings, build_world, in_its_world, layout_named, tuber_of
from camera_sim.sim.source import SimulatedSource, simulated_sources
from camera_sim.sim.tubers import Tuber
from camera_sim.sim.view_setting import TUBERS_PER_RECORDING
from camera_sim.sim.view_truth import UNKNOWN_POSE, rim_of
from camera_sim.sim.viewpack import packed
from camera_sim.sim.views import SimulatedView
from conveyor.config import parse_config
from conveyor.formats.packs.views import PackedView, ViewPackWriter
from conveyor.geometry import belt_distance_m
from conveyor.messages import Frame, View
from segmenter.pipeline import Segmenter, Settings
from segmenter.setup import core_settings
from segmenter.warmup import warm_up
from tuberline.replayer import stated_belt

SCENES = {"singulated": 0.30, "touching": 0.35, "crowded": 0.20, "rolling": 0.15}
FULL_IMAGE_SHARE, FINE_UNIT_SHARE = 0.3, 0.2
"""Of recordings at 1280x720 in place of 848x480, and with a depth unit of 0.1 mm in place of 1 mm."""
DISTANCES_M = (0.30, 0.55)
SPEED_MPS = (0.2, 0.4)
FPS = 15.0
BELT_SDS_MM = (0.5, 1.0, 2.0, 2.0)
"""How well a line's file says that its belt is known; each as likely. A line follows the belt that it sees, so it is
nearer to the truth than that."""
KEPT_FRAMES = 200
"""Whose labels are kept: a tuber 1.5 m away is through the view in 130 of the slowest belt."""
OWN_SHARE = 0.8
"""Of a view's pixels that are of one tuber, so that it is a view of it."""


@dataclass(frozen=True, slots=True)
class LineViewPlan:
    """What a pack of such views shall hold; `distances_m`: any from 0.30 to 0.55 m where none are given."""

    seed: int
    preset: str
    distances_m: tuple[float, ...] = ()


def write_line_views(
    out: Path,
    plan: LineViewPlan,
    *,
    recordings: int,
    command: str,
    on_recording: Callable[[int], None] = lambda _: None,
) -> tuple[int, int]:
    """Simulate that many recordings of 25 tubers and write what the line would weigh; returns how many views and tubers
    there are.
    """
    meta = {"command": command, "seed": plan.seed, "preset": plan.preset, "recordings": recordings}
    tubers = 0
    with ViewPackWriter(out, meta=meta) as writer:
        for number in range(recordings):
            of_tuber: dict[int, list[PackedView]] = {}
            for view in line_views(plan, number):
                of_tuber.setdefault(view.tuber, []).append(view)
            for views in of_tuber.values():
                writer.add(views)
            tubers += len(of_tuber)
            on_recording(number)
    return writer.views, tubers


def line_views(plan: LineViewPlan, number: int) -> Iterator[PackedView]:
    """The views of recording `number`, in the order in which the line closes their tracks; the same whatever was made
    before. Bodies that the line refuses, or takes two of for one, have none.
    """
    drawn = _settings(plan, number)
    layout = layout_named(drawn.scene)
    settings = in_its_world(drawn, layout)
    world = build_world(settings, layout)
    source = simulated_sources(world, settings, layout, masks=True)[0]
    tubers = {body.body_id: tuber_of(body) for body in world.bodies if body.kind == "tuber"}
    for view, mask in _cut(source, _segmenter(source, belt_sd_mm=_belt_sd_mm(drawn))):
        body_id = _shown(view, mask)
        if body_id in tubers:
            yield packed(_seen(view, mask == body_id, tubers[body_id], settings, number=number, body_id=body_id))


def _settings(plan: LineViewPlan, number: int) -> SceneSettings:
    rng = np.random.default_rng([plan.seed, 7, number])
    preset = _one_of(WORLDS, rng) if plan.preset == "worlds" else plan.preset
    optics = D405_1280 if rng.random() < FULL_IMAGE_SHARE else D405_848
    distance_m = rng.choice(plan.distances_m) if plan.distances_m else rng.uniform(*DISTANCES_M)
    return SceneSettings(
        _one_of(SCENES, rng),
        int(rng.integers(1 << 31)),
        TUBERS_PER_RECORDING,
        PRESETS[preset],
        optics=optics,
        fps=FPS,
        belt_distance_m=float(distance_m),
        unit_m=1e-4 if rng.random() < FINE_UNIT_SHARE else 1e-3,
        speed_mps=float(rng.uniform(*SPEED_MPS)),
    )


def _one_of(shares: dict[str, float], rng: np.random.Generator) -> str:
    return str(rng.choice(np.array(list(shares)), p=np.array(list(shares.values()))))


def _belt_sd_mm(settings: SceneSettings) -> float:
    return float(np.random.default_rng([9, settings.seed]).choice(np.array(BELT_SDS_MM)))


def _segmenter(source: SimulatedSource, *, belt_sd_mm: float) -> Settings:
    """As the line's file would have it: embedded defaults, and what the recording states of its belt."""
    camera = source.description.name
    raw = {
        "cameras": {camera: {"path": "recording"}},
        "segmenter": {"belt_sd_mm": belt_sd_mm},
        "belt": stated_belt([source.description]),
    }
    config = parse_config(raw, where="of simulated recordings")
    warm_up(config.segmenter.pixel_mm)
    return core_settings(config)


def _cut(source: SimulatedSource, settings: Settings) -> Iterator[tuple[View, NDArray[np.uint16]]]:
    """Every view that would be weighed, with the labels of its frame: (H, W), 0 where no tuber is."""
    core = Segmenter(settings)
    labels: dict[int, NDArray[np.uint16]] = {}
    for frame in source.frames(run="simulated"):
        if isinstance(frame, Frame) and frame.mask is not None:
            labels[frame.seq] = frame.mask
            for closed in core.step(replace(frame, mask=None)).closed:
                yield from ((view, labels[view.seq]) for view in closed.views)
            labels.pop(frame.seq - KEPT_FRAMES, None)
    for closed in core.finish():
        yield from ((view, labels[view.seq]) for view in closed.views)


def _shown(view: View, mask: NDArray[np.uint16]) -> int:
    """The tuber that a view shows; 0 where it shows none, or others, too."""
    height, width = view.depth.shape
    seen = mask[view.v0 : view.v0 + height, view.u0 : view.u0 + width][view.depth > 0]
    counts = np.bincount(seen, minlength=2)
    most = 1 + int(counts[1:].argmax())
    return most if counts[most] >= OWN_SHARE * len(seen) else 0


def _seen(
    view: View, silhouette: NDArray[np.bool_], tuber: Tuber, settings: SceneSettings, *, number: int, body_id: int
) -> SimulatedView:
    """The view with its truth. How its tuber lies is not said: it may roll."""
    world = settings.conditions or Conditions(settings.preset)
    return SimulatedView(
        depth=view.depth,
        u0=view.u0,
        v0=view.v0,
        depth_scale_m=view.depth_scale_m,
        intrinsics=view.intrinsics,
        belt_distance_m=belt_distance_m(view.belt_from_camera),
        belt_sd_m=view.belt_sd_m,
        v_centre=float(np.nonzero(silhouette)[0].mean()),
        tuber_id=number * 1000 + body_id,
        tuber=tuber,
        resting_m=world.resting_m,
        pose=UNKNOWN_POSE,
        rim=rim_of(view.depth > 0, silhouette),
        recording=number,
        conditions=world,
        stated=settings.stated or StatedRest(0.0, UNKNOWN_SD_M, calibrated=False),
    )
