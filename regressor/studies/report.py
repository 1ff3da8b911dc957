"""An evaluation as files: report.md, metrics.json, metrics.csv, views.csv and, where matplotlib is installed, plots."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from regressor.studies.evaluate import LINEAR_BOX, NETWORK, SHIPPED, Evaluation, coverage, group_scores, method_scores
from regressor.training.plausible import refused_told

COLUMNS = ("mae_g", "rmse_g", "bias_g", "r2", "tuber_mae_g", "tuber_rmse_g", "load_bias_percent")


def summary(result: Evaluation) -> dict[str, Any]:
    """Everything measured, as one JSON document."""
    return {
        "model": result.model,
        "target": result.target,
        "methods": method_scores(result),
        "groups": group_scores(result),
        "coverage": coverage(result),
        "flags": result.flags,
        "refused": result.refused,
        "refused_first": result.refused_first,
    }


def write_report(result: Evaluation, out: Path, *, title: str) -> dict[str, Any]:
    """Write all tables to `out`; the summary."""
    out.mkdir(parents=True, exist_ok=True)
    measured = summary(result)
    (out / "metrics.json").write_text(json.dumps(measured, indent=1) + "\n", encoding="utf-8")
    (out / "report.md").write_text(markdown(measured, title=title), encoding="utf-8")
    _write_metrics(out / "metrics.csv", measured)
    _write_views(out / "views.csv", result)
    return measured


def markdown(measured: dict[str, Any], *, title: str) -> str:
    """The tables for people."""
    first = next(iter(measured["methods"].values()))
    baseline = measured["methods"].get(LINEAR_BOX)
    compared = (
        f"MAE of PointRAFT is {measured['methods'][NETWORK]['mae_g'] / baseline['mae_g']:.2f} times that of the "
        "paper's linear baseline."
        if baseline
        else "Baselines are left out: none can be fitted without the one tuber that it would be judged by."
    )
    of = measured.get("target", "weight_g")
    other = "" if of == "weight_g" else f" The target is {of}: read its unit where the tables say g."
    lines = [
        f"# {title}",
        "",
        f"Weights `{measured['model']}`; {first['views']:.0f} views of {first['tubers']:.0f} tubers. {compared}{other}",
        "",
        "| method | MAE g | RMSE g | bias g | R2 | MAE g per tuber | RMSE g per tuber | bias of a 300-tuber load % |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, figures in measured["methods"].items():
        load = (
            f"{figures['load_bias_percent']:+.2f} ({figures['load_bias_p05']:+.2f} to {figures['load_bias_p95']:+.2f})"
        )
        cells = [f"{figures[column]:.2f}" for column in COLUMNS[:3]] + [f"{figures['r2']:.3f}"]
        cells += [f"{figures[column]:.2f}" for column in COLUMNS[4:6]]
        lines.append("| " + " | ".join([name, *cells, load]) + " |")
    held = measured["coverage"]
    lines += [
        "",
        f"90 % intervals cover {100 * held['views']:.1f} % of the views (mean width {held['mean_width_g']:.1f} g), "
        f"{100 * held['tubers']:.1f} % of the fused tubers and {100 * held['loads']:.1f} % of loads of 300 drawn "
        f"tubers (half width {held['load_half_width_percent']:.2f} %).",
        f"Flags: {_counts(measured['flags'])}. Refused: "
        f"{refused_told(measured['refused'], measured.get('refused_first', {})) or 'none'}.",
        "",
        "## As weighed, by group",
        "",
        "| grouping | group | views | tubers | MAE g | RMSE g | bias g | coverage % |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for grouping, table in measured["groups"].items():
        lines += [
            f"| {grouping} | {label} | {row['views']:.0f} | {row['tubers']:.0f} | {row['mae_g']:.2f} | "
            f"{row['rmse_g']:.2f} | {row['bias_g']:+.2f} | {100 * row['coverage']:.1f} |"
            for label, row in table.items()
        ]
    return "\n".join(lines) + "\n"


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in sorted(counts.items())) or "none"


def _write_metrics(path: Path, measured: dict[str, Any]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["method", "grouping", "group", "figure", "value"])
        for method, figures in measured["methods"].items():
            writer.writerows([method, "all", "all", name, value] for name, value in figures.items())
        for grouping, table in measured["groups"].items():
            for label, figures in table.items():
                writer.writerows([SHIPPED, grouping, label, name, value] for name, value in figures.items())


def _write_views(path: Path, result: Evaluation) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["tuber", *result.groups, "weight_g", "low_g", "high_g", *result.predicted])
        for i in range(len(result.weight_g)):
            numbers = [result.weight_g[i], result.low_g[i], result.high_g[i]]
            numbers += [values[i] for values in result.predicted.values()]
            labels = [labels[i] for labels in result.groups.values()]
            writer.writerow([result.tuber[i], *labels, *(f"{number:.3f}" for number in numbers)])


def write_plots(result: Evaluation, out: Path) -> list[Path]:
    """Scatter, cumulative error and error over weight, as the reference's results folder has them."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    truth = result.weight_g
    figure, (scatter, cumulative, over) = plt.subplots(1, 3, figsize=(15, 4.6), constrained_layout=True)
    top = float(truth.max()) * 1.05
    colours = {name: f"C{i}" for i, name in enumerate(result.predicted)}
    for name in (LINEAR_BOX, SHIPPED):
        if name in result.predicted:
            scatter.plot(truth, result.predicted[name], ".", color=colours[name], markersize=3, alpha=0.5, label=name)
    scatter.plot([0, top], [0, top], "k-", linewidth=0.8)
    scatter.set(xlabel="weight on the scale [g]", ylabel="estimated [g]", xlim=(0, top), ylim=(0, top))
    for name, values in result.predicted.items():
        error = np.sort(np.abs(values - truth))
        cumulative.plot(error, np.linspace(0, 100, len(error)), color=colours[name], label=name)
        edges = np.quantile(truth, np.linspace(0, 1, 11))
        inside = np.clip(np.digitize(truth, edges) - 1, 0, 9)
        filled = np.unique(inside)  # of few views some classes are empty
        middle = [truth[inside == i].mean() for i in filled]
        mean = [np.abs(values - truth)[inside == i].mean() for i in filled]
        over.plot(middle, mean, "o-", color=colours[name], label=name)
    cumulative.set(xlabel="absolute error [g]", ylabel="views [%]", xlim=(0, 80), ylim=(0, 100))
    over.set(xlabel="weight on the scale [g]", ylabel="mean absolute error [g]", ylim=(0, None))
    for axes in (scatter, cumulative, over):
        axes.grid(alpha=0.3)
        axes.legend(fontsize=7)
    path = out / "errors.png"
    figure.savefig(path, dpi=130)
    plt.close(figure)
    return [path]
