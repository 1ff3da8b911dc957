"""From a prepared cloud to a weight with its interval and flags: what the node and the command line share."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from conveyor.camera_flags import BELT_DISTANCE, CAMERA_NOISE, CAMERA_UNLIKE
from conveyor.camera_range import camera_range
from conveyor.errors import UnsendableError
from conveyor.geometry import TYPICAL_BELT_SD_M
from conveyor.messages import View, Weight
from conveyor.messages.sizes import Sizes
from conveyor.statistics import NORMAL_90
from regressor.network.fast import EXACT, FastPointRaft, Form
from regressor.network.grouping import GatheredGroups, SharedGroups, group_prefix, group_random
from regressor.network.sidecar import Sidecar
from regressor.network.stored import State, load_weights
from regressor.weigh.place import OFF_THE_BELT, distance_fault
from regressor.weigh.prepare import PARTS, PreparedCloud, RefusedCloud, prepare_view
from regressor.weigh.sizes import load_rules, size_features
from regressor.weigh.view_features import view_features
from regressor.weigh.viewscale import view_terms
from regressor.weigh.volume import TYPICAL_RULE

if TYPE_CHECKING:
    from regressor.network.batched import BatchedPointRaft

LIGHTER_PER_MM, MOST_LOST_MM = 0.02, 4.0
"""By how much tubers read lighter for each millimetre that their camera takes off outlines beyond what weights know,
and up to how many that is taken. 136 recordings of `harsh` (seeds 7501 and on) say 3.6 %, standard error 0.7; taken is
what the other world's may have in common with them."""
VOLUME_MODEL = "volume"
SURELY_UNLIKE = 0.75
"""Chance from which on a weight is flagged as one of a camera unlike a good one."""
PARTED = 1.5
"""By how much intervals of views in parts are wider: a gap reads as an outline, so they read 0 to 9 % heavy, and 76 %
of those of `easy` were held without it. Chosen on the seed 9501 of docs/pointraft.md, where others judge it."""
BATCHED = "batched"
"""Flag of a weight whose last digit may depend on the views that it was weighed together with."""


@dataclass(frozen=True, slots=True)
class Weighed:
    """A weight and the 90 % interval of this view alone, grams; `flags` say what was unusual.

    `network_g` and `volume_g` are what it is made of: the network's answer (None without one) and the volume rule's.
    `sizes`: of the whole tuber; None by weights that are only studied.
    """

    weight_g: float
    low_g: float
    high_g: float
    network_g: float | None
    volume_g: float
    method: Literal["pointraft", "volume"]
    model: str
    flags: tuple[str, ...]
    sizes: Sizes | None


