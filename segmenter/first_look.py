"""A recording is looked at before it is counted: its first tubers are weighed by a camera that is known already.

A live line learns what its camera does to outlines from the tubers that pass, and what passed before stays as it was
weighed. A recording can be looked at twice.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from conveyor.config import LineConfig
from conveyor.errors import InputError
from conveyor.formats.configured import recorded_source
from conveyor.formats.source import within_ranges
from conveyor.messages import Frame
from conveyor.reasons import TrackRefusal
from segmenter.known import Known
from segmenter.pipeline import Segmenter
from segmenter.setup import run_settings

ENOUGH, MOST_FRAMES = 60, 2000
"""Tubers, clods and stones after which camera and belt are known: as many as are remembered of either. Frames that are
looked at for them at most."""


@dataclass(frozen=True, slots=True)
class FirstLook:
    """What a look at a recording has shown; `known` is None where no belt was seen, `bodies` are tubers and others."""

    known: Known | None
    frames: int
    bodies: int


def look_first(config: LineConfig, camera: str, *, go_on: Callable[[], bool] = lambda: True) -> FirstLook | None:
    """Look at the beginning of a camera's recording as it will be counted, and count nothing; None where the config
    asks for no look, or the camera is live.

    Args:
        go_on: asked before each frame; the look ends where it says no.
    """
    if not config.segmenter.look_first or not config.camera(camera).held_back:
        return None
    core = Segmenter(run_settings(config, camera).core)
    frames = 0
    with suppress(InputError):  # the count meets it again, and says so
        for item in recorded_source(config, camera).frames(run="first-look"):
            if not go_on() or frames == MOST_FRAMES or _bodies(core) >= ENOUGH:
                break
            frame = within_ranges(item)
            if isinstance(frame, Frame):
                core.step(frame)
                frames += 1
        core.finish()
    return FirstLook(core.known, frames, _bodies(core))


def _bodies(core: Segmenter) -> int:
    return core.counted + core.discarded[TrackRefusal.DISTRACTOR]
