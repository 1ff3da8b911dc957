"""Back ends of PointRAFT on one core: clouds/s at batch 1, 8 and 32, against the reference's operators and sgemm.

All in one run, in interleaved rounds, one thread, medians of process time: a shared machine slows all alike. From a
cleaned cloud to grams, sampling included. The error of each back end is in grams against the exact form.
"""

from __future__ import annotations

import json
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.options import parser_of, whole_number
from benchmarks.regressor_backends import VIEWS, Clouds, backends, product_seconds
from conveyor.threads import use_threads

BATCHES = (1, 8, 32)
ROUNDS = {1: 15, 8: 5, 32: 3}


def main(arguments: Sequence[str]) -> None:
    """Measure and print a Markdown table."""
    parser = parser_of("regressor", __doc__)
    parser.add_argument("--data", type=Path, help="view pack with clouds to weigh; default: 64 simulated views")
    parser.add_argument("--weights", type=Path, help="default: the shipped ones")
    parser.add_argument("--batches", type=whole_number(1), nargs="+", default=list(BATCHES))
    parser.add_argument("--rounds", type=whole_number(1), help="rounds per batch size (15, 5 and 3)")
    parser.add_argument("--out", type=Path, help="folder for speed.json and speed.md")
    given = parser.parse_args(arguments)
    if max(given.batches) > VIEWS:
        parser.error(f"argument --batches: {VIEWS} clouds are weighed, a batch holds no more")
    use_threads(1)
    with tempfile.TemporaryDirectory() as scratch:
        clouds = Clouds.load(given.data, weights=given.weights, scratch=Path(scratch))
        runners = backends(clouds, weights=given.weights, scratch=Path(scratch))
        measured = measure(runners, clouds, given.batches, given.rounds)
    text = markdown(measured)
    print(text)
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        (given.out / "speed.json").write_text(json.dumps(measured, indent=1) + "\n", encoding="utf-8")
        (given.out / "speed.md").write_text(text, encoding="utf-8")


Runner = Callable[[slice], np.ndarray]


def measure(
    runners: dict[str, Runner], clouds: Clouds, batches: Sequence[int], rounds: int | None
) -> dict[str, dict[str, float]]:
    """Per back end: median clouds/s of each batch size, mean and largest difference in grams from the first one."""
    every = range(0, len(clouds), 8)
    answers = {
        name: np.concatenate([run(slice(at, at + 8)) for at in every]) if "reference" not in name else run(slice(0, 8))
        for name, run in runners.items()
    }
    exact = answers["exact"]
    table: dict[str, dict[str, float]] = {name: {} for name in runners}
    for name, grams in answers.items():
        difference = np.abs(grams - exact[: len(grams)])
        table[name] |= {"mean_difference_g": float(difference.mean()), "max_difference_g": float(difference.max())}
    products: list[float] = []
    for batch in batches:
        taken: dict[str, list[float]] = {name: [] for name in runners}
        for turn in range(rounds or ROUNDS.get(batch, 3)):
            begin = (turn * batch) % max(1, len(clouds) - batch + 1)
            for name, run in runners.items():
                started = time.process_time()
                run(slice(begin, begin + batch))
                taken[name].append((time.process_time() - started) / batch)
            products.append(product_seconds())
        for name, seconds in taken.items():
            table[name][f"clouds_per_s_{batch}"] = 1 / statistics.median(seconds)
    table["the products alone (float32)"] = {
        f"clouds_per_s_{batch}": 1 / statistics.median(products) for batch in batches
    }
    return table


def markdown(table: dict[str, dict[str, float]]) -> str:
    """The table, with ratios to the reference's operators."""
    keys = sorted({key for row in table.values() for key in row if key.startswith("clouds")}, key=lambda k: int(k[13:]))
    heads = [part for key in keys for part in (f"batch {key[13:]}: clouds/s", "times the reference")]
    lines = ["| back end | " + " | ".join(heads) + " | mean, largest difference g |", "|" + " --- |" * (len(heads) + 2)]
    reference = next(row for name, row in table.items() if "reference" in name)
    for name, row in table.items():
        cells = [part for key in keys for part in (f"{row[key]:.1f}", f"{row[key] / reference[key]:.1f}")]
        error = f"{row['mean_difference_g']:.4f}, {row['max_difference_g']:.4f}" if "mean_difference_g" in row else "–"
        lines.append(f"| {name} | " + " | ".join([*cells, error]) + " |")
    return "\n".join(lines) + "\n"
