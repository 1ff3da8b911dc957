"""Judges disturbed live runs: is the truth in the interval, does the coverage say what was counted, what is down?"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from typing import Any

from benchmarks.chaos_live_faults import BELTS, ENDS, KINDS, ROLES, WHENS

Run = dict[str, Any]
COVERAGE_OFF = 0.05


def share(run: Run) -> float | None:
    """Of the tubers that passed in the load, the share that was counted; None where the run said nothing."""
    if "count" not in run or not run.get("true_count"):
        return None
    return float(run["count"] / run["true_count"])


def off(run: Run) -> float | None:
    """Coverage as stated minus the share of tubers that was counted; a run that saw nothing claims none."""
    counted = share(run)
    if counted is None:
        return None
    return float(run["coverage"] or 0.0) - counted


def inside(run: Run) -> bool:
    """The truth lies in the 90 % interval; a run that saw nothing, and says so, claims none."""
    if "state" not in run:
        return False
    if run["state"] == "nothing seen":
        return bool(run["count"] == 0)
    return bool(run["low_g"] <= run["true_weighed_g"] <= run["high_g"])


def covered(run: Run) -> bool:
    """The coverage is within 5 points of the share of tubers that was counted."""
    difference = off(run)
    return difference is not None and abs(difference) <= COVERAGE_OFF


def whole(run: Run) -> bool:
    """Nothing was down at the end, and the books balance."""
    return not run["down"] and bool(run.get("balanced"))


def markdown(runs: Sequence[Run], *, seed: int) -> str:
    """The verdict and its tables."""
    loads = [load for run in runs for load in run["machine_load"]]
    blind = sum(run.get("state") == "nothing seen" for run in runs)
    lines = [
        f"{len(runs)} runs, seed {seed}, machine load {min(loads):.0f} to {max(loads):.0f} "
        f"(median {statistics.median(loads):.0f}): truth in the 90 % interval in **{sum(map(inside, runs))}**, "
        f"coverage within 5 points in **{sum(map(covered, runs))}**, nothing down at the end and books balanced in "
        f"**{sum(map(whole, runs))}**. {blind} saw nothing and said so.",
        "",
        _header("fault"),
        *(_row(f"{role}, {kind}", runs, _first(role, kind)) for role in ROLES for kind in KINDS),
        "",
        _header("of all runs"),
        *(_row(f"fault: {when}", runs, _of("when", when)) for when in WHENS),
        *(_row(f"belt: {belt}", runs, _of("belt", belt)) for belt in dict.fromkeys(BELTS)),
        *(_row(f"end: {ends}", runs, _of("ends", ends)) for ends in ENDS),
    ]
    return "\n".join(line for line in lines if line is not None) + "\n"


def _of(key: str, value: str) -> Callable[[Run], bool]:
    return lambda run: bool(run[key] == value)


def _first(role: str, kind: str) -> Callable[[Run], bool]:
    return lambda run: bool((run["faults"][0]["role"], run["faults"][0]["kind"]) == (role, kind))


def _header(what: str) -> str:
    names = ("runs", "in the interval", "coverage within 5 points", "off by, points", "counted, %", "whole")
    return f"| {what} | {' | '.join(names)} |\n| --- |{' --- |' * len(names)}"


def _row(name: str, runs: Sequence[Run], belongs: Callable[[Run], bool]) -> str | None:
    chosen = [run for run in runs if belongs(run)]
    if not chosen:
        return None
    offs = sorted(100 * o for o in map(off, chosen) if o is not None)
    shares = sorted(100 * s for s in map(share, chosen) if s is not None)
    spread = f"{offs[0]:+.0f} to {offs[-1]:+.0f}" if offs else "-"
    counted = f"{shares[0]:.0f} to {shares[-1]:.0f}" if shares else "-"
    judged = " | ".join(str(sum(map(judge, chosen))) for judge in (inside, covered))
    return f"| {name} | {len(chosen)} | {judged} | {spread} | {counted} | {sum(map(whole, chosen))} |"


def told(run: Run) -> str:
    """One run in one line, for the terminal."""
    faults = ", ".join(f"{f['role']} {f['kind']} at {f['at_s']:g} s" for f in run["faults"])
    counted, difference = share(run), off(run)
    verdict = "".join(mark if fine else mark.upper() for mark, fine in zip("icw", _judged(run), strict=True))
    numbers = "no summary"
    if "state" in run:
        low, high = ((run[key] or 0) / 1000 for key in ("low_g", "high_g"))
        true_kg = run.get("true_weighed_g", 0) / 1000
        numbers = (
            f"counted {run['count']}/{run.get('true_count')} = {_percent(counted)}, coverage "
            f"{_percent(run['coverage'])} ({_percent(difference)}), {low:.1f} to {high:.1f} kg, true {true_kg:.1f}"
        )
    down = f", down: {', '.join(run['down'])}" if run["down"] else ""
    return f"{run['number']:3} {verdict} {run['belt']}, {run['ends']}: {faults}: {numbers}{down}"


def _judged(run: Run) -> tuple[bool, bool, bool]:
    return inside(run), covered(run), whole(run)


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.0f} %"
