"""Totals of a load: weight with its interval, count, size classes, rate, and what the unseen belt adds.

Where tickets are at hand the load's weight is calibrated by them; the tubers in the ledger stay as weighed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from aggregator.calibration.apply import Calibrated, calibrated, camera_sd, parts_percent
from aggregator.calibration.correction import Prior
from aggregator.calibration.tickets import Ticket
from aggregator.core.layers import Hidden, hidden
from aggregator.core.load_sums import LoadSums
from aggregator.core.reasons import LoadState
from conveyor.messages import CameraExchanged, CamerasApart, ClassTotal, ForeignTotal, LoadNow, Totals
from conveyor.statistics import NORMAL_90

UNSEEN_SPREAD = 0.5
"""Half of the 90 % interval of the weight on belt that was not looked at, as a share of it: the belt is not loaded
evenly. What the count's own chance adds comes on top."""

LEAST_COVERAGE = 1e-9
"""Of a share smaller than that no whole is computed: it would not be a finite number."""

TUBER_M = 0.1
"""Belt under one tuber."""

UNEVEN = 0.7
"""Of the load of one metre of belt, standard deviation as a share of the mean, one metre independent of the next: an
assumption; it widens the interval where little belt was seen, or little was not."""

MEAN_TUBER_G, MEAN_SQUARE_G2 = 172.0, 4.0e4
"""Of a tuber of which nothing is known (3DPotatoTwin: 172 g in the mean, standard deviation about 100 g)."""

NONE_SEEN = 3.0
"""Tubers, for where none was seen: were there more on as much belt, none is seen in one case of twenty at most. A
normal law says 1.6: four of 40 live lines that saw 2 % of their belt and no tuber told too little."""


