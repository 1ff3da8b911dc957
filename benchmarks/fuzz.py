"""Coverage-guided fuzzing of every decoder with atheris: executions, coverage, memory, findings.

    python -m benchmarks fuzz [TARGET ...] [--seconds 90] [--out FOLDER]
    python -m benchmarks fuzz [MESSAGE ...] --messages 1000000 [--seed N] [--out FOLDER]

An input must end as a value or as an error of ours with a text; anything else is a finding, as are an input that takes
longer than the hang limit and a process that grows beyond the memory bound. Exits with 1 where there is one. With
`--messages` every message class reads so many headers built from its declared ranges, at and beyond each limit.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from benchmarks.fuzz_messages import fuzz_messages
from benchmarks.options import parser_of, whole_number
from conveyor.errors import TuberlineError
from tests.fuzz.structure import CLASSES
from tests.fuzz.targets import TARGETS

ROOT = Path(__file__).resolve().parents[1]
HANG_S = 300
"""Of wall time, for native code alone; Python code is watched by its processor time (`tests.fuzz.atheris_run`)."""
MOST_MIB = 1536
"""Resident memory of a fuzzing process, torch and corpus included."""
MOST_INPUT_BYTES = 16_384
MEMORY = Path("/dev/shm")
"""Files that change thousands of times a second belong in memory."""


@dataclass(frozen=True, slots=True)
class Fuzzed:
    """What came of one target."""

    target: str
    executions: int
    features: int
    corpus: int
    peak_mib: int
    findings: tuple[Path, ...]


def main(arguments: list[str]) -> None:
    """Fuzz the targets one after the other and print the table."""
    parser = parser_of("fuzz", __doc__)
    parser.add_argument("targets", nargs="*", help=f"default: all of {', '.join(TARGETS)}")
    parser.add_argument(
        "--messages", type=whole_number(1), help="built from the message classes, for each of them; no atheris"
    )
    parser.add_argument("--seconds", type=whole_number(1), default=90, help="for each target")
    parser.add_argument("--seed", type=whole_number(0), default=0, help="0: another one each time")
    parser.add_argument("--out", type=Path, help="keep corpora and findings here; the next run goes on from them")
    options = parser.parse_args(arguments)
    if options.messages is not None:
        _messages(options)
        return
    unknown = [name for name in options.targets if name not in TARGETS]
    if unknown:
        raise TuberlineError(f"fuzz target '{unknown[0]}' is unknown; known: {', '.join(TARGETS)}")
    if find_spec("atheris") is None:
        raise TuberlineError("coverage-guided fuzzing needs atheris (Linux, Python up to 3.13): pip install atheris")
    with _kept(options.out) as out:
        if _fuzzed(options.targets or list(TARGETS), out, options):
            sys.exit(1)


@contextmanager
def _kept(out: Path | None) -> Iterator[Path]:
    """The folder of `--out`; without it a temporary one, which stays where the block is left early: with a finding."""
    folder = out or Path(tempfile.mkdtemp(prefix="tuberline-fuzz-"))
    folder.mkdir(parents=True, exist_ok=True)
    yield folder
    if out is None:
        shutil.rmtree(folder)


def _fuzzed(targets: list[str], out: Path, options: argparse.Namespace) -> list[Path]:
    """Fuzz the targets and print the table; what was found."""
    print("| target | executions | features | corpus | peak MiB | findings |\n| --- | --- | --- | --- | --- | --- |")
    found: list[Path] = []
    for name in targets:
        seen = fuzz(name, out / name, seconds=options.seconds, seed=options.seed)
        print(
            f"| {seen.target} | {seen.executions} | {seen.features} | {seen.corpus} | {seen.peak_mib} "
            f"| {len(seen.findings)} |",
            flush=True,
        )
        found += seen.findings
    for path in found:
        shown = path.read_text(errors="replace").splitlines()[0] if path.suffix == ".txt" else "hang, crash or memory"
        print(f"{path}: {shown}")
    return found


def _messages(options: argparse.Namespace) -> None:
    known = [cls.__name__ for cls in CLASSES]
    for name in options.targets:
        if name not in known:
            raise TuberlineError(f"message '{name}' is unknown; known: {', '.join(known)}")
    seed = options.seed or random.SystemRandom().randrange(1, 1 << 32)
    with _kept(options.out) as out:
        if not fuzz_messages(options.messages, seed=seed, out=out, names=options.targets):
            sys.exit(1)


def fuzz(target: str, out: Path, *, seconds: int, seed: int) -> Fuzzed:
    """Fuzz one target; its corpus, seeds and findings stay in `out`."""
    for folder in ("seeds", "corpus"):
        (out / folder).mkdir(parents=True, exist_ok=True)
    for old in (*out.glob("finding-*"), *out.glob("libfuzzer-*")):
        old.unlink()
    with tempfile.TemporaryDirectory(prefix="tuberline-fuzz-", dir=MEMORY if MEMORY.is_dir() else None) as files:
        log, code = _run(target, out, files, seconds=seconds, seed=seed)
    (out / "log.txt").write_text(log)
    status = re.findall(r"ft: (\d+) corp: (\d+)/", log)
    findings = (*sorted(out.glob("finding-*.txt")), *sorted(out.glob("libfuzzer-[cto]*")))  # crash, timeout, oom
    if not status or (code and not findings):
        raise TuberlineError(f"fuzzing {target} ended with {code}: {log.strip().splitlines()[-1:]}; see {out}")
    return Fuzzed(
        target=target,
        executions=_number(log, "number_of_executed_units"),
        features=int(status[-1][0]),
        corpus=int(status[-1][1]),
        peak_mib=_number(log, "peak_rss_mb"),
        findings=findings,
    )


def _run(target: str, out: Path, files: str, *, seconds: int, seed: int) -> tuple[str, int]:
    """What the fuzzing process said, and its exit code."""
    command = [
        sys.executable, "-m", "tests.fuzz.atheris_run", target, str(out), files,
        f"-max_total_time={seconds}", f"-timeout={HANG_S}", f"-rss_limit_mb={MOST_MIB}", f"-max_len={MOST_INPUT_BYTES}",
        f"-artifact_prefix={out}/libfuzzer-", f"-seed={seed}", "-print_final_stats=1", "-len_control=0",
        str(out / "corpus"), str(out / "seeds"),
    ]  # fmt: skip
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, stdin=subprocess.DEVNULL, capture_output=True, check=False,
        timeout=seconds + 600,
    )  # fmt: skip
    return (done.stderr + done.stdout).decode(errors="replace"), done.returncode


def _number(log: str, name: str) -> int:
    found = re.search(rf"stat::{name}:\s+(\d+)", log)
    return int(found.group(1)) if found else 0
