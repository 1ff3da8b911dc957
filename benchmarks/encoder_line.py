"""A live line whose cameras know nothing of the belt: a recording without its travel, beside a board that counts it."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from aggregator.ledger.writer import Ledger
from benchmarks.belt_tables import travel_told, without_travel
from benchmarks.encoder_board import METRES_PER_PULSE, EncoderBoard
from conveyor.config import LineConfig, dump_toml, parse_config
from conveyor.messages import Counters, Tuber
from conveyor.observer import observer_when_there
from conveyor.taken_port import free_port
from tuberline.processes import line_processes
from tuberline.supervisor import Supervisor

STARTS_S = 15.0
"""Processes are there by then."""
ENDS_WITHIN_S = 120.0
RUN = "live"
Act = Callable[["EncoderLine", Supervisor], None]


class EncoderLine:
    """One line of real processes; `run` plays it to its end.

    Args:
        folder: where everything is written.
        recording: a folder recording with truth and travel; its cameras play it at `speed`.
        encoder: whether the line has one.
    """

    def __init__(self, folder: Path, recording: Path, *, speed: float, encoder: bool = True) -> None:
        self._folder = folder
        self.recording = recording
        bare = without_travel(recording, folder / "recording")
        told = {table.parent.name: travel_told(table) for table in sorted(recording.glob("*/frames.csv"))}
        self.cameras = list(told)
        first_ns = {name: rows[0][0] for name, rows in told.items()}
        began_ns, starts_s = min(first_ns.values()), time.time() + STARTS_S
        self.board = EncoderBoard(told[self.cameras[0]], began_ns=began_ns, starts_s=starts_s, speed=speed)
        self.nodes: dict[str, Counters] = {}
        section = {"source": f"tcp://127.0.0.1:{self.board.port}", "metres_per_pulse": METRES_PER_PULSE}
        self.config: LineConfig = parse_config(
            {
                "link": {"router": f"tcp/127.0.0.1:{free_port()}"},
                "cameras": {
                    name: {
                        "path": str(bare),
                        "camera": name,
                        "waits": False,
                        "speed": speed,
                        "starts_at_s": starts_s + (at_ns - began_ns) / 1e9 / speed,
                    }
                    for name, at_ns in first_ns.items()
                },
                "segmenter": {"state_dir": str(folder / "state"), "max_age_ms": 2000.0},
                "regressor": {"processes": 1, "state_dir": str(folder / "weights")},
                "aggregator": {"out": str(folder / "run"), "exit_when_final": True},
                **({"encoder": section} if encoder else {}),
            },
            where="of this line",
        )

    def run(self, acts: Sequence[tuple[float, Act]] = ()) -> None:
        """To its end; each act is done when that share of the belt has passed.

        Raises:
            TimeoutError: it does not end.
        """
        file = self._folder / "line.toml"
        file.write_text(dump_toml(self.config))
        specs = line_processes(self.config, config_path=file, run=RUN)
        to_do = list(acts)
        with ExitStack() as stack:
            stack.enter_context(self.board)
            line = stack.enter_context(Supervisor(specs, log_dir=self._folder / "logs"))
            observer = stack.enter_context(
                observer_when_there(self.config.link, line=self.config.name, meanwhile=line.poll)
            )
            while not line.finished("aggregator"):
                if to_do and self.board.done >= to_do[0][0]:
                    to_do.pop(0)[1](self, line)
                if time.time() > self.board.ends_s + ENDS_WITHIN_S:
                    raise TimeoutError(f"the line in {self._folder} has not ended {ENDS_WITHIN_S:g} s after its belt")
                line.poll()
                time.sleep(0.02)
            self.nodes = observer.nodes()

    @property
    def summary(self) -> dict[str, Any]:
        """As the aggregator left it."""
        found: dict[str, Any] = json.loads((self._folder / "run" / "summary.json").read_text())
        return found

    @property
    def tubers(self) -> list[Tuber]:
        """Of the ledger."""
        with Ledger(self._folder / "run" / "ledger.db") as ledger:
            return list(ledger.tubers(RUN))

    @property
    def places_m(self) -> list[float]:
        """Where along the belt the tubers truly lie."""
        truth = json.loads((self.recording / "truth.json").read_text())
        return [float(tuber["place_x_m"]) for tuber in truth["tubers"]]

    def log(self, name: str) -> str:
        """What a process said."""
        return (self._folder / "logs" / f"{name}.log").read_text()

    def left_out(self) -> int:
        """Frames that its segmenters dropped or never got."""
        of_segmenters = [node.gauges for name, node in self.nodes.items() if name.startswith("segmenter/")]
        return round(
            sum(
                level
                for gauges in of_segmenters
                for name, level in gauges.items()
                if name.startswith("frames_dropped_") or name == "frames_gaps"
            )
        )


def mute(line: EncoderLine, _: Supervisor) -> None:
    """The board's cable is out."""
    line.board.mute = True


def speak(line: EncoderLine, _: Supervisor) -> None:
    """It is in again; the board has counted on."""
    line.board.mute = False


def lose_count(line: EncoderLine, _: Supervisor) -> None:
    """The board was without power for a moment."""
    line.board.lose_count()


def kill_encoder(_: EncoderLine, processes: Supervisor) -> None:
    """Its process dies."""
    _kill(processes, ["encoder"])


def cut_power(line: EncoderLine, processes: Supervisor) -> None:
    """Encoder, cameras and segmenters die at once, and the board loses its count."""
    line.board.lose_count()
    _kill(processes, ["encoder", *(f"{role}-{name}" for role in ("segmenter", "camera") for name in line.cameras)])


def _kill(processes: Supervisor, names: Sequence[str]) -> None:
    for name in names:
        if (pid := processes.pid(name)) is not None:
            os.kill(pid, signal.SIGKILL)
