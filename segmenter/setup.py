"""From the line's config to the settings of the core."""

from __future__ import annotations

from pathlib import Path

from conveyor.config import LineConfig
from segmenter.belt_segmenter import MARK_MARGIN_M
from segmenter.camera_run import LIVE_MARK_EVERY_NS, MARK_EVERY_NS, RunSettings
from segmenter.dispatch.dispatcher import DispatchSettings
from segmenter.frame.instances import SplitSettings
from segmenter.perception import PerceptionSettings
from segmenter.pipeline import Settings
from segmenter.track.counting import CountSettings
from segmenter.track.tracker import DECIDE_M, TrackSettings

LIVE_DECIDE_M = 0.040
"""Metres past the centre row at which a live line closes a track; a replay, where no one waits, sees it for
`DECIDE_M`. Every tuber of the line waits for the belt to move so far. Shorter is earlier, and sees fewer
frames; see docs/performance.md for what it changed on simulated belts."""

LIVE_MARK_MARGIN_M = 0.005
"""Metres that a live line's marks stay behind what may still be decided; every tuber waits for the belt to move so far,
twice where cameras overlap. Places move by 2.1 mm at most until then; what comes late is still counted once."""


def core_settings(config: LineConfig, *, live: bool = False) -> Settings:
    """Settings of segmentation, tracking and counting."""
    s = config.segmenter
    return Settings(
        split=SplitSettings(pixel_mm=s.pixel_mm, min_area_mm2=s.min_area_mm2, min_height_mm=s.min_height_mm),
        track=TrackSettings(gate_m=s.gate_mm / 1000, decide_m=LIVE_DECIDE_M if live else DECIDE_M, take_turns=live),
        count=CountSettings(min_frames=s.min_frames, min_height_m=s.min_height_mm / 1000, reject_below=s.reject_below),
        perception=PerceptionSettings(method=s.method, weights=s.weights),
        views_per_tuber=s.views_per_tuber,
        belt_sd_m=s.belt_sd_mm / 1000,
        resting=config.belt.resting_level,
        belt_follow_m=s.belt_follow_mm / 1000,
        early_views=live,
        hold_for_doubtful=not live,
        mark_margin_m=LIVE_MARK_MARGIN_M if live else MARK_MARGIN_M,
        gauge=config.belt.known_gauge,
        scale_by_travel=config.belt.gauge == "travel",
    )


def run_settings(config: LineConfig, camera: str) -> RunSettings:
    """Settings of one camera's run. A camera that waits is held back under load; one that does not sheds views."""
    s, c = config.segmenter, config.camera(camera)
    waits = c.held_back
    return RunSettings(
        core=core_settings(config, live=not waits),
        dispatch=DispatchSettings(
            credits=s.credits,
            deadline_s=s.job_deadline_s,
            max_attempts=s.max_attempts,
            shed_over=None if waits else s.max_pending_views,
            first_wait_s=s.weigh_deadline_s / 2,
            spare_wait_s=s.spare_wait_s,
        ),
        weigh_deadline_s=s.weigh_deadline_s,
        max_pending_views=s.max_pending_views,
        window=c.window,
        mark_every_ns=MARK_EVERY_NS if waits else LIVE_MARK_EVERY_NS,
        spare_grace_s=None if waits else s.spare_grace_s,
        fewer_views=not waits,
        free_share=s.free_share if config.regressor.processes else 0.0,
        log_behind=True,
        replays=waits,
    )


def log_path(config: LineConfig, camera: str, run: str) -> Path | None:
    """File of a camera's log in a run; None where nothing is kept across restarts."""
    folder = config.segmenter.state_dir
    return None if folder is None else folder / f"{config.name}.{camera}.{run}.db"
