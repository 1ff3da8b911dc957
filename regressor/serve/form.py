"""Which form of the network a worker computes.

A replay weighs exactly, and gives the same bytes on every machine of a kind. A live line weighs what it has time for:
all of a tuber's centroids have the same neighbours, so most of the second stage's can be left out for a hundredth of a
gram; and where the processor has instructions that make them pay, products of bfloat16 are taken, which cost more
exactness. Which form a machine takes is tried at the start. Every weight that is not exact is flagged with its form.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from numpy.typing import NDArray

from conveyor.config import LineConfig
from conveyor.geometry import Intrinsics, straight_down_belt_from_camera
from conveyor.messages import View
from regressor.network.fast import EXACT, Form, multiplies_bfloat16
from regressor.weigh.prepare import PreparedCloud, prepare_view
from regressor.weigh.weigher import Weigher

FEWEST = (16, 32, 64, None)
"""Second-stage centroids, from the fewest on; None is all of them."""
MOST_OFF_G = 0.1
"""Grams that a form may be off the exact one, in the mean over the made-up tubers."""
WORTH = 0.6
"""bfloat16 must take less than this share of the time without it. What pays does so clearly, and two workers of one
machine shall choose alike."""
ROUNDS = 4
SIZES_M = ((0.030, 0.024, 0.020), (0.040, 0.030, 0.026), (0.055, 0.036, 0.030), (0.062, 0.042, 0.036))
"""Half axes of the made-up tubers, 60 to 400 g."""


def form_of(config: LineConfig, weigher: Weigher) -> Form:
    """The form that `config` asks for; `precision = "auto"` is the exact one, or `fastest` where some camera is live.

    Args:
        weigher: the weights that will be used; without a network there is nothing to choose.
    """
    asked = config.regressor
    if asked.precision in ("float32", "bfloat16"):
        return Form(asked.precision, asked.centroids)
    if asked.precision == "auto" and not config.live:
        return Form(centroids=asked.centroids)
    return fastest(weigher, centroids=asked.centroids)


def fastest(weigher: Weigher, *, centroids: int | None = None) -> Form:
    """The form with the fewest centroids that is at most `MOST_OFF_G` off the exact one, in bfloat16 where that pays.

    bfloat16 is not tried where this processor does not multiply it: it is some thirty times as slow there.

    Args:
        centroids: take so many, whatever they cost.
    """
    near = _nearness(weigher)
    plain = Form(centroids=centroids) if centroids is not None else _fewest(near)
    if not multiplies_bfloat16():
        return plain
    rounded = Form("bfloat16", plain.centroids)
    cloud = prepare_view(made_up_view(*SIZES_M[0]))
    took_s, plain_s = (_seconds(weigher.in_form(form), cloud) for form in (rounded, plain))
    return rounded if took_s < WORTH * plain_s and near(rounded) else plain


def _fewest(near: Callable[[Form], bool]) -> Form:
    return next(form for form in (Form(centroids=count) for count in FEWEST) if near(form))


def _nearness(weigher: Weigher) -> Callable[[Form], bool]:
    """Whether a form is at most `MOST_OFF_G` off the exact one, which weighs once the first form is asked about."""

    @cache
    def exact() -> tuple[list[PreparedCloud], NDArray[np.float64]]:
        clouds = [prepare_view(made_up_view(*half_axes_m)) for half_axes_m in SIZES_M]
        return clouds, _grams(weigher.in_form(EXACT), clouds)

    def near(form: Form) -> bool:
        clouds, grams = exact()
        return bool(np.mean(np.abs(_grams(weigher.in_form(form), clouds) - grams)) <= MOST_OFF_G)

    return near


def made_up_view(along_m: float, across_m: float, up_m: float) -> View:
    """An ellipsoid with these half axes on a belt 0.345 m below a camera of the paper's kind."""
    distance_m, fx, fy = 0.345, 653.8, 652.1
    z_m = distance_m - up_m
    reach_v, reach_u = round(along_m / z_m * fy) + 4, round(across_m / z_m * fx) + 4
    rows, columns = np.mgrid[-reach_v : reach_v + 1, -reach_u : reach_u + 1]
    x_m, y_m = rows * z_m / fy, columns * z_m / fx
    round_off = 1.0 - (x_m / along_m) ** 2 - (y_m / across_m) ** 2
    top_m = up_m * np.sqrt(np.maximum(round_off, 0.0))
    depth = np.where(round_off > 0, np.round((z_m - top_m) * 1000), 0).astype(np.uint16)
    view = View(
        view_id="warm-up/0",
        track_id="warm-up",
        camera="none",
        run="none",
        seq=0,
        captured_ns=0,
        rank=0,
        depth_scale_m=0.001,
        intrinsics=Intrinsics(width=1280, height=720, fx=fx, fy=fy, cx=643.5, cy=366.1),
        u0=643 - reach_u,
        v0=366 - reach_v,
        depth=depth,
        belt_from_camera=straight_down_belt_from_camera(distance_m),
    )
    # As it comes from the wire: its arrays are read-only, which is another type to the compiler.
    return View.decode(view.encode())


def _grams(weigher: Weigher, clouds: Sequence[PreparedCloud]) -> NDArray[np.float64]:
    return np.array([weigher.weigh(cloud).weight_g for cloud in clouds])


def _seconds(weigher: Weigher, cloud: PreparedCloud) -> float:
    """CPU time of a cloud, the best of a few rounds: what else runs on the machine must not choose."""
    took_s = []
    for _ in range(ROUNDS):
        begun = time.thread_time()
        weigher.weigh(cloud)
        took_s.append(time.thread_time() - begun)
    return min(took_s)
