"""Coverage-guided fuzzing of one target, by atheris. Started by `python -m benchmarks fuzz`.

    python -m tests.fuzz.atheris_run TARGET OUT FOLDER [libFuzzer options and corpus folders]

Any exception that is no error of ours, or an error without a word, is a finding: its first input and its traceback go
into OUT, once for each place in the code, and the search goes on; so does one that takes too much processor time or
memory. Crashes and hangs in native code are libFuzzer's to notice. FOLDER is empty and takes the files that are read.
"""

from __future__ import annotations

import logging
import resource
import signal
import sys
import traceback
from pathlib import Path

import atheris

INSTRUMENTED = ["aggregator", "camera_sim", "conveyor", "mcap", "regressor", "rosbags", "segmenter"]
HANG_CPU_S = 5.0
"""Of processor time: a machine that is busy with other work makes nothing a hang."""
MOST_MORE_BYTES = 1 << 30
"""Address space that reading may take beyond what the process had before: more ends in a MemoryError, a finding."""

with atheris.instrument_imports(include=INSTRUMENTED):
    from conveyor.errors import TuberlineError
    from tests.fuzz.targets import TARGETS, Read


class TookTooLongError(BaseException):
    """An input used up its processor time. No `Exception`: the code under test must not catch it."""


class Findings:
    """Distinct ways in which a target failed, kept as files."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._known: set[tuple[str, str]] = set()

    def watch(self, read: Read, data: bytes) -> None:
        """Read one input; note what must not happen."""
        try:
            signal.setitimer(signal.ITIMER_PROF, HANG_CPU_S)
            try:
                read(data or b"\x00")
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0.0)
        except TuberlineError as error:
            if not str(error).strip():
                self._note(error, data)
        except (KeyboardInterrupt, SystemExit):
            raise
        except BaseException as error:  # a Rust extension's panic is no Exception
            self._note(error, data)

    def _note(self, error: BaseException, data: bytes) -> None:
        frames = traceback.extract_tb(error.__traceback__)
        ours = [frame for frame in frames if ".venv" not in frame.filename and "/lib/python" not in frame.filename]
        place = (type(error).__name__, f"{ours[-1].filename}:{ours[-1].lineno}")
        if place in self._known:
            return
        self._known.add(place)
        name = f"finding-{len(self._known)}"
        (self._out / f"{name}.bin").write_bytes(data)
        shown = "".join(traceback.format_exception(error, limit=-8))
        (self._out / f"{name}.txt").write_text(f"{place[0]} at {place[1]}\n{shown[-6000:]}", errors="replace")


def _too_long(_number: int, _frame: object) -> None:
    raise TookTooLongError(f"more than {HANG_CPU_S:g} s of processor time for one input")


def main() -> None:
    """Fuzz until libFuzzer's options say stop; it ends the process, so that whoever started this removes FOLDER."""
    target, out, folder = sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3])
    logging.disable(logging.CRITICAL)
    signal.signal(signal.SIGPROF, _too_long)
    with atheris.instrument_imports(include=INSTRUMENTED):
        seeds, read = TARGETS[target](folder)
    for n, seed in enumerate(seeds):
        (out / "seeds" / f"{n}").write_bytes(seed)
    findings = Findings(out)
    atheris.Setup([sys.argv[0], *sys.argv[4:]], lambda data: findings.watch(read, data))
    had = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (had + MOST_MORE_BYTES, resource.RLIM_INFINITY))
    atheris.Fuzz()


if __name__ == "__main__":
    main()
