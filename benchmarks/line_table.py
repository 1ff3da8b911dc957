"""The tables of `benchmarks line` for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def markdown(report: Mapping[str, Any]) -> str:
    """The report as Markdown."""
    asked, machine = report["asked"], report["machine"]
    before, after = report["load_average"]
    centroids = "" if asked["centroids"] is None else f", {asked['centroids']} centroids"
    lines = [
        f"{asked['cameras']} cameras at {asked['fps']:g} frames/s, {asked['tubers_per_s']:g} tubers/s asked for "
        f"({asked['load']}, {asked['tubers']} a lap), "
        f"{report['tubers_per_s']:.1f} committed; {asked['regressors']} regressors, precision "
        f"{asked['precision']}{centroids}; {asked['seconds']:g} s, seed {asked['seed']}. "
        f"{machine['cores']} cores {machine['machine']}, Python {machine['python']}, load average {before:.1f} at the "
        f"start and {after:.1f} at the end.",
        "",
        "| process | CPU % of one core | memory MiB | restarts |",
        "| --- | --- | --- | --- |",
        *(
            f"| {name} | {p['cpu_percent']:.0f} | {p['memory_mib']:.0f} | {p['restarts']} |"
            for name, p in report["processes"].items()
        ),
        f"| all | {report['cpu_percent']:.0f} | {sum(p['memory_mib'] for p in report['processes'].values()):.0f} | |",
        "",
        "| hop, until | p50 s | p99 s | tubers |",
        "| --- | --- | --- | --- |",
        *(f"| {hop} | {t['p50_s']:.2f} | {t['p99_s']:.2f} | {t['n']} |" for hop, t in report["latency"].items()),
        "",
    ]
    if report.get("router_mb_per_s") is not None:
        lines += [f"The router received {report['router_mb_per_s']:.2f} MB/s (direct: {asked['direct']}).", ""]
    lines += [
        f"Frames lost in the measured time: {_lost(report['segmenters'])}; before it, while processes started and "
        f"kernels warmed up: {_lost(report.get('start', {}))}.",
        "",
    ]
    for name, books in report["segmenters"].items():
        lines.append(f"{name}: {_books(books)}.")
    return "\n".join(lines) + "\n"


def _lost(sheets: Mapping[str, Mapping[str, float]]) -> str:
    """Frames of all cameras together that were published and not processed, by reason."""
    published = sum(books.get("frames_published", 0) for books in sheets.values())
    reasons: dict[str, float] = {}
    for books in sheets.values():
        for name, n in books.items():
            if n and (name == "frames_gaps" or name.startswith("frames_dropped_")):
                reasons[name] = reasons.get(name, 0) + n
    told = ", ".join(f"{name} {n:.0f}" for name, n in sorted(reasons.items()))
    return f"{sum(reasons.values()):.0f} of {published:.0f}" + (f" ({told})" if told else "")


def _books(books: Mapping[str, float]) -> str:
    """What was received and processed, every loss by its reason, the views per tuber."""
    losses = {
        name: n
        for name, n in books.items()
        if n and name.startswith(("frames_dropped_", "frames_gaps", "views_lost_", "views_requeued_"))
    }
    said = [f"frames {books.get('frames_processed', 0):.0f} of {books.get('frames_published', 0):.0f} processed"]
    said += [f"{name} {n:.0f}" for name, n in sorted(losses.items())]
    said.append(f"views weighed {books.get('views_weighed', 0):.0f} of {books.get('views_sent', 0):.0f}")
    said.append(f"{books['views_weighed_per_track']:.2f} per track, now {books.get('views_per_tuber', 0):.0f}")
    said.append(f"regressors busy {100 * books.get('regressors_busy_share', 0):.0f} %")
    return ", ".join(said)