class Weigher:
    """One set of weights, ready to weigh; without a network it weighs by volume. On a device: one instance per thread.

    Flags: 'few_points' (at most 1024), 'extent' (0.2 m or more), 'height_clamped' (below the belt, or above the
    weights' limit), 'belt_distance' (outside what the training saw, or farther away than intervals were calibrated),
    'size' and 'weight' (outside what the training saw), 'volume_disagrees' (the visible volume says otherwise),
    'camera_unlike' (noise and holes of a poor camera), 'scraps_cut' (scraps around its outline were cut off),
    'rows_missing' (its camera left out rows or columns; they were filled), 'in_parts' (its outline falls into
    parts, weighed together), 'bfloat16', 'centroids_16' and 'batched' (not computed in the exact form).
    """

    def __init__(self, state: State | None, sidecar: Sidecar, form: Form = EXACT, *, device: str | None = None) -> None:
        """`state`: parameters as `load_weights` gives them; None weighs by volume. `device`: weigh many views at once
        there, as torch names it; None: one by one, on the CPU.

        Raises:
            InputError: this machine does not have that device.
        """
        self.sidecar = sidecar
        self._model_id = sidecar.model_id
        self.trained_on = camera_range(sidecar.worlds)
        self.form = form
        self.device = device
        self._together: BatchedPointRaft | None = None
        if state is not None and device is not None:
            from regressor.network.batched import BatchedPointRaft

            self._together = BatchedPointRaft(state, device=device, points=sidecar.input.points)
        self.state = state
        self._network = FastPointRaft(state, form) if state is not None else None
        self._interval = sidecar.interval_rule
        self._calibrated_belt_m = sidecar.calibrated_belt_m
        self._volume = sidecar.fitted_volume_rule or TYPICAL_RULE
        self._blend = sidecar.blend_rule
        self._group = _grouping(sidecar, form)

    @classmethod
    def load(cls, path: Path | None = None, *, any_target: bool = False) -> Weigher:
        """With the weights at `path`, or the shipped ones; only `any_target` admits a volume.

        Raises:
            InputError: weights that cannot be used.
        """
        return cls(*load_weights(path, any_target=any_target))

    def in_form(self, form: Form) -> Weigher:
        """The same weights, computed in `form`."""
        return self if form == self.form else Weigher(self.state, self.sidecar, form, device=self.device)

    def on(self, device: str | None) -> Weigher:
        """The same weights, computed on `device`."""
        return self if device == self.device else Weigher(self.state, self.sidecar, self.form, device=device)

    def weigh(
        self, cloud: PreparedCloud, *, belt_sd_m: float = TYPICAL_BELT_SD_M, resting_sd_m: float = 0.0
    ) -> Weighed:
        """The weight of one prepared cloud. The same cloud gives the same bits, whatever was weighed before it.

        Args:
            belt_sd_m: how well the belt's height is known, standard deviation: the worse, the wider the interval, and
                the less the height above it counts.
            resting_sd_m: the same of the resting level below it.
        """
        if self._together is not None:
            return self.weigh_many([cloud], belt_sd_m=[belt_sd_m], resting_sd_m=[resting_sd_m])[0]
        return self._weighed(cloud, self.network_g(cloud), math.hypot(belt_sd_m, resting_sd_m))

    def network_g(self, cloud: PreparedCloud) -> float | None:
        """What the network alone says of a cloud, grams, also where `weigh` does not believe it; None without one."""
        if self._network is None:
            return None
        return self._network.weigh(self._group(cloud.points), self._height_m(cloud))

    def weigh_many(
        self, clouds: Sequence[PreparedCloud], *, belt_sd_m: Sequence[float], resting_sd_m: Sequence[float]
    ) -> list[Weighed]:
        """The weights of several clouds, in one pass where there is a device for it."""
        if self._together is None:
            return [
                self.weigh(cloud, belt_sd_m=belt, resting_sd_m=resting)
                for cloud, belt, resting in zip(clouds, belt_sd_m, resting_sd_m, strict=True)
            ]
        heights_m = [self._height_m(cloud) for cloud in clouds]
        if self.sidecar.start.kind == "prefix":
            network_g = self._together.weigh_clouds([cloud.points for cloud in clouds], heights_m)
        else:
            network_g = self._together.weigh([self._group(cloud.points) for cloud in clouds], heights_m)
        return [
            self._weighed(cloud, float(grams), math.hypot(belt, resting))
            for cloud, grams, belt, resting in zip(clouds, network_g, belt_sd_m, resting_sd_m, strict=True)
        ]

    def _height_m(self, cloud: PreparedCloud) -> float:
        return cloud.clamped_height_m(self.sidecar.input.max_height_m)

    def _weighed(self, cloud: PreparedCloud, network_g: float | None, level_sd_m: float) -> Weighed:
        """The weight with its interval, sizes and flags, from the network's answer."""
        features = features_of(cloud, level_sd_m)
        by_volume_g = float(self._volume.weights_g(features)[0])
        if network_g is None or not np.isfinite(network_g) or network_g <= 0:
            failed = () if network_g is None else ("network_failed",)
            return self._by_volume(cloud, by_volume_g, failed, level_sd_m=level_sd_m)
        parts = np.array([network_g]), np.array([by_volume_g])
        weight_g = float(self._blend.weights_g(*parts, features)[0])
        terms = _terms(cloud, weight_g, network_g, by_volume_g, level_sd_m)
        unlike = self._unlike(cloud)
        low, high = _parted(cloud, weight_g, *self._bounds(weight_g, terms, unlike, cloud.belt_distance_m))
        form = self.form.flags if self._together is None else (BATCHED,)
        return Weighed(
            weight_g=round(weight_g, 3),
            low_g=round(low, 3),
            high_g=round(high, 3),
            network_g=round(network_g, 3),
            volume_g=round(by_volume_g, 3),
            method="pointraft",
            model=self._model_id,
            flags=(*cloud.flags, *self._out_of_range(cloud, network_g, by_volume_g, unlike), *form),
            sizes=_sizes(cloud, terms),
        )

    def _by_volume(
        self, cloud: PreparedCloud, weight_g: float, failed: tuple[str, ...], *, level_sd_m: float
    ) -> Weighed:
        factor = float(np.exp(NORMAL_90 * max(self._volume.residual_ln_sd, 0.05)))
        low, high = _parted(cloud, weight_g, weight_g / factor, weight_g * factor)
        return Weighed(
            weight_g=round(weight_g, 3),
            low_g=round(low, 3),
            high_g=round(high, 3),
            network_g=None,
            volume_g=round(weight_g, 3),
            method="volume",
            model=VOLUME_MODEL,
            flags=(*cloud.flags, *failed, *self._out_of_range(cloud, None, weight_g, self._unlike(cloud))),
            sizes=_sizes(cloud, _terms(cloud, weight_g, weight_g, weight_g, level_sd_m)),
        )

    def _unlike(self, cloud: PreparedCloud) -> float:
        """The chance that a camera unlike a good one took this view."""
        if self._interval is None:
            return 0.0
        noise_px = np.array([np.nan if cloud.noise_px is None else cloud.noise_px])
        return float(self._interval.unlike(noise_px, cloud.surface.as_array()[None])[0])

    def _bounds(
        self, weight_g: float, terms: NDArray[np.float64], unlike: float, distance_m: float
    ) -> tuple[float, float]:
        if self._interval is None:
            # Nothing is calibrated (an imported checkpoint): the paper's RMSE of a tenth, said generously.
            return 0.7 * weight_g, 1.3 * weight_g
        low, high = self._interval.bounds_g(np.array([weight_g]), terms[None], np.array([unlike]), distance_m)
        return float(low[0]), float(high[0])

    def _out_of_range(
        self, cloud: PreparedCloud, network_g: float | None, by_volume_g: float, unlike: float
    ) -> tuple[str, ...]:
        """Flags of what the training did not see. Without the network (None) nothing is clamped, and nothing disagrees
        with the rule.
        """
        sidecar, factor = self.sidecar, self.sidecar.disagreement_factor
        checks = {
            "height_clamped": network_g is None or 0.0 <= cloud.height_m <= sidecar.input.max_height_m,
            BELT_DISTANCE: self._calibrated_belt_m.holds(cloud.belt_distance_m),
            "size": sidecar.length_mm.holds(cloud.surface.length_mm),
            "weight": sidecar.weight_g.holds(by_volume_g if network_g is None else network_g),
            "volume_disagrees": network_g is None or 1 / factor <= network_g / by_volume_g <= factor,
            CAMERA_UNLIKE: unlike <= SURELY_UNLIKE,
        }
        return tuple(name for name, fine in checks.items() if not fine)


