"""PointRAFT on a GPU: clouds/s at batch 1, 8, 32 and 128, and what several regressors weigh on one.

    python -m benchmarks gpu [--out out/gpu]

The first table is the network with its sampling, from cleaned clouds to grams, by the clock, for a GPU has no process
time: without CUDA graphs, without the sampling kernel, a core of this machine beside it, and the limit, which is the
GPU's float32 products of the same edges alone. The second is what a regressor does all day, preparation included, in
processes that share the GPU, beside as many on cores alone; each has one thread.
"""

from __future__ import annotations

import json
import multiprocessing
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from benchmarks.options import above_zero, parser_of, whole_number
from benchmarks.regressor_backends import PRODUCTS, Clouds, simulated_views
from conveyor.geometry import TYPICAL_BELT_SD_M
from conveyor.threads import use_threads
from regressor.network.batched import BatchedPointRaft
from regressor.network.device import usable_device
from regressor.network.fast import FastPointRaft
from regressor.network.grouping import group_prefix
from regressor.network.stored import load_weights
from regressor.serve.form import fastest
from regressor.training.labelled import read_labelled
from regressor.weigh.prepare import RefusedCloud
from regressor.weigh.weigher import Weigher

BATCHES = (1, 8, 32, 128)
ROUNDS = 30
WORKERS = (1, 2, 4, 8, 12)
TOGETHER = 32
"""Views of one pass in the second table."""
Table = dict[str, dict[str, float]]


