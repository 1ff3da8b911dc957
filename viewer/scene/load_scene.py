"""The load: what it weighs, how many tubers, how sure, their distribution. Tubers and totals in, primitives out."""

from __future__ import annotations

from conveyor.layers import layers_in_words
from conveyor.messages import Totals, Tuber
from conveyor.statistics import NORMAL_90
from viewer.scene.primitives import Bars, Color, Entry, Measured, Moment, Number, Page, PlotStyle, Primitive

TOTAL_COLOR: Color = (120, 200, 255)
COUNT_COLOR: Color = (110, 220, 110)
BARS_COLOR: Color = (240, 190, 90)
SIGMAS_OF_90_PERCENT = 2 * NORMAL_90
DEFAULT_STEP_G = 50.0


class LoadScene:
    """The running load.

    The aggregator's totals are the truth, but a replay at full speed hears only a few of them. Between two, the load is
    added up tuber by tuber, where it crossed; only while none is missing, for a sum with a hole would be a wrong total.
    """

    def __init__(self) -> None:
        self._count = 0
        self._weight_g = 0.0
        self._bins: list[int] = []
        self._step_g = DEFAULT_STEP_G
        self._complete = True

    def opening(self) -> list[Entry]:
        """How the numbers are plotted."""
        styles = {
            "/load/counted_kg": PlotStyle("tubers counted, kg", BARS_COLOR, points=False),
            "/load/count": PlotStyle("tubers", COUNT_COLOR, points=False),
            "/load/tubers_per_s": PlotStyle("tubers per second", COUNT_COLOR, points=False),
            "/load/coverage_percent": PlotStyle("belt looked at, %", (190, 150, 255), points=False),
        }
        return [Entry(path, style, None) for path, style in styles.items()]

    def on_tuber(self, tuber: Tuber, moment: Moment) -> list[Entry]:
        """The load with this tuber; [] once a tuber is missing in the row."""
        self._complete = self._complete and tuber.tuber_id == self._count + 1
        if not self._complete:
            return []
        self._count += 1
        self._weight_g += tuber.weight_g
        bin_at = int(tuber.weight_g // self._step_g)
        self._bins += [0] * (bin_at + 1 - len(self._bins))
        self._bins[bin_at] += 1
        primitives: dict[str, Primitive] = {
            "/load/counted_kg": Number(self._weight_g / 1000),
            "/load/count": Number(float(self._count)),
            "/load/page": Page("\n\n".join([*_headline(self._count, self._weight_g), "So far, tuber by tuber."])),
            "/load/weights": Bars(tuple(self._bins), self._step_g, BARS_COLOR),
        }
        return [Entry(path, primitive, moment) for path, primitive in primitives.items()]

    def on_totals(self, totals: Totals, moment: Moment) -> list[Entry]:
        """Everything drawn of one report."""
        if totals.histogram_step_g != self._step_g and self._count == 0:
            self._step_g = totals.histogram_step_g
        if totals.no_number:
            return [Entry("/load/page", Page(page(totals)), moment)]
        sigma_kg = (totals.high_g - totals.low_g) / SIGMAS_OF_90_PERCENT / 1000
        primitives: dict[str, Primitive] = {
            "/load/page": Page(page(totals)),
            "/load/weight_kg": Measured(totals.weight_g / 1000, sigma_kg, "kg", "load, kg", TOTAL_COLOR),
            "/load/count": Number(float(totals.count)),
            "/load/tubers_per_s": Number(totals.tubers_per_s),
        }
        if totals.coverage is not None:
            primitives["/load/coverage_percent"] = Number(100 * totals.coverage)
        if totals.histogram:
            primitives["/load/weights"] = Bars(totals.histogram, totals.histogram_step_g, BARS_COLOR)
        return [Entry(path, primitive, moment) for path, primitive in primitives.items()]


def page(totals: Totals) -> str:
    """The big numbers, as Markdown; where there is none, why."""
    cameras = [f"Camera {name}: {state}" for name, state in sorted(totals.cameras.items())]
    if totals.no_number:
        said = "Nothing seen" if totals.state == "nothing seen" else "Starting, not counting"
        return "\n\n".join([f"# {said}", totals.reason, *cameras])
    rows = [
        *_open_load(totals),
        *_headline(totals.count, totals.weight_g),
    ]
    if totals.count:
        rows.append(f"90 % sure: {_kg(totals.low_g)} to {_kg(totals.high_g)}")
    if totals.coverage is not None:
        rows.append(f"Belt looked at: **{100 * totals.coverage:.1f} %**")
        if totals.coverage < 0.9995:
            rows.append(
                f"With the belt that was missed: **{_kg(totals.estimated_weight_g)}** "
                f"({_kg(totals.estimated_low_g)} to {_kg(totals.estimated_high_g)})"
            )
    if totals.belt_unknown:
        rows.append(f"Belt looked at: **not known**, {totals.reason}")
    if layers := layers_in_words(totals.hidden, totals.layered_m, totals.belt_m):
        rows.append(f"{layers[0].upper()}{layers[1:]}. With them: **{_kg(totals.estimated_weight_g)}**")
    rows += cameras
    rows.append("**The load is complete.**" if totals.final else f"{totals.tubers_per_s:.1f} tubers per second.")
    return "\n\n".join(rows)


def _open_load(totals: Totals) -> list[str]:
    load = totals.load
    if load is None:
        return []
    name = " · ".join(filter(None, (f"Load {load.number}", load.name, load.field, load.variety)))
    sure = f"90 % sure: {_kg(load.low_g)} to {_kg(load.high_g)}, {load.count} tubers"
    return [f"# {name}: {_kg(load.weight_g)}", sure, "The whole run:"]


def _headline(count: int, weight_g: float) -> list[str]:
    mean = f"{weight_g / count:.0f} g each" if count else "none yet"
    return [f"# {_kg(weight_g)}", f"# {count} tuber{'' if count == 1 else 's'}", mean]


def _kg(weight_g: float) -> str:
    return f"{weight_g / 1000:.2f} kg" if weight_g < 100_000 else f"{weight_g / 1000:.1f} kg"