def _parted(cloud: PreparedCloud, weight_g: float, low: float, high: float) -> tuple[float, float]:
    """The interval from `low` to `high`, wider where the view is in parts."""
    if PARTS not in cloud.flags:
        return low, high
    return max(weight_g - PARTED * (weight_g - low), 0.0), weight_g + PARTED * (high - weight_g)


def features_of(cloud: PreparedCloud, level_sd_m: float) -> NDArray[np.float64]:
    """(1, 37) of `VIEW_NAMES`, over a resting level with that standard deviation."""
    noise_px = np.nan if cloud.noise_px is None else cloud.noise_px
    return view_features(cloud.surface.as_array()[None], [noise_px], [level_sd_m])


def _terms(
    cloud: PreparedCloud, weight_g: float, network_g: float, by_volume_g: float, level_sd_m: float
) -> NDArray[np.float64]:
    """(6,) of `view_terms`."""
    weight, network, by_volume, height, level_sd = (
        np.array([value]) for value in (weight_g, network_g, by_volume_g, cloud.height_m, level_sd_m)
    )
    terms = view_terms(weight, network, by_volume, cloud.surface.as_array()[None], height, level_sd)
    return np.asarray(terms[0], np.float64)


def _sizes(cloud: PreparedCloud, terms: NDArray[np.float64]) -> Sizes:
    return load_rules().sizes(size_features(cloud), terms, distance_m=cloud.belt_distance_m)


