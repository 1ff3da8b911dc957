"""Simulated views in the 3DPotatoTwin layout: the training side reads the very clouds that were simulated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camera_sim.sim.optics import D405_848
from camera_sim.sim.twinfolder import write_twin_folder
from camera_sim.sim.views import ViewPlan, ViewSimulator
from conveyor.errors import InputError
from conveyor.formats import describe_recording, open_source
from conveyor.formats.ply import read_ply
from conveyor.formats.potatotwin.layout import BELT_DISTANCES_M, is_potatotwin
from conveyor.formats.potatotwin.views import read_twin
from conveyor.geometry import deproject
from conveyor.messages import Frame
from tuberline.cli.simulate_views import simulate_views

PLAN = ViewPlan(seed=5, views_per_tuber=2, preset="easy", optics=D405_848)
TUBERS = 5


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("twin")
    write_twin_folder(out, PLAN, tubers=TUBERS)
    return out


def test_the_same_clouds_and_weights_come_back(folder: Path) -> None:
    assert is_potatotwin(folder)
    simulator = ViewSimulator(PLAN)
    wanted = [view for n in range(TUBERS) for view in sorted(simulator.views(n), key=lambda v: round(v.v_centre))]
    read = list(read_twin(folder))
    clouds = sorted(folder.glob("1_rgbd/2_pcd/*/*.ply"))
    assert len(read) == len(wanted) == len(clouds) > TUBERS
    for view, twin, cloud in zip(wanted, read, clouds, strict=True):
        points = deproject(
            view.depth, depth_scale_m=view.depth_scale_m, intrinsics=view.intrinsics, u0=view.u0, v0=view.v0
        )
        assert twin.depth is not None
        assert twin.intrinsics is not None
        np.testing.assert_allclose(
            deproject(twin.depth, depth_scale_m=twin.depth_scale_m, intrinsics=twin.intrinsics), points, atol=1e-7
        )
        np.testing.assert_allclose(read_ply(cloud), points, atol=1e-9)
        assert twin.weight_g == pytest.approx(view.tuber.weight_g, abs=0.005)
        assert twin.belt_distance_m == view.belt_distance_m == BELT_DISTANCES_M[twin.season]
        assert twin.length_mm == pytest.approx(view.tuber.axes_mm[0], abs=0.005)


def test_the_splits_part_the_tubers(folder: Path) -> None:
    labels = {name: {view.label for view in read_twin(folder, split=name)} for name in ("train", "val", "test")}
    assert [len(labels[name]) for name in ("train", "val", "test")] == [3, 1, 1]
    assert len(set.union(*labels.values())) == TUBERS


def test_it_is_a_recording_too(folder: Path) -> None:
    cameras = describe_recording(folder).cameras
    assert {camera.name for camera in cameras} <= set(BELT_DISTANCES_M)
    for camera in cameras:
        frames = list(open_source(folder, camera=camera.name).frames(run="x"))
        assert all(isinstance(frame, Frame) and np.array_equal(frame.mask > 0, frame.depth > 0) for frame in frames)


def test_the_command_keeps_what_it_did_not_make(tmp_path: Path) -> None:
    out = tmp_path / "twin"
    for force in (False, True):
        simulate_views(out=out, tubers=1, views=1, layout="potatotwin", preset="easy", camera="d405-848", force=force)
    with pytest.raises(InputError, match="already holds views"):
        simulate_views(out=out, tubers=1, views=1, layout="potatotwin")
    next(out.glob("1_rgbd/0_camera_intrinsics/*.json")).rename(out / "1_rgbd" / "0_camera_intrinsics" / "real.json")
    with pytest.raises(InputError, match="was not simulated"):
        simulate_views(out=out, tubers=1, views=1, layout="potatotwin", force=True)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"optics": None}, "one camera and 1 mm depth"),
        ({"distances_m": (0.345, 0.5)}, r"belt distance 0\.5: .* 0\.345, 0\.46, 0\.465 m"),
    ],
)
def test_what_the_layout_cannot_say_is_refused(tmp_path: Path, changes: dict, text: str) -> None:
    from dataclasses import replace

    with pytest.raises(InputError, match=text):
        write_twin_folder(tmp_path, replace(PLAN, **changes), tubers=1)
