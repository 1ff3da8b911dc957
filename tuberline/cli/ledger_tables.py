"""Score and audit as tables for a person."""

from __future__ import annotations

from rich.markup import escape
from rich.table import Table

from aggregator.ledger.audit import Audit
from aggregator.scoring.score import Score


def score_table(score: Score) -> Table:
    """A run against the truth."""
    table = Table("against the truth", "", title=None)
    rows = [
        ("tubers", f"{score.count} counted, {score.true_count} true ({_signed(score.count_error_percent)} %)"),
        ("of these", f"{score.missed} missed, {score.double_counted} counted twice, {score.false} false"),
    ]
    for name, text in [*rows, *(_weighed(score) if score.count else _nothing(score))]:
        table.add_row(name, escape(text))
    return table


def _belt_seen(score: Score) -> str:
    return "unknown" if score.coverage is None else f"{100 * score.coverage:.1f} %"


def _nothing(score: Score) -> list[tuple[str, str]]:
    """Of a run that counted no tuber: there is nothing to compare."""
    why = "`tuberline audit` says what became of its frames"
    unseen = f"no camera saw a belt move; {why}" if score.coverage is None else f"none of its belt was seen; {why}"
    seen = "its belt was seen" if score.saw else unseen
    return [
        ("load", f"nothing was counted, so nothing was weighed ({seen}); true {score.true_weight_g / 1000:.3f} kg"),
        ("belt seen", _belt_seen(score)),
    ]


def _weighed(score: Score) -> list[tuple[str, str]]:
    rows = [
        (
            "load as seen, raw",
            f"{score.weight_g / 1000:.3f} kg, true {score.true_weight_g / 1000:.3f} kg "
            f"({_signed(score.weight_error_percent)} %), 90 %: {score.low_g / 1000:.3f} to {score.high_g / 1000:.3f}",
        ),
        (
            "load as estimated, raw",
            f"{score.estimated_weight_g / 1000:.3f} kg ({_signed(score.estimated_error_percent)} %), "
            f"90 %: {score.estimated_low_g / 1000:.3f} to {score.estimated_high_g / 1000:.3f}",
        ),
        ("calibrated", _calibrated(score)),
        ("belt seen", _belt_seen(score)),
        ("per tuber", f"MAE {_number(score.mae_g)} g, RMSE {_number(score.rmse_g)} g, bias {_number(score.bias_g)} g"),
        ("truth inside the 90 % interval", f"{_number(score.interval_hit_percent)} % of tubers"),
        ("place", f"mean {_number(score.place_mean_mm)} mm, 95 % within {_number(score.place_p95_mm)} mm off"),
    ]
    if score.aligned:
        rows.append(
            ("places aligned", f"travel was estimated: scale {score.scale:.4f}, offset {score.offset_mm:+.1f} mm")
        )
    return rows


def _calibrated(score: Score) -> str:
    """The estimate by tickets, and by which."""
    weight_g, low_g, high_g = score.calibrated_weight_g, score.calibrated_low_g, score.calibrated_high_g
    if weight_g is None or low_g is None or high_g is None:
        return "no ticket calibrates this run"
    return (
        f"{weight_g / 1000:.3f} kg ({_signed(score.calibrated_error_percent)} %), "
        f"90 %: {low_g / 1000:.3f} to {high_g / 1000:.3f}, by {score.calibrated_by}"
    )


def _signed(value: float | None) -> str:
    return "-" if value is None else f"{value:+.2f}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def camera_table(audit: Audit) -> Table:
    """The balance sheet of each camera."""
    table = Table("camera", "state", "frames", "views", "tracks", title=f"run {audit.run}")
    for camera, mark in audit.marks.items():
        if mark is None:
            table.add_row(camera, "never heard", "", "", "")
        else:
            state = "ended" if mark.final else "running" if audit.end == "goes on" else audit.end or ""
            table.add_row(camera, state, *(_sheet(sheet) for sheet in (mark.frames, mark.views, mark.tracks)))
    table.add_row("all", audit.end or "", "", "", _sheet(dict(audit.tracks)))
    return table


def _sheet(sheet: dict[str, int]) -> str:
    return "\n".join(f"{key.replace('_', ' ')} {n}" for key, n in sheet.items())


def audit_table(audit: Audit) -> Table:
    """Every equation and whether it holds."""
    table = Table("where", "law", "holds")
    for where, equations in audit.equations.items():
        for equation in equations:
            holds = (
                f"[green]yes[/], {equation.left}"
                if equation.difference == 0
                else f"[red]no: {equation.left} is not {equation.right} ({equation.difference:+d})[/]"
            )
            table.add_row(where, equation.text, holds)
    return table
