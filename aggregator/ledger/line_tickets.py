"""Which tickets calibrate a ledger that is read: those of its line, and those that are given for all."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from aggregator.calibration.tickets import Ticket, same_tubers
from aggregator.ledger.copies import refuse_copies
from aggregator.ledger.load_totals import ReadLoads, tickets_of
from aggregator.ledger.reader import ledger_file, reading
from conveyor.config import LINE_NAME, REPLAY_NAME

UNNAMED = {LINE_NAME, REPLAY_NAME}
"""Names of lines that no one named: two of them may be of different cameras."""


@dataclass(frozen=True, slots=True)
class LedgerTickets:
    """`tickets`: all that calibrate a ledger. In words, `unread`: what of the line's config cannot be read; `refused`:
    why tickets of its own loads cannot calibrate, by their numbers; `unshared`: why those of its loads calibrate no
    other ledger of a line that is called the same.
    """

    tickets: list[Ticket]
    unread: tuple[str, ...]
    refused: dict[int, str]
    unshared: list[str]


def line_tickets(ledgers: Sequence[ReadLoads], given: Sequence[Ticket] = ()) -> list[LedgerTickets]:
    """What calibrates each of `ledgers` where they are read together.

    Its loads' own tickets, those that the config beside it names, those of the loads of the same line in the other
    ledgers, and those `given`, which hold for all. A line that was started in another folder has the same cameras.
    Lines that no one named may be different ones: they share none.

    Raises:
        LedgerError: two of them hold the same run.
    """
    refuse_copies(ledgers)
    own = [tickets_of(ledger, ledger.seen, cultivar=ledger.stated.cultivar) for ledger in ledgers]
    loads = [(ledger, tickets) for ledger, (tickets, _) in zip(ledgers, own, strict=True)]
    found = []
    for ledger, (mine, words) in zip(ledgers, own, strict=True):
        named = (*ledger.stated.tickets, *given)
        aside = [ticket for ticket in named if ticket.set_aside]
        others = [t for t in _of_line(ledger, loads) if not any(same_tubers(t, one) for one in aside)]
        unshared = _unshared(ledger, ledgers) if mine else []
        found.append(LedgerTickets(with_own(named, [*mine, *others]), ledger.stated.words, words, unshared))
    return found


def _unshared(ledger: ReadLoads, ledgers: Sequence[ReadLoads]) -> list[str]:
    lines = {run.line for other in ledgers if other is not ledger for run in other.runs.values()}
    names = sorted({run.line for run in ledger.runs.values()} & lines & UNNAMED)
    return [
        f"load tickets of {', '.join(ledger.runs)} calibrate no other run here: whether lines called '{name}' are one "
        "is not known. --tickets calibrates all; runs to come share them where the line's file gives its line a name"
        for name in names
    ]


def _of_line(ledger: ReadLoads, loads: Sequence[tuple[ReadLoads, Sequence[Ticket]]]) -> list[Ticket]:
    """The tickets of its line's loads in other ledgers; of a run that several of them hold each once."""
    lines = {run.line for run in ledger.runs.values()} - UNNAMED
    found = {
        ticket.key: ticket
        for other, tickets in loads
        for ticket in tickets
        if ticket.run not in ledger.runs and other.runs[ticket.run].line in lines
    }
    return list(found.values())


def tickets_beside(ledger: ReadLoads) -> list[Ticket]:
    """All that calibrates a ledger that is read by itself."""
    (found,) = line_tickets([ledger])
    return found.tickets


def tickets_by_ledger(paths: Sequence[Path]) -> list[list[Ticket]]:
    """What calibrates each of several ledgers (or folders of runs), in their order."""
    files = [ledger_file(path).resolve() for path in paths]
    with ExitStack() as stack:
        ledgers = {file: ReadLoads(stack.enter_context(reading(file))) for file in dict.fromkeys(files)}
        found = dict(zip(ledgers, line_tickets(list(ledgers.values())), strict=True))
    return [found[file].tickets for file in files]


def with_own(given: Sequence[Ticket], own: Sequence[Ticket]) -> list[Ticket]:
    """All tickets: of those that hold the same tubers the loads' own, else the later one given."""
    latest = {ticket.key: ticket for ticket in given}.values()
    return [*(ticket for ticket in latest if not any(same_tubers(ticket, one) for one in own)), *own]
