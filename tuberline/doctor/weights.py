"""Which weights a line's regressors weigh with: all with the same, none refused, none lost by a restart; and whether
its tickets are of them."""

from __future__ import annotations

from collections.abc import Mapping

from conveyor import topics
from conveyor.config import LineConfig
from conveyor.errors import LinkError, TuberlineError
from conveyor.observer import Observer
from regressor.serve.messages import WeightsState
from regressor.weigh.weigher import VOLUME_MODEL
from tuberline.doctor.finding import Finding, fault, ok, warning

CHECK = "weights in use"


def models_of_run(observer: Observer) -> dict[str, int]:
    """Tubers of the present run by the weights that weighed them; empty where no aggregator is there that tells."""
    try:
        found = observer.query(topics.QUERY_LOADS, parameters="what=models", timeout_s=2.0)
    except LinkError:
        return {}
    return {str(model): int(n) for model, n in found.items()} if isinstance(found, dict) else {}


def check_tickets(config: LineConfig) -> list[Finding]:
    """Whether the tickets that the line names are of the weights that it is configured with."""
    from aggregator.calibration.tickets import read_tickets
    from aggregator.ledger.ticket_doubts import of_other_weights
    from regressor.network.stored import SHIPPED, read_weights

    file = config.aggregator.tickets
    if file is None:
        return []
    try:
        tickets = read_tickets(file)
    except TuberlineError as error:
        return [fault("tickets", str(error), "correct aggregator.tickets, or leave it out")]
    try:
        model = read_weights(config.regressor.weights or SHIPPED)[1].model_id
    except TuberlineError:  # a finding of its own, see `weights`
        return []
    for words in of_other_weights(tickets, [model]):
        return [warning("tickets", f"{file}: {words}", "weigh a bucket: `tuberline calibrate bucket RUN --kg ...`")]
    used = sum(ticket.model == model and not ticket.set_aside for ticket in tickets)
    return [ok("tickets", f"{file}: {used} of {model} in use")]


def check_running_weights(found: Mapping[str, WeightsState], models: Mapping[str, int]) -> list[Finding]:
    """Findings about the regressors `found`, by name; `models` as `models_of_run` gives them."""
    if not found:
        return []
    told = ", ".join(f"{name} {state.model}" for name, state in found.items())
    refusals = [
        fault(CHECK, f"{name} refuses {s.refused}", "`tuberline weights list`, then use or rollback")
        for name, s in found.items()
        if s.refused
    ]
    if refusals:
        return refusals
    if len({state.digest for state in found.values()}) > 1:
        fix = "give all of them the same: `tuberline weights use FILE`"
        return [fault(CHECK, f"regressors weigh with different weights: {told}", fix)]
    n = max(state.n for state in found.values())
    known = {VOLUME_MODEL, *(state.model for state in found.values())}
    others = ", ".join(f"{count} with {model}" for model, count in models.items() if model not in known)
    if others and not n:
        return [
            warning(
                CHECK,
                f"{told}, as their config says, and tubers of this run were weighed otherwise ({others}): what a "
                "running line was given is lost where its regressors start again without regressor.state_dir",
                "give them again, `tuberline weights use FILE`, and name them as regressor.weights in the config; if "
                "the config was changed on purpose, this is as it should be",
            )
        ]
    return [ok(CHECK, told + (f", given to the running line by order {n}" if n else ", as their config says"))]
