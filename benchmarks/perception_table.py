"""The results of the suite as Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

Row = dict[str, Any]

GOALS: dict[str, tuple[float, float]] = {
    "singulated": (0.99, 0.5),
    "touching": (0.97, 1.0),
    "crowded": (0.93, 2.0),
    "two-cameras": (0.97, 1.0),
}
"""Least F1 at IoU 0.5 and largest count error in percent that are asked for, by scene."""


def tables(rows: Sequence[Row], times: Sequence[Row]) -> str:
    """All of it."""
    parts = [counting_table(rows), masks_table(rows)]
    if times:
        parts.append(times_table(times))
    return "\n".join(parts)


def counting_table(rows: Sequence[Row]) -> str:
    """Counts and loads; scenes with several seeds get a line of their own with the sums."""
    head = (
        "| scene | seed | true | counted | error | missed | double | false | taken for clods | belt seen off "
        "| load off by | MAE, tuber | load, belt as given | MAE, belt as given | place off |\n"
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |\n"
    )
    lines = []
    for scene in dict.fromkeys(row["scene"] for row in rows):
        own = [row for row in rows if row["scene"] == scene]
        lines += [_counted(str(row["scene"]), str(row["seed"]), [row]) for row in own]
        if len(own) > 1:
            lines.append(_counted(f"**{scene}**", "all", own))
    fair = [row for row in rows if row["scene"] != "distractors"]
    if len(fair) > 1:
        lines.append(_counted("**all but distractors**", "", fair))
    return head + "".join(lines)


def _counted(scene: str, seed: str, rows: Sequence[Row]) -> str:
    scores = [row["score"] for row in rows]
    as_given = [row["belt_as_given"] for row in rows]
    true, count = _total(scores, "true_count"), _total(scores, "count")
    refused = sum(row["discarded"].get("distractor", 0) for row in rows)
    belts = ", ".join(f"{off:+.1f}" for off in rows[0]["belt_off_mm"].values()) + " mm" if len(rows) == 1 else ""
    return (
        f"| {scene} | {seed} | {true:.0f} | {count:.0f} | {100 * (count / true - 1):+.2f} % "
        f"| {_total(scores, 'missed'):.0f} | {_total(scores, 'double_counted'):.0f} | {_total(scores, 'false'):.0f} "
        f"| {refused} | {belts} | {_load_percent(scores):+.1f} % | {_mean(scores, 'mae_g'):.1f} g "
        f"| {_load_percent(as_given):+.1f} % | {_mean(as_given, 'mae_g'):.1f} g "
        f"| {_mean(scores, 'place_mean_mm'):.1f} mm |\n"
    )


def _total(scores: Sequence[Row], name: str) -> float:
    return float(sum(score[name] for score in scores))


def _mean(scores: Sequence[Row], name: str) -> float:
    """Over all matched tubers."""
    return float(sum(score[name] * score["matched"] for score in scores) / max(_total(scores, "matched"), 1))


def _load_percent(scores: Sequence[Row]) -> float:
    return 100 * (_total(scores, "weight_g") / _total(scores, "true_weight_g") - 1)


def masks_table(rows: Iterable[Row]) -> str:
    """How well the masks agree."""
    head = (
        "| scene | seed | frames | masks given | found | F1 at 0.5 | F1 at 0.75 | PQ |\n"
        "| --- | --- | --- | --- | --- | --- | --- | --- |\n"
    )
    lines = [
        f"| {row['scene']} | {row['seed']} | {m['frames']} | {m['instances_given']} | {m['instances_found']} "
        f"| {m['f1_50']:.4f} | {m['f1_75']:.4f} | {m['panoptic_quality']:.3f} |\n"
        for row in rows
        for m in [row["masks"]]
    ]
    return head + "".join(lines)


def times_table(rows: Iterable[Row]) -> str:
    """Milliseconds of processor time per frame and stage."""
    head = (
        "| recording | message | heights | instances | classifier, when due | the rest "
        "| whole step: median, mean, 99 % | frames/s |\n| --- | --- | --- | --- | --- | --- | --- | --- |\n"
    )
    lines = []
    for row in rows:
        t = row["times"]
        step = t["step"]
        lines.append(
            f"| {row['name']} | {t['message']['median_ms']:.1f} | {t['heights']['median_ms']:.1f} "
            f"| {t['instances']['median_ms']:.1f} | {t['classes']['median_ms']:.1f} | {t['rest']['median_ms']:.1f} "
            f"| {step['median_ms']:.1f}, "
            f"{step['mean_ms']:.1f}, {step['p99_ms']:.1f} "
            f"| {1000 / (step['mean_ms'] + t['message']['mean_ms']):.0f} |\n"
        )
    return head + "".join(lines)


def shortfalls(rows: Iterable[Row]) -> list[str]:
    """What misses its goal, in words."""
    found = []
    for row in rows:
        if row["scene"] not in GOALS:
            continue
        least_f1, most_percent = GOALS[row["scene"]]
        where = f"{row['scene']} seed {row['seed']}"
        if row["masks"]["f1_50"] < least_f1:
            found.append(f"{where}: F1 {row['masks']['f1_50']:.4f}, goal {least_f1}")
        error = row["score"]["count_error_percent"]
        if abs(error) > most_percent:
            found.append(f"{where}: count {error:+.2f} %, goal {most_percent} %")
    return found