def _grouping(sidecar: Sidecar, form: Form) -> Callable[[NDArray[np.float32]], SharedGroups | GatheredGroups]:
    points, start = sidecar.input.points, sidecar.start
    if start.kind == "prefix":
        return lambda cloud: group_prefix(cloud, points=points, centroids=form.centroids)
    return lambda cloud: group_random(cloud, seed=start.seed, points=points)


def weigh_view(weigher: Weigher, view: View, *, regressor: str) -> Weight:
    """The answer to `view`: a weight, or a refusal with its reason."""
    return weigh_views(weigher, [view], regressor=regressor)[0]


def weigh_views(weigher: Weigher, views: Sequence[View], *, regressor: str) -> list[Weight]:
    """The answers to `views`, in their order."""
    prepared = [_prepared(view) for view in views]
    fit = [(view, cloud) for view, cloud in zip(views, prepared, strict=True) if isinstance(cloud, PreparedCloud)]
    weighed = weigher.weigh_many(
        [cloud for _, cloud in fit],
        belt_sd_m=[view.belt_sd_m for view, _ in fit],
        resting_sd_m=[view.resting_sd_m for view, _ in fit],
    )
    found = iter(weighed)
    return [
        _refusal(weigher, view, regressor=regressor, reason=cloud.reason)
        if isinstance(cloud, RefusedCloud)
        else _answer(weigher, view, next(found), regressor=regressor)
        for view, cloud in zip(views, prepared, strict=True)
    ]


def _prepared(view: View) -> PreparedCloud | RefusedCloud:
    """The view's cloud, or why it cannot be weighed."""
    try:
        cloud = prepare_view(view)
    except RefusedCloud as refusal:
        return refusal
    fault = distance_fault(cloud)
    return RefusedCloud(OFF_THE_BELT, fault) if fault else cloud


def _answer(weigher: Weigher, view: View, weighed: Weighed, *, regressor: str) -> Weight:
    heavier = math.exp(LIGHTER_PER_MM * min(view.outline_lost_mm, MOST_LOST_MM))
    weight = Weight(
        view_id=view.view_id,
        track_id=view.track_id,
        camera=view.camera,
        run=view.run,
        seq=view.seq,
        status="weighed",
        weight_g=round(weighed.weight_g * heavier, 3),
        low_g=round(weighed.low_g * heavier, 3),
        high_g=round(weighed.high_g * heavier, 3),
        method=weighed.method,
        model=weighed.model,
        flags=(*weighed.flags, *_camera_flags(weigher, view)),
        regressor=regressor,
        sizes=weighed.sizes,
    )
    try:
        weight.check()
    except UnsendableError:
        return _refusal(weigher, view, regressor=regressor, reason="out_of_range")
    return weight


def _camera_flags(weigher: Weigher, view: View) -> tuple[str, ...]:
    """What is out of the weights' range of the camera that took the view."""
    return (CAMERA_NOISE,) if weigher.trained_on.noisier(view.camera_noise_px) else ()


def _refusal(weigher: Weigher, view: View, *, regressor: str, reason: str) -> Weight:
    return Weight(
        view_id=view.view_id,
        track_id=view.track_id,
        camera=view.camera,
        run=view.run,
        seq=view.seq,
        status="refused",
        weight_g=None,
        low_g=None,
        high_g=None,
        method="pointraft",
        model=weigher.sidecar.model_id,
        flags=(),
        regressor=regressor,
        reason=reason,
    )
