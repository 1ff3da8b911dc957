"""Messages by the million: every decoder reads what `tests.fuzz.structure` builds, as built and with damaged bytes."""

from __future__ import annotations

import random
import resource
import sys
import time
import traceback
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from conveyor.messages.base import Message
from tests.fuzz.structure import CLASSES, Built, build, read

DAMAGED_SHARE = 0.25
"""Of the messages, with some bytes changed after they were built."""
TOLD_EVERY_S = 30.0


@dataclass(frozen=True, slots=True)
class Decoded:
    """What came of one decoder's messages; `broken` is how often the law did not hold."""

    name: str
    outcomes: Counter[str]
    seconds: float
    broken: int


def fuzz_messages(messages: int, *, seed: int, out: Path, names: list[str]) -> bool:
    """Print the table of all decoders; True where every message was taken or refused as it must be."""
    classes = [cls for cls in CLASSES if not names or cls.__name__ in names]
    write = sys.stdout.write
    write(f"seed {seed}\n| message | read | taken | refused, by reason | broken | seconds |\n")
    write("| --- | --- | --- | --- | --- | --- |\n")
    broken = 0
    for cls in classes:
        done = fuzz_one(cls, messages, seed=seed, out=out)
        reasons = ", ".join(f"{reason} {n}" for reason, n in done.outcomes.most_common() if reason != "value")
        write(
            f"| {done.name} | {done.outcomes.total() + done.broken} | {done.outcomes['value']} | {reasons} "
            f"| {done.broken} | {done.seconds:.0f} |\n"
        )
        sys.stdout.flush()
        broken += done.broken
    peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    write(f"peak memory of the process {peak_mib:.0f} MiB; {broken} broken{f', see {out}' if broken else ''}\n")
    return broken == 0


def fuzz_one(cls: type[Message], messages: int, *, seed: int, out: Path) -> Decoded:
    """Let one decoder read so many messages; what breaks the law is kept in `out`, ten of each decoder at most."""
    rng = random.Random(f"{seed} {cls.__name__}")
    draw = rng.random
    outcomes: Counter[str] = Counter()
    broken = 0

    def pick(options: Sequence[Any]) -> Any:
        """`rng.choice` takes four times as long, and is asked forty times a message."""
        return options[int(draw() * len(options))]

    begun_s = told_s = time.monotonic()
    for n in range(messages):
        built = build(cls, pick)
        if rng.random() < DAMAGED_SHARE:
            built = damage(built, rng)
        try:
            outcomes[read(cls, built)] += 1
        except BaseException as error:
            if isinstance(error, KeyboardInterrupt):
                raise
            broken += 1
            if broken <= 10:
                (out / f"{cls.__name__}-{n}.bin").write_bytes(built.data)
                (out / f"{cls.__name__}-{n}.txt").write_text("".join(traceback.format_exception(error))[-6000:])
        if n % 1000 == 0 and time.monotonic() - told_s > TOLD_EVERY_S:
            told_s = time.monotonic()
            sys.stderr.write(f"{cls.__name__}: {n} of {messages}, {broken} broken\n")
    return Decoded(cls.__name__, outcomes, time.monotonic() - begun_s, broken)


def damage(built: Built, rng: random.Random) -> Built:
    """The same message with one to four bytes changed, cut off or put in; whether it must be refused is not known."""
    data = bytearray(built.data)
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(min(len(data), 400) or 1)
        match rng.randrange(5):
            case 0:
                data[at : at + 1] = bytes([rng.randrange(256)])
            case 1:
                data[at : at + 1] = bytes([(data[at] if data else 0) ^ 1 << rng.randrange(8)])
            case 2:
                del data[at : at + rng.choice((1, 4, 1 << 20))]
            case 3:
                data[at:at] = rng.randbytes(rng.choice((1, 2, 8)))
            case 4:
                data[at:at] = data[at : at + rng.choice((1, 8, 64))]
    return replace(built, data=bytes(data), wrong="")
