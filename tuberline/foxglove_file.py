"""A run or a recording as one MCAP file for Foxglove: frames with their calibration, clouds, tubers, weights, totals.

The pictures are those of the viewer (`viewer.scene`). A run's ledger knows every tuber beforehand: each has its box
from the moment at which it comes into the picture, and is added to the load where it crossed the centre row.
"""

from __future__ import annotations

import json
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from conveyor.config import load_config
from conveyor.errors import InputError
from conveyor.formats import Refused, Source, camera_names, open_source
from conveyor.formats.cameras import none_readable
from conveyor.formats.conversion import Converted
from conveyor.formats.merged import in_time
from conveyor.messages import Frame, Totals, Tuber
from tuberline.replayer import CONFIG_FILE
from viewer.scene.belt_scene import BeltScene
from viewer.scene.load_scene import LoadScene
from viewer.scene.primitives import Entry, Moment
from viewer.scene.profiles import PROFILES

if TYPE_CHECKING:
    from viewer.foxglove.pen import Pen


GIVE_RECORDING = "give the recording of the run with --recording RECORDING"


@dataclass(frozen=True, slots=True)
class Counted:
    """What a ledger says of a run: its tubers, its belt's travel where the frames do not say it, its last totals.

    `travel` holds (capture time, metres) in order of time. `cameras` are those that it counted with.
    """

    tubers: tuple[Tuber, ...] = ()
    travel: tuple[tuple[int, float], ...] = ()
    totals: Totals | None = None
    cameras: tuple[str, ...] = ()

    def travel_at(self, captured_ns: int) -> float | None:
        """Travel by the marks of the first camera's log, interpolated; None outside of them."""
        i = bisect_left(self.travel, (captured_ns,))
        if i == len(self.travel) or (i == 0 and self.travel[0][0] != captured_ns):
            return None
        here, before = self.travel[i], self.travel[max(i - 1, 0)]
        share = (captured_ns - before[0]) / max(here[0] - before[0], 1)
        return before[1] + share * (here[1] - before[1])


def is_run(path: Path) -> bool:
    """A run's folder or its ledger, and no recording."""
    return (path / "ledger.db").is_file() or path.suffix == ".db"


def write_foxglove(
    source: Path,
    target: Path,
    *,
    recording: Path | None = None,
    run: str | None = None,
    belt_distance_m: float | None = None,
    depth_scale_m: float | None = None,
    on_frame: Callable[[int, int], None] = lambda done, total: None,
) -> Converted:
    """Write the run or the recording at `source` to the MCAP file `target`.

    `recording`: that of the run, where its settings do not name it or it lies elsewhere now. `run`: which one of the
    ledger.

    Raises:
        InputError: what cannot be read, no readable frame, a run whose recording is not there, or another one's.
        ConfigError: foxglove-sdk is not installed.
    """
    from viewer.foxglove.mcap_file import McapOutlet
    from viewer.foxglove.pen import Pen

    if target.suffix != ".mcap":
        raise InputError(f"{target}: for --format foxglove the name must end in .mcap")
    counted = _counted(source, run) if is_run(source) else Counted()
    frames = (recording or _recording_of(source)) if is_run(source) else source
    sources: list[Source] = [
        open_source(frames, camera=name, belt_distance_m=belt_distance_m, depth_scale_m=depth_scale_m)
        for name in camera_names(frames)
    ]
    if len(sources) < len(counted.cameras) and len(_named_by(source)) == 1:  # all of its cameras are in one recording
        names = ", ".join(one.description.name for one in sources)
        raise InputError(
            f"{frames} is not the recording of {source}: its cameras are {names}, and the run counted with "
            f"{', '.join(counted.cameras)}; {GIVE_RECORDING}"
        )
    total = sum(one.description.frames or 0 for one in sources)
    refused: Counter[str] = Counter()
    texts: list[str] = []
    done = 0
    with McapOutlet(target) as outlet:
        story = _Story(Pen(outlet), counted)
        for item in in_time(sources, run="recorded"):
            if isinstance(item, Refused):
                refused[item.reason] += 1
                texts.append(item.text)
            else:
                story.frame(item)
                outlet.come_to(item.captured_ns)
                done += 1
            on_frame(done + refused.total(), total)
        if refused and not done:
            raise none_readable(str(frames), texts[0])
        if (at_s := story.all_outside_s()) is not None:
            raise InputError(
                f"{frames} is not the recording of {source}: all tubers of the run crossed {abs(at_s):.1f} s and more "
                f"{'after its last' if at_s > 0 else 'before its first'} frame; {GIVE_RECORDING}"
            )
        story.end()
    return Converted(done, dict(refused), tuple(texts[:10]))


