"""Views as a line cuts them: those of its segmenter over the same recording, each with its own tuber's truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camera_sim.sim.record import record_scene
from camera_sim.sim.scenes import SceneSettings
from conveyor.config import parse_config
from conveyor.errors import InputError
from conveyor.formats import open_source
from conveyor.formats.packs.views import PackedView, read_views, view_shards
from conveyor.messages import Frame
from regressor.training.cloudset import load_cloudset
from segmenter.pipeline import Segmenter
from segmenter.setup import core_settings
from tuberline import line_views as module
from tuberline.cli.simulate_line_views import simulate_line_views
from tuberline.line_views import LineViewPlan, line_views

PLAN = LineViewPlan(seed=21, preset="easy")


@pytest.fixture(scope="module")
def views() -> list[PackedView]:
    return list(line_views(PLAN, 1))


def settings_of(number: int) -> SceneSettings:
    return module._settings(PLAN, number)


def test_views_are_those_of_a_line_on_the_same_recording(views: list[PackedView], tmp_path: Path) -> None:
    settings = settings_of(1)
    truth = record_scene(tmp_path / "belt", settings)
    raw = {
        "cameras": {"front": {"path": str(tmp_path / "belt")}},
        "segmenter": {"belt_sd_mm": module._belt_sd_mm(settings)},
    }
    core = Segmenter(core_settings(parse_config(raw, where="of the test")))
    found = []
    for frame in open_source(tmp_path / "belt", camera="front").frames(run="test"):
        assert isinstance(frame, Frame)
        found += [view for closed in core.step(frame).closed for view in closed.views]
    found += [view for closed in core.finish() for view in closed.views]
    of_line = {(view.u0, view.v0): view for view in found}
    assert len(views) > 50
    assert len(found) >= len(views)
    for view in views:
        assert np.array_equal(view.depth, of_line[view.u0, view.v0].depth)
        assert view.belt_sd_m == of_line[view.u0, view.v0].belt_sd_m
    weights = {round(tuber["weight_g"], 2) for tuber in truth["tubers"]}
    assert {round(view.weight_g, 2) for view in views} <= weights


def test_each_view_has_its_own_tubers_truth(views: list[PackedView]) -> None:
    """What stands over the belt goes with the weight, and outlines are near the silhouettes."""
    above_ml = []
    for view in views:
        depth_m = view.depth[view.depth > 0] * view.depth_scale_m
        area = depth_m**2 / (view.intrinsics.fx * view.intrinsics.fy)
        above_ml.append(1e6 * float(((view.belt_distance_m - depth_m) * area).sum()))
    assert np.corrcoef(above_ml, [view.weight_g for view in views])[0, 1] > 0.97
    assert abs(np.median([view.more["rim_lost"] for view in views])) < 0.1
    assert {view.more["preset"] for view in views} == {"easy"}


def test_a_recording_is_the_same_whatever_was_made_before(views: list[PackedView], tmp_path: Path) -> None:
    simulate_line_views(out=tmp_path / "pack", recordings=2, seed=PLAN.seed, preset="easy")
    packed = [view for shard in view_shards(tmp_path / "pack") for view in read_views(shard)]
    again = [view for view in packed if view.more["recording"] == 1]
    assert len(again) == len(views)
    same = {(view.u0, view.v0): view.depth for view in views}
    assert all(np.array_equal(view.depth, same[view.u0, view.v0]) for view in again)
    learned = load_cloudset(tmp_path / "pack", cache=None)
    assert len(learned) == len(packed)
    assert np.isfinite(learned.rim_lost).all()


def test_what_cannot_be_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"--distances \(46\.0,\): belt distances of 0\.2 to 1\.5 m"):
        simulate_line_views(out=tmp_path / "pack", distances=(46.0,))
    with pytest.raises(InputError, match=r"--recordings 0: at least 1"):
        simulate_line_views(out=tmp_path / "pack", recordings=0)
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "views-00000.npz").touch()
    with pytest.raises(InputError, match="already holds views"):
        simulate_line_views(out=tmp_path / "pack")
