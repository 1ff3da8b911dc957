"""Packs of single views for training."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from camera_sim.sim.belt import draw_belt
from camera_sim.sim.optics import D405_1280
from camera_sim.sim.view_setting import draw_recording, draw_setting
from camera_sim.sim.views import ViewPlan, ViewSimulator
from conveyor.errors import InputError
from tuberline.cli.simulate_views import simulate_views


@pytest.fixture(scope="module")
def pack(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("views") / "pack"
    simulate_views(out=out, tubers=12, views=3, seed=6, preset="mixed")
    return out


def test_a_pack_has_what_training_needs(pack: Path) -> None:
    z = np.load(pack / "views-00000.npz")
    n = len(z["weight_g"])
    assert n >= 30
    assert z["depth"].dtype == np.uint16
    assert z["depth_offset"].shape == (n + 1,)
    assert z["crop"].dtype == np.int32
    assert z["tuber"].dtype == np.int64
    assert len(np.unique(z["tuber"])) == 12
    for i in range(n):
        u0, v0, height, width = z["crop"][i].tolist()
        crop = z["depth"][z["depth_offset"][i] : z["depth_offset"][i + 1]].reshape(height, width)
        image_width, image_height = z["image_size"][i].tolist()
        assert 0 <= u0 <= image_width - width
        assert 0 <= v0 <= image_height - height
        assert crop.any(axis=0)[[0, -1]].all()  # cut tightly
        assert crop.any(axis=1)[[0, -1]].all()
        depth_m = crop[crop > 0] * z["depth_scale_m"][i]
        assert depth_m.max() < z["belt_distance_m"][i] + 0.02
        assert depth_m.min() > z["belt_distance_m"][i] - 0.2
    meta = json.loads((pack / "meta.json").read_text())
    assert (meta["seed"], meta["preset"], meta["tubers"], meta["views"]) == (6, "mixed", 12, n)


def test_volume_under_the_surface_predicts_weight(pack: Path) -> None:
    """The physics is right if the column volume down to the belt goes with the weight."""
    z = np.load(pack / "views-00000.npz")
    volumes = []
    for i in range(len(z["weight_g"])):
        crop = z["depth"][z["depth_offset"][i] : z["depth_offset"][i + 1]].astype(float) * z["depth_scale_m"][i]
        crop = crop[crop > 0]
        fx, fy = z["intrinsics"][i, :2]
        volumes.append(((z["belt_distance_m"][i] - crop) * crop**2 / (fx * fy)).sum() * 1e6)
    assert np.corrcoef(volumes, z["weight_g"])[0, 1] > 0.97
    assert 1.0 < np.median(np.array(volumes) / z["volume_ml"]) < 1.5


def test_a_tuber_is_the_same_whatever_was_made_before() -> None:
    plan = ViewPlan(seed=8, views_per_tuber=2, preset="field", optics=D405_1280)
    alone = list(ViewSimulator(plan).views(5))
    simulator = ViewSimulator(plan)
    for tuber_id in (3, 4):
        list(simulator.views(tuber_id))
    after = list(simulator.views(5))
    assert len(alone) == len(after)
    for one, two in zip(alone, after, strict=True):
        assert np.array_equal(one.depth, two.depth)
        assert one.belt_distance_m == two.belt_distance_m


def test_31_views_ride_through_the_image() -> None:
    plan = ViewPlan(seed=8, views_per_tuber=31, preset="easy", optics=D405_1280, distances_m=(0.345,))
    rows = [view.v_centre for view in ViewSimulator(plan).views(1)]
    steps = np.diff(rows)
    assert len(rows) == 31
    assert (steps > 0).all()
    assert rows[0] < 200
    assert rows[-1] > 520


def test_belts_are_off_by_what_is_said_of_them() -> None:
    """0.5 or 3 mm, drawn by recording."""
    sds_m, rng = (0.0005, 0.003), np.random.default_rng(31)
    plan = ViewPlan(seed=31, views_per_tuber=1, preset="exact", belt_sds_m=sds_m)
    belts = [draw_belt(rng, soil_m=8e-4)] * 2
    errors: dict[float, list[float]] = {sd_m: [] for sd_m in sds_m}
    for number in range(400):
        setting = draw_setting(plan, draw_recording(plan, number), belts, rng)
        sd_m = setting.preset.belt_sd_m
        nearest = min(sds_m, key=lambda said_m: abs(said_m - sd_m))
        assert sd_m == pytest.approx(nearest)
        errors[nearest].append((setting.believed_distance_m - setting.seen_distance_m) / sd_m)
    for of_one in errors.values():
        assert len(of_one) > 150
        assert abs(np.mean(of_one)) < 0.25
        assert np.std(of_one) == pytest.approx(1.0, abs=0.15)


def test_what_is_known_of_a_belt_changes_nothing_else_of_a_recording() -> None:
    plan = ViewPlan(seed=31, views_per_tuber=1, preset="worlds", belt_sds_m=(0.0005, 0.003))
    for number in range(6):
        known, plain = (
            draw_setting(drawn, draw_recording(drawn, number), [], np.random.default_rng(number))
            for drawn in (plan, replace(plan, belt_sds_m=()))
        )
        assert (known.optics, known.believed_distance_m) == (plain.optics, plain.believed_distance_m)
        assert known.conditions.stock == plain.conditions.stock
        assert known.preset.noise == plain.preset.noise


def test_what_cannot_be_is_refused(pack: Path) -> None:
    with pytest.raises(InputError, match="already holds views"):
        simulate_views(out=pack)
    with pytest.raises(InputError, match=r"--tubers 0 --views 4: both must be at least 1"):
        simulate_views(out=pack.parent / "other", tubers=0)
    with pytest.raises(InputError, match=r"0.2 to 1.5 m"):
        simulate_views(out=pack.parent / "other", distances=(46.0,))
    with pytest.raises(InputError, match=r"--belt-sd-mm \(0\.0,\): standard deviations of 0\.1 to 10 mm"):
        simulate_views(out=pack.parent / "other", belt_sd_mm=(0.0,))
    with pytest.raises(InputError, match="a 3DPotatoTwin folder cannot say how well its belt is known"):
        simulate_views(out=pack.parent / "other", belt_sd_mm=(2.0,), layout="potatotwin")


def test_views_that_are_not_made_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It said how many views there were, and not that fewer were made than had been asked for."""
    simulate_views(out=tmp_path / "far", tubers=1, views=6, seed=3, preset="field", camera="d405-848", distances=(1.5,))
    made = len(np.load(tmp_path / "far" / "views-00000.npz")["weight_g"])
    assert 0 < made < 6
    told = f"{made} views of 1 tubers in {tmp_path / 'far'}; in {6 - made} of 6 nothing was left of the tuber, they are"
    assert capsys.readouterr().out.startswith(told)
    simulate_views(out=tmp_path / "near", tubers=1, views=2, seed=3, preset="easy")
    assert capsys.readouterr().out == f"2 views of 1 tubers in {tmp_path / 'near'}\n"
