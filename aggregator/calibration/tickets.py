"""Load tickets: what a scale said of loads that were counted, and what follows for the loads to come.

All tubers of a load share an error (belt height, density, soil, the season's shapes) that does not shrink with the
count. A ticket measures it. With the log ratios r_i of ticket to estimate, the model is

    r_i ~ N(ln factor, s_load^2 + s_i^2),     ln factor ~ N(0, s_prior^2)

where s_i is the load's own random error (tubers, belt that was not seen, the scale) and s_load what still differs
from load to load. Its posterior gives the factor; the next load is known to `factor` times `exp(+-half_width)` at 90 %,
never better than one load differs from another. Tickets hold for the weights (model) that weighed them and no other.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from aggregator.ledger.files import write_whole
from conveyor.errors import InputError
from conveyor.statistics import NORMAL_90

PRIOR_SD = 0.05 / NORMAL_90
"""Of ln factor without any ticket: a load is then known to 5 % at 90 % (docs/ledger.md)."""

LOAD_SD = 0.015
"""Of what differs from load to load after calibration: soil on the tubers, moisture, the mix of shapes. An assumption:
no ticket of a real load was at hand. Three and more tickets replace it by their own scatter where that is larger."""

RATIO_RANGE = (0.75, 1.35)
"""A ticket outside of it is of another load, in other units, or the line did not see most of the belt."""

LEAST_COVERAGE = 0.8
FORMAT = 1


@dataclass(frozen=True, slots=True)
class Ticket:
    """A load that met a scale.

    Attributes:
        run: of the ledger; the same run counts once.
        model: weights that weighed it, name@digest.
        ticket_g, ticket_sd_g: what the scale said, net, and its standard deviation.
        estimated_g, estimated_sd_g: what Tuberline said before any calibration, for the whole belt, and its random
            error alone.
        coverage: share of the belt that was looked at.
    """

    run: str
    model: str
    ticket_g: float
    ticket_sd_g: float
    estimated_g: float
    estimated_sd_g: float
    coverage: float

    @property
    def log_ratio(self) -> float:
        """ln of ticket over estimate."""
        return math.log(self.ticket_g / self.estimated_g)

    @property
    def sd(self) -> float:
        """Random error of `log_ratio`."""
        return math.hypot(self.ticket_sd_g / self.ticket_g, self.estimated_sd_g / self.estimated_g)


@dataclass(frozen=True, slots=True)
class LoadFactor:
    """What a weight by `model` is multiplied with, and the 90 % half-width of what is left, as a share of it."""

    model: str
    factor: float
    half_width: float
    tickets: int


def load_factor(tickets: Sequence[Ticket], model: str) -> LoadFactor | None:
    """The calibration that the tickets of `model` give; None where there are none."""
    of_model = [ticket for ticket in tickets if ticket.model == model]
    if not of_model:
        return None
    ratios = [ticket.log_ratio for ticket in of_model]
    between = LOAD_SD
    if len(ratios) >= 3:
        mean = sum(ratios) / len(ratios)
        seen = math.sqrt(sum((ratio - mean) ** 2 for ratio in ratios) / (len(ratios) - 1))
        between = max(between, seen)
    weights = [1 / (between**2 + ticket.sd**2) for ticket in of_model]
    precision = 1 / PRIOR_SD**2 + sum(weights)
    mean = sum(weight * ratio for weight, ratio in zip(weights, ratios, strict=True)) / precision
    half_width = NORMAL_90 * math.hypot(between, 1 / math.sqrt(precision))
    return LoadFactor(model, math.exp(mean), half_width, len(of_model))


def check_ticket(ticket: Ticket) -> Ticket:
    """The ticket, if it can be one of this load.

    Raises:
        InputError: it cannot; the text says which figure is off and what to look for.
    """
    if not (math.isfinite(ticket.ticket_g) and ticket.ticket_g > 0):
        raise InputError(f"the ticket says {ticket.ticket_g / 1000:g} kg: give the load's net weight, above 0 kg")
    if ticket.estimated_g <= 0:
        raise InputError(f"run {ticket.run} counted no tuber: there is nothing to calibrate")
    if ticket.coverage < LEAST_COVERAGE:
        raise InputError(
            f"run {ticket.run} looked at {100 * ticket.coverage:.0f} % of the belt, a ticket needs at least "
            f"{100 * LEAST_COVERAGE:.0f} %: calibrate with a load that was seen whole"
        )
    ratio = ticket.ticket_g / ticket.estimated_g
    low, high = RATIO_RANGE
    if not low <= ratio <= high:
        raise InputError(
            f"the ticket says {ticket.ticket_g / 1000:.1f} kg, run {ticket.run} {ticket.estimated_g / 1000:.1f} kg: "
            f"a ratio of {ratio:.2f}, allowed is {low} to {high}; is it the same load, net, in kilograms?"
        )
    return ticket


def with_ticket(tickets: Sequence[Ticket], ticket: Ticket, *, again: bool) -> tuple[Ticket, ...]:
    """`tickets` with one more; a run has one ticket.

    Raises:
        InputError: the run has one already and `again` is not given.
    """
    others = tuple(known for known in tickets if known.run != ticket.run)
    if len(others) < len(tickets) and not again:
        raise InputError(f"run {ticket.run} has a ticket already; give --again to replace it")
    return (*others, ticket)


def read_tickets(path: Path) -> tuple[Ticket, ...]:
    """The tickets in the JSON file at `path`.

    Raises:
        InputError: unreadable, of another format, or with a ticket that cannot be one.
    """
    try:
        raw: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"tickets {path} cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"tickets {path} are not JSON: {error}") from error
    if not isinstance(raw, dict) or raw.get("format") != FORMAT or not isinstance(raw.get("tickets"), list):
        raise InputError(f'tickets {path}: want {{"format": {FORMAT}, "tickets": [...]}} as `calibrate load` writes it')
    return tuple(_ticket(item, n, path) for n, item in enumerate(raw["tickets"]))


def _ticket(item: Any, n: int, path: Path) -> Ticket:
    names = Ticket.__dataclass_fields__
    if not isinstance(item, dict) or set(item) != set(names):
        raise InputError(f"tickets {path}: ticket {n} must have exactly {', '.join(names)}")
    texts = {name: item[name] for name in ("run", "model")}
    numbers = {name: item[name] for name in names if name not in texts}
    for name, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or value < 0:
            raise InputError(f"tickets {path}: ticket {n}: {name} is {value!r}, must be a number of at least 0")
    if not all(isinstance(text, str) for text in texts.values()):
        raise InputError(f"tickets {path}: ticket {n}: run and model must be texts")
    return check_ticket(replace(Ticket("", "", 0, 0, 0, 0, 0), **texts, **numbers))


def write_tickets(path: Path, tickets: Sequence[Ticket]) -> None:
    """Write all tickets, whole or not at all."""
    text = json.dumps({"format": FORMAT, "tickets": [asdict(ticket) for ticket in tickets]}, indent=2)
    write_whole(path, text + "\n")