def main(arguments: Sequence[str]) -> None:
    """Measure and print both tables."""
    parser = parser_of("gpu", __doc__)
    parser.add_argument("--data", type=Path, help="view pack to weigh; default: 64 simulated views")
    parser.add_argument(
        "--workers", type=whole_number(1), nargs="*", default=list(WORKERS), help="processes, each a row"
    )
    parser.add_argument("--seconds", type=above_zero, default=5.0, help="of each row of the second table")
    parser.add_argument("--out", type=Path, help="folder for gpu.json and gpu.md")
    given = parser.parse_args(arguments)
    usable_device("cuda")
    use_threads(1)
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.data or simulated_views(Path(scratch))
        clouds = Clouds.load(folder, weights=None, scratch=Path(scratch))
        network = measure(clouds)
        workers = {
            f"{count}": {way: working(folder, way, count, given.seconds) for way in ("cuda", "exact", "fastest")}
            for count in given.workers
        }
    text = f"{torch.cuda.get_device_name()}, torch {torch.__version__}\n\n{markdown(network)}\n{workers_table(workers)}"
    print(text)
    if given.out:
        given.out.mkdir(parents=True, exist_ok=True)
        found = {"network": network, "workers": workers}
        (given.out / "gpu.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
        (given.out / "gpu.md").write_text(text, encoding="utf-8")


Runner = Callable[[NDArray[np.int64]], NDArray[np.float64]]


def measure(clouds: Clouds) -> Table:
    """Per way: median clouds/s of each batch, mean and largest difference in grams from a core's exact form."""
    state, _ = load_weights()
    alone = FastPointRaft(state)

    def core(rows: NDArray[np.int64]) -> NDArray[np.float64]:
        return np.array([alone.weigh(group_prefix(clouds.points[i]), float(clouds.height_m[i])) for i in rows])

    def on_gpu(network: BatchedPointRaft) -> Runner:
        return lambda rows: network.weigh_clouds([clouds.points[i] for i in rows], clouds.height_m[rows].tolist())

    ways = {
        "one core, exact": core,
        "GPU, operation by operation": on_gpu(BatchedPointRaft(state, graphs=False, kernel=False)),
        "GPU, as a graph": on_gpu(BatchedPointRaft(state, kernel=False)),
        "GPU, sampling as a kernel": on_gpu(BatchedPointRaft(state, graphs=False)),
        "GPU, as it weighs": on_gpu(BatchedPointRaft(state)),
    }
    every = np.arange(len(clouds))
    exact = core(every)
    table: Table = {}
    for name, run in ways.items():
        off = np.abs(run(every) - exact)
        table[name] = {"mean_difference_g": float(off.mean()), "max_difference_g": float(off.max())}
    table["the products alone (float32)"] = {}
    for batch in BATCHES:
        products = products_of(batch)
        runs = ways | {"the products alone (float32)": lambda rows, run=products: run()}
        taken: dict[str, list[float]] = {name: [] for name in runs}
        for turn in range(ROUNDS):
            rows = (turn * batch + np.arange(batch)) % len(clouds)
            for name, run in runs.items():
                if name == "one core, exact" and turn >= (12 if batch < 32 else 4):
                    continue
                begun = time.perf_counter()
                run(rows)
                taken[name].append(time.perf_counter() - begun)
        for name, seconds in taken.items():
            # The first two rounds captured graphs and compiled kernels.
            table[name][f"{batch}"] = batch / statistics.median(seconds[2:])
    return table


def products_of(batch: int) -> Callable[[], Any]:
    """All float32 products of a batch, of every edge that the reduced graph has, as one graph."""
    pairs = [
        (torch.randn(batch * rows * times, inner, device="cuda"), torch.randn(inner, outer, device="cuda"))
        for rows, inner, outer, times in PRODUCTS
    ]
    aside = torch.cuda.Stream()  # type: ignore[no-untyped-call]
    with torch.cuda.stream(aside):
        for a, b in pairs:
            a @ b
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        products = [a @ b for a, b in pairs]

    def run() -> int:
        graph.replay()
        torch.cuda.synchronize()
        return len(pairs) + len(products)  # a graph does not keep what it reads and writes

    return run


def working(folder: Path, way: str, count: int, seconds: float) -> float:
    """Views/s that `count` processes prepare and weigh, all of them together."""
    context = multiprocessing.get_context("spawn")
    ready, found = context.Barrier(count), context.SimpleQueue()
    arguments = (folder, way, seconds, ready, found)
    workers = [context.Process(target=_work, args=arguments) for _ in range(count)]
    for worker in workers:
        worker.start()
    rates = [found.get() for _ in workers]
    for worker in workers:
        worker.join()
    return float(sum(rates))


def _work(folder: Path, way: str, seconds: float, ready: Any, found: Any) -> None:
    use_threads(1)
    views = list(read_labelled(folder))
    weigher = Weigher.load()
    if way == "cuda":
        weigher = weigher.on("cuda")
    elif way == "fastest":
        weigher = weigher.in_form(fastest(weigher))

    def weigh(begin: int) -> int:
        clouds = []
        for view in (views[(begin + i) % len(views)] for i in range(TOGETHER)):
            try:
                clouds.append(view.prepare())
            except RefusedCloud:
                continue
        spreads = [TYPICAL_BELT_SD_M] * len(clouds)
        return len(weigher.weigh_many(clouds, belt_sd_m=spreads, resting_sd_m=[0.0] * len(clouds)))

    weigh(0)
    ready.wait()
    begun, weighed, turn = time.perf_counter(), 0, 1
    while (passed := time.perf_counter() - begun) < seconds:
        weighed += weigh(turn * TOGETHER)
        turn += 1
    found.put(weighed / passed)


def markdown(table: Table) -> str:
    """The first table."""
    limit = table["the products alone (float32)"]
    heads = [part for batch in BATCHES for part in (f"batch {batch}: clouds/s", "of the limit")]
    lines = ["| way | " + " | ".join(heads) + " | mean, largest difference g |", "|" + " --- |" * (len(heads) + 2)]
    for name, row in table.items():
        cells = [f"{row[f'{b}']:,.0f} | {row[f'{b}'] / limit[f'{b}']:.2f}" for b in BATCHES]
        error = f"{row['mean_difference_g']:.4f}, {row['max_difference_g']:.4f}" if "mean_difference_g" in row else "–"
        lines.append(f"| {name} | " + " | ".join([*cells, error]) + " |")
    return "\n".join(lines) + "\n"


def workers_table(found: Table) -> str:
    """The second table."""
    lines = [
        "| regressors | views/s on the GPU | on cores, exact | on cores, as a live line | GPU over live |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for count, row in found.items():
        cells = f"{row['cuda']:,.0f} | {row['exact']:,.0f} | {row['fastest']:,.0f} | {row['cuda'] / row['fastest']:.1f}"
        lines.append(f"| {count} | {cells} |")
    return "\n".join(lines) + "\n"
