"""`tuberline ledger`: check, repair or dump a ledger, add up its loads."""

from __future__ import annotations

import contextlib
import json as json_module
import sys
from pathlib import Path

from cyclopts import App

from tuberline.cli.progress import ledger_bar

ledger = App(name="ledger", help="Check, repair or dump a ledger; add up its loads; its classes of size.")


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
    with ledger_bar():
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


ledger.command(
    "tuberline.cli.ledger_totals:totals", name="totals", help="Totals by load, field, variety, day or season."
)


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

    with ledger_bar():
        report = repair_ledger(ledger_file(path))
    for text in report.repaired:
        sys.stdout.write(f"repaired: {text}\n")
    for text in report.lost:
        sys.stdout.write(f"LOST: {text}\n")
    rows = ", ".join(f"{n} {name}" for name, n in report.saved.items() if n)
    sys.stdout.write(f"saved {rows}; the damaged ledger is kept as {report.kept_as}\n")
    if report.lost:
        sys.exit(1)


@ledger.command
def dump(path: Path, /, *, canonical: bool = False, run: str | None = None) -> None:
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
    with contextlib.ExitStack() as stack:
        if not sys.stdout.isatty():  # a bar would stand among the lines
            stack.enter_context(ledger_bar())
        db = stack.enter_context(reading(file))
        chosen = the_run(db, file, run)
        for line in canonical_lines(db, chosen) if canonical else full_lines(db, chosen):
            sys.stdout.write(line + "\n")


ledger.command(dump, name="export", help="Now dump.", show=False)


@ledger.command
def summary(*, config: Path, run: str | None = None) -> None:
    """Write the summary.json and tubers.csv of a run whose aggregator was killed; the line must be stopped.

    Parameters
    ----------
    config
        The line's TOML file: where its results are, and its tickets and contract.
    run
        Which run; default: the newest of the ledger.
    """
    from aggregator.late_summary import write_late_summary
    from aggregator.ledger.reader import ledger_file, read_runs, reading
    from conveyor.config import load_config
    from conveyor.errors import InputError

    line = load_config(config)
    file = ledger_file(line.aggregator.out)
    with reading(file) as view:
        known = [row.run for row in read_runs(view)]
    chosen = run or (known[-1] if known else "")
    if chosen not in known or not write_late_summary(line, chosen):
        raise InputError(f"ledger {file} holds no run '{chosen}'; it has: {', '.join(known) or 'none'}")
    sys.stdout.write(f"{line.aggregator.out / 'summary.json'} of run {chosen}\n")


@ledger.command
def classes(path: Path, /, *, contract: Path, run: str | None = None, json: bool = False) -> None:
    """A run by the classes of a contract, and each load of it.

    Parameters
    ----------
    path
        Folder of a run (with its ledger.db), or the ledger itself.
    contract
        A buyer's classes of size (TOML).
    run
        Which run, where the ledger holds several.
    json
        Print the classes as JSON on stdout.
    """
    from aggregator.ledger.class_list import told_classes
    from aggregator.ledger.reader import ledger_file, reading
    from conveyor.contract import read_contract

    wanted, file = read_contract(contract), ledger_file(path)
    with ledger_bar(), reading(file) as view:
        told = told_classes(view, file, wanted, run=run)
    if json:
        sys.stdout.write(json_module.dumps(told, indent=2) + "\n")
        return
    from rich.console import Console

    from tuberline.cli.class_table import class_table

    for each in told:
        Console().print(class_table(f"{each['name']}, {wanted.told}", each["classes"]))
