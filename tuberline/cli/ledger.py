"""The aggregator's commands: its process, the score of a run, its audit, and the ledger's care."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path

from cyclopts import App


def aggregator(*, config: Path, run: str | None = None, fingerprint: str = "", new_run: bool = False) -> None:
    """Count every tuber once and keep the line's ledger.

    Parameters
    ----------
    config
        The line's TOML file.
    run
        Id of this run; default: the time of its start. An unfinished run of the ledger is gone on with.
    fingerprint
        Of the recording that is replayed: the same one is not counted twice into one ledger.
    new_run
        Count a recording again that the ledger already holds, as a run of its own.
    """
    from datetime import UTC, datetime

    from aggregator.node import run_aggregator
    from conveyor.config import load_config
    from conveyor.errors import ConfigError

    line = load_config(config)
    if not line.cameras:
        raise ConfigError(f"config {config} names no camera: nothing would be counted; add [cameras.<name>]")
    run_id = run or datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    run_aggregator(line, run=run_id, fingerprint="" if new_run else fingerprint)


def score(run_dir: Path, /, *, truth: Path, match_mm: float = 25.0, run: str | None = None, json: bool = False) -> None:
    """Compare a run with the truth: count, per-tuber weights, total weight.

    Parameters
    ----------
    run_dir
        Folder of a run (with its ledger.db), or the ledger itself.
    truth
        The recording's truth.json.
    match_mm
        A counted tuber and a true one farther apart than this are two.
    run
        Which run, where the ledger holds several.
    json
        Print the score as JSON on stdout.
    """
    from aggregator.scoring.score import score_run

    result = score_run(run_dir, truth=truth, match_mm=match_mm, run=run)
    if json:
        sys.stdout.write(json_module.dumps(result.as_dict(), indent=2) + "\n")
        return
    from rich.console import Console

    from tuberline.cli.ledger_tables import score_table

    Console().print(score_table(result))


def audit(run_dir: Path, /, *, run: str | None = None, json: bool = False) -> None:
    """Print the balance sheet of a finished or a running line; exit with 1 if an equation does not hold.

    Parameters
    ----------
    run_dir
        Folder of a run (with its ledger.db), or the ledger itself.
    run
        Which run, where the ledger holds several.
    json
        Print the balance sheet as JSON on stdout.
    """
    from aggregator.ledger.audit import audit_run
    from aggregator.ledger.reader import ledger_file, reading, the_run

    path = ledger_file(run_dir)
    with reading(path) as db:
        found = audit_run(db, the_run(db, path, run))
    if json:
        sys.stdout.write(json_module.dumps(found.as_dict(), indent=2) + "\n")
    else:
        from rich.console import Console

        from tuberline.cli.ledger_tables import audit_table, camera_table

        console = Console()
        console.print(camera_table(found))
        console.print(audit_table(found))
        for fault in found.faults:
            console.print(f"damaged: {fault}", style="red", markup=False, highlight=False)
    if not found.balanced:
        sys.exit(1)


ledger = App(name="ledger", help="Check, repair or export a ledger.")


@ledger.command
def check(path: Path, /, *, json: bool = False) -> None:
    """Read every row and index of a ledger and say whether it can be trusted; exit with 1 if not.

    Parameters
    ----------
    path
        Folder of a run (with its ledger.db), or the ledger itself.
    json
        Print the findings as JSON on stdout.
    """
    from aggregator.ledger.check import check_file
    from aggregator.ledger.reader import ledger_file

    file = ledger_file(path)
    faults = check_file(file)
    if json:
        sys.stdout.write(json_module.dumps({"ledger": str(file), "sound": not faults, "faults": faults}) + "\n")
    elif faults:
        sys.stdout.write("".join(f"{fault}\n" for fault in faults))
        sys.stderr.write(f"ledger {file} cannot be trusted; `tuberline ledger repair {file}` saves what is intact\n")
    else:
        sys.stdout.write(f"ledger {file} is sound\n")
    if faults:
        sys.exit(1)


@ledger.command
def repair(path: Path, /) -> None:
    """Save what is intact in a damaged ledger into a new one; the damaged one is kept beside it.

    Parameters
    ----------
    path
        Folder of a run (with its ledger.db), or the ledger itself.
    """
    from aggregator.ledger.reader import ledger_file
    from aggregator.ledger.repair import repair as repair_ledger

    report = repair_ledger(ledger_file(path))
    for text in report.mended:
        sys.stdout.write(f"mended: {text}\n")
    for text in report.lost:
        sys.stdout.write(f"LOST: {text}\n")
    rows = ", ".join(f"{n} {name}" for name, n in report.saved.items() if n)
    sys.stdout.write(f"saved {rows}; the damaged ledger is kept as {report.kept_as}\n")
    if report.lost:
        sys.exit(1)


@ledger.command
def export(path: Path, /, *, canonical: bool = False, run: str | None = None) -> None:
    """Write a run as JSON lines to stdout.

    Parameters
    ----------
    path
        Folder of a run (with its ledger.db), or the ledger itself.
    canonical
        Rounded and without clocks, names and run id: two runs of the same recording give the same bytes.
    run
        Which run, where the ledger holds several.
    """
    from aggregator.ledger.export import canonical_lines, full_lines
    from aggregator.ledger.reader import ledger_file, reading, the_run

    file = ledger_file(path)
    with reading(file) as db:
        chosen = the_run(db, file, run)
        for line in canonical_lines(db, chosen) if canonical else full_lines(db, chosen):
            sys.stdout.write(line + "\n")