class LoadTotals:
    """What the sums of a load come to. `tickets` of earlier loads calibrate its weight."""

    def __init__(
        self,
        sums: LoadSums,
        tickets: Sequence[Ticket] = (),
        *,
        prior: Prior | None = None,
        cultivar: str = "",
    ) -> None:
        self.sums = sums
        self._tickets = tickets
        self._prior = prior or Prior()
        self._cultivar = cultivar
        self._calibrated: tuple[int, Calibrated] | None = None

    def calibrated(self) -> Calibrated:
        """What was seen by the tickets of its weights; without any, as weighed and as wide as what is not known."""
        if self._calibrated is None or self._calibrated[0] != self.sums.count:
            found = calibrated(
                {key: grams for key, (_, grams) in self.sums.weighed.items()},
                per_mm_g=self.sums.per_mm_g,
                camera_sd=camera_sd(self.sums.camera_doubt()),
                own_variance_g2=(self.sums.low_variance_g2, self.sums.high_variance_g2),
                tickets=self._tickets,
                prior=self._prior,
                cultivar=self._cultivar,
            )
            self._calibrated = self.sums.count, found
        return self._calibrated[1]

    @property
    def weight_g(self) -> float:
        """What was seen, calibrated where there are tickets."""
        return self.calibrated().weight_g

    @property
    def scale(self) -> float:
        """By what calibration multiplies what was weighed; 1 where nothing was."""
        raw_g = self.sums.as_weighed_g
        return self.weight_g / raw_g if raw_g > 0 else 1.0

    @property
    def tickets_used(self) -> int:
        """Tickets of the weights that weighed this load; 0: it is not calibrated."""
        return self.calibrated().tickets

    def hidden(self) -> Hidden:
        """What lies under others, as far as the tubers that lie on them tell."""
        return hidden(self.sums.layers, count=self.sums.count, scale=self.scale)

    def unshared_sd_g(self, coverage: float | None, *, belt_m: float | None) -> float:
        """Standard deviation of what a ticket's load does not share with others: belt that was not seen, and what lies
        under others, for another heap may be looser.
        """
        whole, under = self.whole(coverage, belt_m=belt_m), self.hidden()
        missed_sd_g = self.missed_g(coverage, belt_m=belt_m) / NORMAL_90
        return math.hypot(missed_sd_g, whole * under.weight_sd_g, whole * under.support_sd_g)

    def own_error_g(self) -> tuple[float, float]:
        """90 % half-widths, below and above, of the errors that tubers have for themselves, as weighed."""
        return NORMAL_90 * math.sqrt(self.sums.low_variance_g2), NORMAL_90 * math.sqrt(self.sums.high_variance_g2)

    def interval_g(self) -> tuple[float, float]:
        """The 90 % interval of the weight seen: each tuber's own error, and what all of them share.

        What lies under others passed the camera too: where tubers do, the interval reaches up to all of it.
        """
        low_g, high_g = self._seen_g()
        return low_g, max(high_g, self.estimated(None)[2]) if self.hidden().weight_g > 0 else high_g

    def _seen_g(self) -> tuple[float, float]:
        """The same without what lies under others."""
        seen, on_others_g = self.calibrated(), self.hidden().support_sd_g
        low_sd_g, high_sd_g = math.hypot(seen.low_sd_g, on_others_g), math.hypot(seen.high_sd_g, on_others_g)
        return max(0.0, seen.weight_g - NORMAL_90 * low_sd_g), seen.weight_g + NORMAL_90 * high_sd_g

    def estimated(
        self, coverage: float | None, *, belt_m: float | None = None, most_m: float | None = None
    ) -> tuple[float, float, float]:
        """(weight, low, high) in grams for the whole belt: seen and hidden, over the share that was looked at.

        The unseen part is known to `UNSEEN_SPREAD`, as evenly as the belt's metres are loaded (`UNEVEN`), and as the
        numbers of tubers seen and not seen allow: with n seen and m expected unseen, m scatters by
        sqrt(m + m^2 / (n + 1)). Where no belt was looked at there is no estimate: it is what was seen; but the belt
        under a tuber that was counted was. Where it is not known how far the belt moved (`most_m` metres at most), the
        estimate is what was seen too, and the interval reaches up to a belt of that length loaded as what was seen.
        """
        if coverage is None and most_m and self.sums.count:
            seen_m = TUBER_M * self.sums.count
            high_g = self.estimated(min(1.0, seen_m / most_m), belt_m=most_m)[2]
            there_g, low_g, seen_high_g = self.estimated(None)
            return there_g, low_g, max(high_g, seen_high_g)
        (low_g, high_g), under = self._seen_g(), self.hidden()
        there_g, whole = self.weight_g + under.weight_g, self.whole(coverage, belt_m=belt_m)
        hidden_g = NORMAL_90 * under.weight_sd_g
        below_g, above_g = math.hypot(self.weight_g - low_g, hidden_g), math.hypot(high_g - self.weight_g, hidden_g)
        if whole == 1.0:
            return there_g, max(0.0, there_g - below_g), there_g + above_g
        missed_g = self.missed_g(coverage, belt_m=belt_m)
        below_g, above_g = math.hypot(below_g * whole, missed_g), math.hypot(above_g * whole, missed_g)
        return whole * there_g, max(low_g, whole * there_g - below_g), whole * there_g + above_g

    def whole(self, coverage: float | None, *, belt_m: float | None) -> float:
        """By what the weight that was seen is multiplied for that of the whole belt; 1 where no belt was looked at."""
        if coverage is not None and self.sums.count and belt_m:
            coverage = max(coverage, TUBER_M / belt_m)
        return 1.0 / max(coverage, LEAST_COVERAGE) if coverage and coverage < 1.0 else 1.0

    def missed_g(self, coverage: float | None, *, belt_m: float | None) -> float:
        """90 % half-width of the weight on belt that was not looked at."""
        whole = self.whole(coverage, belt_m=belt_m)
        if whole == 1.0:
            return 0.0
        seen, unseen_g = 1.0 / whole, (whole - 1.0) * (self.weight_g + self.hidden().weight_g)
        spread = UNSEEN_SPREAD
        if belt_m:
            spread = math.hypot(spread, NORMAL_90 * UNEVEN / math.sqrt(belt_m * seen * (1.0 - seen)))
        return math.hypot(spread * unseen_g, self._chance_g(seen))

    def _chance_g(self, coverage: float) -> float:
        """90 % half-width of the unseen weight by the chance of how many tubers lay on belt seen and not seen."""
        odds = (1.0 - coverage) / coverage
        unseen = self.sums.count * odds
        if not self.sums.count:
            return math.hypot(NONE_SEEN * odds * MEAN_TUBER_G, NORMAL_90 * math.sqrt(odds * MEAN_SQUARE_G2))
        mean_g = self.weight_g / self.sums.count
        square_g2 = self.sums.mean_square_g2 or MEAN_SQUARE_G2
        return NORMAL_90 * math.sqrt(max(unseen, odds) * square_g2 + (self.sums.count + 1) * (odds * mean_g) ** 2)

    def message(
        self,
        run: str,
        *,
        coverage: float | None,
        cameras: Mapping[str, str],
        final: bool,
        state: LoadState = LoadState.COUNTING,
        reason: str = "",
        belt_m: float | None = None,
        most_m: float | None = None,
        unseen_m: Mapping[str, float] | None = None,
        load: LoadNow | None = None,
        contract: str = "",
        classes: tuple[ClassTotal, ...] = (),
        foreign: ForeignTotal | None = None,
        apart: tuple[CamerasApart, ...] = (),
        exchanged: tuple[CameraExchanged, ...] = (),
        now_ns: int | None = None,
    ) -> Totals:
        """The totals as published; `most_m` as in `estimated`, `now_ns` as in `LoadSums.tubers_per_s`."""
        low_g, high_g = self.interval_g()
        estimated_g, estimated_low_g, estimated_high_g = self.estimated(coverage, belt_m=belt_m, most_m=most_m)
        seen, under = self.calibrated(), self.hidden()
        return Totals(
            run=run,
            count=self.sums.count,
            weight_g=seen.weight_g,
            low_g=low_g,
            high_g=high_g,
            coverage=coverage,
            estimated_weight_g=estimated_g,
            estimated_low_g=estimated_low_g,
            estimated_high_g=estimated_high_g,
            tubers_per_s=self.sums.tubers_per_s(now_ns),
            histogram_step_g=self.sums.histogram_step_g,
            histogram=tuple(self.sums.classes),
            cameras=dict(cameras),
            final=final,
            as_weighed_g=self.sums.as_weighed_g,
            tickets=seen.tickets,
            state=state.value,
            reason=reason,
            belt_m=belt_m,
            unseen_m=dict(unseen_m or {}),
            calibrated_by=seen.told,
            parts_percent=parts_percent(
                seen,
                estimated_g=estimated_g,
                low_g=estimated_low_g,
                high_g=estimated_high_g,
                coverage=min(coverage, 1.0) if coverage else 1.0,
                layers_g=math.hypot(under.weight_sd_g, under.support_sd_g),
            ),
            load=load,
            hidden=under.tubers,
            hidden_g=under.weight_g,
            layered_m=under.belt_m,
            contract=contract,
            classes=classes,
            foreign=foreign,
            apart=apart,
            exchanged=exchanged,
        )
