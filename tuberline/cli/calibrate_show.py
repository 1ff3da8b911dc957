"""`tuberline calibrate show` and `set-aside`: what tickets say of each other, and which of them count."""

from __future__ import annotations

import json as json_module
import sys
from pathlib import Path
from typing import Any

from tuberline.cli.numbers import RestingOffset


def show(
    tickets: Path, /, *, model: str | None = None, resting_offset_mm: RestingOffset | None = None, json: bool = False
) -> None:
    """Each ticket against what all others expect of it, and what accuracy more tickets would bring.

    Parameters
    ----------
    tickets
        File of tickets.
    model
        Weights to show, where the file holds tickets of several.
    resting_offset_mm
        Resting offset that the line states now; default: what it stated at its newest ticket.
    json
        Print the table as JSON on stdout.
    """
    from aggregator.calibration.tickets import read_tickets

    known = read_tickets(tickets)
    models = sorted({ticket.model for ticket in known})
    told = [_of_model(known, name, resting_offset_mm) for name in models if model in (None, name)]
    if json:
        sys.stdout.write(json_module.dumps(told, indent=2) + "\n")
        return
    if not told:
        sys.stdout.write(f"no ticket of {model or 'any weights'} in {tickets}; weights known: {', '.join(models)}\n")
    for found in told:
        sys.stdout.write(_text(found))


def set_aside(
    tickets: Path,
    /,
    *,
    run: str,
    reason: str = "",
    kind: str | None = None,
    part: str | None = None,
    back: bool = False,
) -> None:
    """Take a ticket out of use; it stays in the file with the reason. Or take it back.

    Parameters
    ----------
    tickets
        File of tickets.
    run
        Run that the ticket is of.
    reason
        Why it is not used: what was found to be wrong with it.
    kind
        load, bucket or tubers, where the run has several tickets.
    part
        Of the run, as `calibrate show` names it after the run, where it has several of a kind.
    back
        Use it again.
    """
    from aggregator.calibration import tickets as kept
    from conveyor.errors import InputError

    if back == bool(reason.strip()):
        raise InputError('give either --reason "what is wrong with the ticket" or --back to use it again')
    known = kept.set_aside(kept.read_tickets(tickets), run, kind=kind, part=part, reason=reason.strip())
    kept.write_tickets(tickets, known)
    sys.stdout.write(f"run {run}: {'used again' if back else f'set aside: {reason.strip()}'}\n")


def _of_model(known: tuple[Any, ...], model: str, stated_mm: float | None) -> dict[str, Any]:
    from aggregator.calibration.apply import load_factor, told
    from aggregator.calibration.correction import Prior, usable
    from aggregator.calibration.leave_one_out import leave_one_out
    from aggregator.calibration.robust import correction_of, expected_accuracy
    from tuberline.cli.calibration_told import correction_values

    used = usable(known, model)
    newest = next((ticket for ticket in reversed(known) if ticket in used), None)
    cultivar = newest.cultivar if newest else ""
    prior = Prior(stated_offset_mm=stated_mm if stated_mm is not None else newest.stated_offset_mm if newest else 0.0)
    correction = correction_of(known, model, prior, cultivar=cultivar)
    weighed_g = sum(ticket.estimated_g for ticket in used)
    per_mm = sum(ticket.grams_per_mm for ticket in used) / weighed_g if used else None
    factor = load_factor(known, model, prior, cultivar=cultivar)
    return {
        "model": model,
        "cultivar": cultivar,
        "told": told(correction) if used else "no ticket in use",
        "factor": factor.factor if factor else None,
        "correction": correction_values(correction),
        "tickets": [
            {
                "kind": entry.ticket.kind,
                "run": entry.ticket.run,
                "part": entry.ticket.part,
                "scale_kg": entry.ticket.ticket_g / 1000,
                "raw_kg": entry.ticket.estimated_g / 1000,
                "expected_kg": entry.expected_g / 1000,
                "apart_percent": 100 * (entry.ticket.ticket_g / entry.expected_g - 1),
                "sd_percent": 100 * entry.sd,
                "z": entry.z,
                "contradicts": entry.contradicts,
                "set_aside": entry.ticket.set_aside,
            }
            for entry in leave_one_out(known, model, prior)
        ],
        "half_width_after_more": expected_accuracy(known, model, prior, per_mm=per_mm, cultivar=cultivar),
    }


def _text(found: dict[str, Any]) -> str:
    lines = [f"{found['model']}: {found['told']}"]
    lines += [
        f"  cultivar {name}: factor {value['mean']:.3f} +- {value['half_width_90']:.3f}"
        for name, value in found["correction"]["cultivars"].items()
    ]
    lines.append(f"{'ticket':<36}{'scale kg':>11}{'raw kg':>11}{'others kg':>11}{'apart':>9}{'sd':>8}  verdict")
    for row in found["tickets"]:
        name = " ".join(filter(None, (row["kind"], row["run"], row["part"])))
        verdict = f"set aside: {row['set_aside']}" if row["set_aside"] else ""
        if row["contradicts"]:
            verdict = f"CONTRADICTS the others by {abs(row['z']):.1f} sd"
        lines.append(
            f"{name[:35]:<36}{row['scale_kg']:>11.3f}{row['raw_kg']:>11.3f}{row['expected_kg']:>11.3f}"
            f"{row['apart_percent']:>+8.1f}%{row['sd_percent']:>7.1f}%  {verdict}".rstrip()
        )
    of = f" of {found['cultivar']}" if found["cultivar"] else ""
    lines.append(f"a load{of} is known to, 90 %, with n more load tickets:")
    lines.append("  ".join(f"{n}: {100 * width:.1f} %" for n, width in found["half_width_after_more"].items()))
    return "\n".join(lines) + "\n\n"
