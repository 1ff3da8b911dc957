"""`--ignore-masks`: a recording that has masks is given out as if it had none."""

from __future__ import annotations

from pathlib import Path

from camera_sim.configured import configured_source
from conveyor.formats import open_source
from conveyor.messages import Frame
from tuberline.replayer import replay_config


def test_masks_are_left_out_where_the_replay_says_so_and_nothing_else(small_recording: Path, tmp_path: Path) -> None:
    def first(ignore_masks: bool) -> Frame:
        config = replay_config(
            small_recording,
            ["front"],
            out=tmp_path,
            speed=0.0,
            weights=None,
            regressors=1,
            rrd=None,
            settings=None,
            ignore_masks=ignore_masks,
        )
        frame = next(iter(configured_source(config, "front").frames(run="x")))
        assert isinstance(frame, Frame)
        return frame

    with_masks, without = first(False), first(True)
    assert with_masks.mask is not None
    assert without.mask is None
    assert (with_masks.depth == without.depth).all()
    assert all(
        not isinstance(f, Frame) or f.mask is None
        for f in open_source(small_recording, ignore_masks=True).frames(run="x")
    )