class _Story:
    """Frames in order of time, and between them the tubers that come into the picture and those that cross."""

    def __init__(self, pen: Pen, counted: Counted) -> None:
        self._pen = pen
        self._counted = counted
        self._belt, self._load = BeltScene(PROFILES["full"]), LoadScene()
        self._to_come = sorted(counted.tubers, key=lambda tuber: tuber.place_x_m)
        self._to_cross = sorted(counted.tubers, key=lambda tuber: (-tuber.crossed_ns, -tuber.tuber_id))
        self._first_ns: int | None = None
        self._newest_ns = 0
        self._say([*self._belt.opening(), *self._load.opening()])

    def frame(self, frame: Frame) -> None:
        """One picture with what rides in it."""
        if self._first_ns is None:
            self._first_ns = frame.captured_ns
        self._newest_ns = max(self._newest_ns, frame.captured_ns)
        self._say(self._belt.on_frame(frame))
        travel_m = frame.travel_m
        if travel_m is None and (travel_m := self._counted.travel_at(frame.captured_ns)) is not None:
            self._say(self._belt.on_known_travel(Moment(frame.captured_ns, frame.seq), travel_m))
        self._cross(frame.captured_ns)
        if travel_m is None:
            return
        while self._to_come and self._to_come[-1].place_x_m + travel_m >= self._belt.enters_at_m:
            self._say(self._belt.on_tuber(self._to_come.pop()))

    def all_outside_s(self) -> float | None:
        """By how much the nearest tuber crossed before the first frame (below 0) or after the last one, where all did;
        None where one crossed between them, or there is none.
        """
        if self._first_ns is None:
            return None
        outside = [
            min(tuber.crossed_ns - self._first_ns, 0) + max(tuber.crossed_ns - self._newest_ns, 0)
            for tuber in self._counted.tubers
        ]
        return min(outside, key=abs, default=0) / 1e9 or None

    def end(self) -> None:
        """What crossed with the last frames, and the load."""
        while self._to_come:
            self._say(self._belt.on_tuber(self._to_come.pop()))
        self._cross(None)
        if self._counted.totals is not None:
            self._say(self._load.on_totals(self._counted.totals, Moment(self._newest_ns)))

    def _cross(self, captured_ns: int | None) -> None:
        while self._to_cross and (captured_ns is None or self._to_cross[-1].crossed_ns <= captured_ns):
            tuber = self._to_cross.pop()
            self._say(self._load.on_tuber(tuber, Moment(tuber.crossed_ns)))

    def _say(self, entries: list[Entry]) -> None:
        for entry in entries:
            self._pen.draw(entry)


def _counted(source: Path, run: str | None) -> Counted:
    """What the ledger holds of a run."""
    from aggregator.ledger.reader import ledger_file, read_coverage, read_summary, read_tubers, reading, the_run

    with reading(ledger_file(source)) as view:
        row = the_run(view, source, run)
        marks = read_coverage(view, row.run, row.cameras[0], limit=10_000_000, newest=False) if row.cameras else []
        travel = sorted((int(mark[3]), float(mark[4])) for mark in marks)
        summary = read_summary(view, row.run)
        return Counted(tuple(read_tubers(view, row.run)), tuple(travel), _totals(summary), row.cameras)


def _totals(summary: str | None) -> Totals | None:
    """The totals of a summary, as far as a picture shows them; None for a run that has not ended."""
    if summary is None:
        return None
    said: dict[str, Any] = json.loads(summary).get("totals", {})
    shown = {f.name for f in fields(Totals)} - {"classes", "foreign", "load"}
    values = {name: value for name, value in said.items() if name in shown}
    return Totals(**{**values, "histogram": tuple(values.get("histogram", ()))})


def _settings_of(source: Path) -> Path:
    """Where the settings of a run lie, or would lie."""
    return (source if source.is_dir() else source.parent) / CONFIG_FILE


def _named_by(source: Path) -> set[Path]:
    """The recordings that a run's settings name; empty without them."""
    settings = _settings_of(source)
    cameras = load_config(settings).cameras.values() if settings.is_file() else ()
    return {camera.path for camera in cameras if camera.path is not None}


def _recording_of(source: Path) -> Path:
    """The recording that a run was made of, by the settings beside its ledger."""
    settings = _settings_of(source)
    if not settings.is_file():
        raise InputError(f"{settings.parent} has no {CONFIG_FILE} that names the recording; {GIVE_RECORDING}")
    paths = _named_by(source)
    if len(paths) != 1:
        said = "no recording" if not paths else f"{len(paths)} recordings"
        raise InputError(f"{settings} names {said}; {GIVE_RECORDING}")
    path = paths.pop()
    if not path.exists():
        raise InputError(f"{settings} names the recording {path}, which is not there; {GIVE_RECORDING}")
    return path
