"""`tuberline score`: a run against the truth."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path


def score(
    run_dir: Path,
    /,
    *,
    truth: Path,
    match_mm: float = 25.0,
    run: str | None = None,
    contract: Path | None = None,
    json: bool = False,
) -> None:
    """Compare a run with the truth: count, per-tuber weights, total weight.

    Of a run that counted nothing it says so, and how much of the belt was seen. In JSON weights are null where no belt
    was seen.

    Parameters
    ----------
    run_dir
        Folder of a run (with its ledger.db), or the ledger itself.
    truth
        The recording's truth.json, or the folder that holds it.
    match_mm
        A counted tuber and a true one farther apart than this are two.
    run
        Which run, where the ledger holds several.
    contract
        A buyer's classes of size (TOML): their shares of the weight are compared too.
    json
        Print the score as JSON on stdout.
    """
    from aggregator.scoring.score import score_run

    result = score_run(run_dir, truth=truth, match_mm=match_mm, run=run)
    classes = []
    if contract is not None:
        from aggregator.scoring.classes import score_classes
        from conveyor.contract import read_contract

        classes = score_classes(run_dir, truth=truth, contract=read_contract(contract), run=run)
    if json:
        told = result.as_dict() | ({"classes": classes} if contract is not None else {})
        sys.stdout.write(json_module.dumps(told, indent=2) + "\n")
        return
    from rich.console import Console

    from tuberline.cli.ledger_tables import score_table

    Console().print(score_table(result))
    if classes and result.count:
        from tuberline.cli.class_table import class_score_table

        Console().print(class_score_table(classes))
