"""Damaged bytes: a good file or message with a few edits. And a bound on the memory that reading them may take."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from conveyor.errors import TuberlineError

EFFORT = float(os.environ.get("TUBERLINE_FUZZ", "0"))
"""Times as many examples, new ones each run; 0: few, and the same ones each time."""
MOST_MIB = 300
"""What all examples of one test together may add to the process' peak memory."""

ANY_JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=20) | st.binary(max_size=20),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)


def quick(examples: int) -> settings:
    """Hypothesis settings of these tests: any example may take long on a busy machine."""
    return settings(
        max_examples=int(examples * EFFORT) if EFFORT else max(20, examples // 3),
        deadline=None,
        derandomize=EFFORT == 0,
        suppress_health_check=list(HealthCheck),
        print_blob=True,
    )


@st.composite
def damaged(draw: Callable[[Any], Any], good: bytes, *, head: int = 1 << 30) -> bytes:
    """`good` with up to six edits, most of them within its first `head` bytes: the part that says how to read it."""
    data = bytearray(good)
    for _ in range(draw(st.integers(1, 6))):
        if not data:
            break
        reach = min(len(data), head) if draw(st.integers(0, 4)) else len(data)
        at = draw(st.integers(0, reach - 1))
        match draw(st.sampled_from(["set", "flip", "cut", "drop", "add", "repeat", "number"])):
            case "set":
                data[at] = draw(st.integers(0, 255))
            case "flip":
                data[at] ^= 1 << draw(st.integers(0, 7))
            case "cut":
                del data[at:]
            case "drop":
                del data[at : at + draw(st.integers(1, 64))]
            case "add":
                data[at:at] = draw(st.binary(min_size=1, max_size=24))
            case "repeat":
                data[at:at] = data[at : at + draw(st.integers(1, 64))]
            case "number":
                data[at:at] = b"9" * draw(st.sampled_from([1, 4, 9, 18, 5000]))
    return bytes(data)


def outcome(read: Callable[[], object]) -> str:
    """'value', or the name of the error of ours; anything else is raised on and is a bug."""
    try:
        read()
    except TuberlineError as error:
        return type(error).__name__ if str(error).strip() else "an error without a word"
    return "value"


@contextmanager
def bounded_memory() -> Iterator[None]:
    """Fails where the process' peak memory grew by more than `MOST_MIB` inside."""
    Path("/proc/self/clear_refs").write_text("5")
    before = _peak_mib()
    yield
    grown = _peak_mib() - before
    assert grown < MOST_MIB, f"reading damaged input took {grown:.0f} MiB"


def _peak_mib() -> float:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024
    raise RuntimeError("no VmHWM in /proc/self/status")
