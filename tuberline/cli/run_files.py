"""The runs that a command is given, and the file that it writes: each ledger once, and none of their files replaced."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from aggregator.ledger.files import RESULT_FILES
from aggregator.ledger.reader import ledger_file
from aggregator.ledger.receipt import receipt_path
from aggregator.ledger.stated import CONFIG_FILE
from conveyor.config import load_config
from conveyor.errors import InputError, TuberlineError
from conveyor.formats.positions import POSITIONS_FILE


def each_once(runs: Sequence[Path], tracks: Sequence[Path]) -> tuple[list[Path], list[Path]]:
    """The runs, each ledger once however often and by whatever path it is named, and with it its track.

    Raises:
        InputError: one ledger with two tracks.
    """
    paired = len(tracks) == len(runs)
    found: dict[Path, int] = {}
    for n, run in enumerate(runs):
        first = found.setdefault(ledger_file(run).resolve(), n)
        if paired and tracks[n].resolve() != tracks[first].resolve():
            raise InputError(
                f"{runs[first]} and {run} are one run, and two tracks are given for it, {tracks[first]} and "
                f"{tracks[n]}: name it once, with one file that holds all of its positions"
            )
    return [runs[n] for n in found.values()], [tracks[n] for n in found.values()] if paired else list(tracks)


def output(runs: Sequence[Path], name: str, out: Path | None, *, read: Iterable[Path | None] = ()) -> Path:
    """The file to write, checked before the work is done: `out`, else `name` beside the first ledger.

    A name that a run keeps for itself becomes exported-NAME. `read`: files that the command reads beside the runs.

    Raises:
        InputError: `out` is a file that a run keeps or the command reads, or a folder.
    """
    ledgers = [ledger_file(run) for run in runs]
    kept = {path.resolve() for ledger in ledgers for path in _kept(ledger)}
    target = out or ledgers[0].parent / name
    if target.resolve() in kept:
        if out is not None:
            raise InputError(f"--out {out} is the run's own file, which this would replace: give another name")
        target = target.with_name(f"exported-{name}")
    if target.resolve() in {path.resolve() for path in read if path is not None}:
        raise InputError(f"--out {target} is read by this very command, which would replace it: give another name")
    if target.is_dir():
        raise InputError(f"{target} is a folder: name a file with --out")
    return target


def _kept(ledger: Path) -> Iterator[Path]:
    """The ledger and all beside it that is a run's own, and what the line's config names."""
    own = (ledger.name, f"{ledger.name}-wal", f"{ledger.name}-shm", *RESULT_FILES, POSITIONS_FILE, CONFIG_FILE)
    yield from (receipt_path(ledger), *(ledger.parent / name for name in own))
    with suppress(TuberlineError):  # who reads it says what is wrong with it
        if (config := ledger.parent / CONFIG_FILE).is_file():
            settings = load_config(config).aggregator
            yield from filter(None, (settings.tickets, settings.contract))
