"""`tuberline weights`: which weights a running line weighs with, new ones for it, and the way back."""

from __future__ import annotations

import json as json_module
import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cyclopts import App

from tuberline.cli.address import NO_ADDRESS, LineAddress

if TYPE_CHECKING:
    from regressor.serve.client import Changed
    from regressor.serve.messages import WeightsState

weights = App(name="weights", help="The weights a running line weighs with: list, change, go back.")


@weights.command(name="list")
def list_(*, address: LineAddress = NO_ADDRESS, json: bool = False) -> None:
    """Print which weights each regressor weighs with, and what is wrong about that: others than those beside it, or
    than a running line was given before its regressors started again.

    Parameters
    ----------
    json
        For machines.
    """
    from conveyor.observer import Observer
    from regressor.serve.client import all_states
    from tuberline.doctor.finding import Level
    from tuberline.doctor.weights import check_running_weights, models_of_run

    link, name = address.link()
    with Observer(link, line=name) as observer:
        found = all_states(observer.session, name)
        wrong = [f for f in check_running_weights(found, models_of_run(observer)) if f.level is not Level.OK]
    if json:
        states = {key: asdict(state) for key, state in found.items()}
        _write({"line": name, "regressors": states, "wrong": [finding.text for finding in wrong]})
        return
    _print_states(found)
    if not any(state.refused for state in found.values()):  # which the table's words say already
        for finding in wrong:
            sys.stdout.write(f"{finding.text}\n  fix: {finding.fix}\n")


@weights.command
def use(file: Path, /, *, address: LineAddress = NO_ADDRESS, json: bool = False) -> None:
    """Let all regressors of a running line weigh with other weights; no view is lost.

    Every regressor first tries them on three reference clouds; if one refuses, all go on as before. What the ledger
    counts from then on carries their name. Who joins later takes them too. To start the line with them next time, set
    regressor.weights in its config.

    Parameters
    ----------
    file
        A .safetensors file with its .json beside it, or the authors' .pth.
    json
        For machines.
    """
    from conveyor.session import open_client
    from regressor.serve.check import check_weights
    from regressor.serve.client import use as give
    from regressor.serve.messages import read_parcel
    from regressor.weigh.weigher import Weigher

    link, name = address.link()
    parcel = read_parcel(file)
    # Here first: a file that is no good is refused before a byte of it is sent.
    check_weights(Weigher.load(file), address.loaded())
    with open_client(link, name="keeper") as session:
        changed = give(session, name, parcel, tell=_tell)
    _report(name, changed, json=json)


@weights.command
def rollback(*, address: LineAddress = NO_ADDRESS, json: bool = False) -> None:
    """Let all regressors go back to the weights before the last change; once more goes forward again.

    Parameters
    ----------
    json
        For machines.
    """
    from conveyor.session import open_client
    from regressor.serve.client import rollback as go_back

    link, name = address.link()
    with open_client(link, name="keeper") as session:
        changed = go_back(session, name, tell=_tell)
    _report(name, changed, json=json)


def _tell(text: str) -> None:
    sys.stderr.write(f"{text} ...\n")


def _write(report: dict[str, Any]) -> None:
    sys.stdout.write(json_module.dumps(report, indent=2) + "\n")


def _report(line: str, changed: Changed, *, json: bool) -> None:
    """What was changed; exits with 1 where a regressor did not take over."""
    if json:
        _write({"line": line, **asdict(changed)})
    else:
        _print_changed(changed)
    if changed.missed:
        sys.exit(1)


def _print_states(found: dict[str, WeightsState]) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    table = Table("regressor", "host", "order", "weighs with", "kept for a roll-back")
    for name, state in found.items():
        order = f"{state.n}" if state.n else "config"
        table.add_row(name, *map(escape, (state.host, order, state.model, state.previous_model or "-")))
    console = Console()
    console.print(table)
    for name, state in found.items():
        if state.refused:
            console.print(f"[red]{name} refuses[/] {escape(state.refused)}")


def _print_changed(changed: Changed) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console()
    if changed.reports:
        report = changed.reports[0]
        models = (f"{escape(model)} g" for model in (report.now_model, report.model))
        table = Table("reference cloud", "true g", *models, "difference")
        for old, new in zip(report.now_answers, report.answers, strict=True):
            percent = 100 * (new.weight_g / old.weight_g - 1)
            table.add_row(
                new.cloud, f"{new.true_g:.0f}", f"{old.weight_g:.1f}", f"{new.weight_g:.1f}", f"{percent:+.1f} %"
            )
        console.print(table)
    else:
        console.print("all regressors weigh with these weights already")
    _print_states(changed.after)
    for name, why in changed.missed.items():
        console.print(f"[red]{name} did not take over[/]: {escape(why)}; it follows by itself when it is back")
