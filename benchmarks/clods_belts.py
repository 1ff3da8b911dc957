"""Belts with and without clods under several cameras, and what the classifier says of each track on them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from camera_sim.sim.conditions import FINE_SHARE, MID_SHARE, draw_conditions
from camera_sim.sim.presets import PRESETS
from camera_sim.sim.scenes import SceneSettings, build_world, in_its_world, layout_named
from camera_sim.sim.source import EPOCH_NS, crossing_place, simulated_sources, truth_of
from camera_sim.sim.stereo import EASY, FIELD, NoiseBank, StereoNoise, measure
from camera_sim.sim.stereo_faults import bowed_field
from camera_sim.sim.world import World, render
from conveyor.messages import Frame
from segmenter.pipeline import ClosedTrack, Segmenter, Settings
from segmenter.studies.distractors import WITHIN_M
from segmenter.track.counting import CountSettings

NOISY_PX = 0.12
"""Local noise of the worst camera that was measured (D435 at 0.45 m)."""


@dataclass(frozen=True, slots=True)
class Body:
    """One classified track in the order of decisions: what it truly is ('tuber', a distractor's kind, or 'part' of a
    tuber that is counted already), and the network's eight answers; none where it was not asked.
    """

    kind: str
    answers: tuple[float, ...] = ()
    spread_mm: float = 0.0
    error_mm: float = 0.0
    hole_share: float = 0.0
    observations: int = 0


@dataclass(frozen=True, slots=True)
class Passage:
    """One belt under one camera: all tracks of a tuber's size and shape, and how many tubers crossed."""

    scene: str
    preset: str
    seed: int
    camera: str
    local_px: float
    tubers: int
    bodies: tuple[Body, ...]


def cameras(seed: int) -> dict[str, tuple[float, StereoNoise]]:
    """(local noise in pixels, camera) by name; the last is drawn as those of `harsh` are, at its true scale."""
    drawn = draw_conditions("harsh", np.random.default_rng([seed, 77]))
    noisy = replace(
        FIELD, fine_px=FINE_SHARE * NOISY_PX, mid_px=MID_SHARE * NOISY_PX, bare=0.05, blob_px=5, islands=10.0
    )
    return {
        "easy": (0.026, EASY),
        "field": (0.032, FIELD),
        "noisy": (NOISY_PX, noisy),
        "harsh": (drawn.local_px or 0.0, replace(drawn.preset.noise, drift_px=0.0, scale=1.0)),
    }


def passages(scene: str, preset: str, seed: int, tubers: int) -> Iterator[Passage]:
    """One belt under each camera; a frame is rendered once for all of them."""
    layout = layout_named(scene)
    settings = in_its_world(SceneSettings(scene=scene, seed=seed, tubers=tubers, preset=PRESETS[preset]), layout)
    world = build_world(settings, layout)
    (source,) = simulated_sources(world, settings, layout)
    truth = truth_of(world, [source])
    crossing = [body for body in world.bodies if _is_in(truth, body.kind, world, body)]
    own = cameras(seed)
    if settings.conditions is not None:
        own = {"own": (settings.conditions.local_px or 0.0, settings.preset.noise)}
    every = Settings(count=CountSettings(reject_below=-np.inf))
    cores = {name: Segmenter(every) for name in own}
    closed: dict[str, list[ClosedTrack]] = {name: [] for name in own}
    for frames in _frames(world, settings, {name: noise for name, (_, noise) in own.items()}):
        for name, frame in frames.items():
            closed[name] += cores[name].step(frame).closed
    places = np.array([crossing_place(world, body, world.cameras[0].name)[:2] for body in crossing]).reshape(-1, 2)
    kinds = [body.kind for body in crossing]
    for name, core in cores.items():
        tracks = closed[name] + core.finish()
        bodies = _labelled(tracks, places, kinds)
        yield Passage(scene, preset, seed, name, own[name][0], kinds.count("tuber"), bodies)


def _is_in(truth: dict[str, Any], kind: str, world: World, body: Any) -> bool:
    """The body is one of those that cross the camera's centre row."""
    x_m, y_m = crossing_place(world, body, world.cameras[0].name)[:2]
    rows = truth["tubers"] if kind == "tuber" else truth["distractor_places"]
    return any(abs(row["place_x_m"] - x_m) < 1e-4 and abs(row["place_y_m"] - y_m) < 1e-4 for row in rows)


def _frames(world: World, settings: SceneSettings, noises: dict[str, StereoNoise]) -> Iterator[dict[str, Frame]]:
    """Each frame as every camera measures it."""
    pose = world.cameras[0]
    k = pose.optics.intrinsics
    bank = NoiseBank(np.random.default_rng([settings.seed, 20, 1]), height=k.height, width=k.width)
    bow = bowed_field(np.random.default_rng([settings.seed, 20, 3]), height=k.height, width=k.width)
    (source,) = simulated_sources(world, settings, layout_named(settings.scene))
    d = source.description
    for seq in range(int((world.motion.duration_s - pose.phase_s) * pose.fps)):
        time_s = pose.phase_s + seq / pose.fps
        travel_m = world.motion.travel_at(time_s)
        true_m = (1 / render(world, pose, travel_m, time_s=time_s).inverse_depth).astype(np.float32)
        frames = {}
        for number, (name, noise) in enumerate(noises.items()):
            depth = measure(
                true_m, focal_px=k.fx, unit_m=settings.unit_m, noise=noise, bank=bank,
                rng=np.random.default_rng([settings.seed, 20, 2, seq, number]), bow=bow if noise.bow_px else None,
            )  # fmt: skip
            frames[name] = Frame(
                camera=d.name, run="clods", seq=seq, captured_ns=EPOCH_NS + round(time_s * 1e9),
                travel_m=round(travel_m, 5), depth_scale_m=d.depth_scale_m, intrinsics=k,
                belt_distance_m=d.belt_distance_m, depth=depth, belt_from_camera=d.belt_from_camera,
                mask=None, color_jpeg=None,
            )  # fmt: skip
        yield frames


def _labelled(tracks: list[ClosedTrack], places: Any, kinds: list[str]) -> tuple[Body, ...]:
    """What each track is: the nearest body within reach; a second track of one body is a part of it."""
    taken: set[int] = set()
    bodies = []
    for closed in tracks:
        away = np.hypot(places[:, 0] - closed.track.place_x_m, places[:, 1] - closed.track.y_m)
        nearest = int(away.argmin())
        kind = kinds[nearest] if away[nearest] <= WITHIN_M and nearest not in taken else "part"
        taken.add(nearest)
        answer = closed.answer
        if answer is None:
            bodies.append(Body(kind))
        else:
            bodies.append(Body(kind, answer.evidence.answers, **asdict(answer.evidence.noise)))
    return tuple(bodies)
