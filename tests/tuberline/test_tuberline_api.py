"""`import tuberline`: light, typed, and equal to what a line does with the same cloud; every example runs."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tuberline
from conveyor.messages import View
from regressor.weigh.weigher import Weigher, weigh_view
from tests.regressor.ellipsoids import ellipsoid_view
from tuberline.cli.simulate import simulate as simulate_command

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = sorted((ROOT / "docs" / "examples").glob("0*.py"))
HEAVY = ("torch", "cv2", "zenoh", "numba", "scipy", "numpy", "pydantic", "rerun")


@pytest.fixture(scope="module")
def view() -> View:
    """A view as the segmenter sends it."""
    return ellipsoid_view((0.042, 0.033, 0.028))


def cloud_of(view: View) -> np.ndarray:
    """(N, 3) points of the view, camera frame, metres."""
    from conveyor.geometry import deproject

    return deproject(view.depth, depth_scale_m=view.depth_scale_m, intrinsics=view.intrinsics, u0=view.u0, v0=view.v0)


def test_importing_it_loads_nothing_heavy_and_using_a_name_gives_it() -> None:
    code = (
        f"import sys, tuberline\nheavy = sorted(set({HEAVY}) & set(sys.modules))\n"
        "assert not heavy, heavy\nassert set(tuberline.__all__) <= set(dir(tuberline))\n"
        "assert tuberline.replay and tuberline.weigh\n"
        "import tuberline.replayer\nassert callable(tuberline.replay) and callable(tuberline.weigh)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, env=_env())
    assert done.returncode == 0, done.stderr
    for name in tuberline.__all__:
        assert getattr(tuberline, name) is not None


def test_an_unknown_name_is_refused_with_the_known_ones() -> None:
    with pytest.raises(AttributeError, match=r"no public name 'wiegh'; it has: .*weigh"):
        _ = tuberline.wiegh  # type: ignore[attr-defined]


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_every_example_runs_alone(path: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(path)], capture_output=True, text=True, check=False, timeout=170, cwd=tmp_path, env=_env()
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert " g" in done.stdout, "it says grams"
    assert list(tmp_path.iterdir()) == [], "an example leaves nothing behind"


def test_a_depth_crop_weighs_what_the_line_weighs(view: View) -> None:
    booked = weigh_view(Weigher.load(), view, regressor="r1")
    weight = tuberline.weigh_depth(
        view.depth,
        intrinsics=view.intrinsics,
        depth_scale_m=view.depth_scale_m,
        belt_from_camera=view.belt_from_camera,
        u0=view.u0,
        v0=view.v0,
        belt_sd_mm=1000 * view.belt_sd_m,
    )
    assert (weight.weight_g, weight.low_g, weight.high_g) == (booked.weight_g, booked.low_g, booked.high_g)
    assert (weight.model, weight.flags, weight.method) == (booked.model, booked.flags, "pointraft")


def test_a_mask_is_the_crop(view: View) -> None:
    full = np.full((720, 1280), 345, np.uint16)
    rows, columns = view.depth.shape
    there = np.zeros(full.shape, bool)
    there[view.v0 : view.v0 + rows, view.u0 : view.u0 + columns] = view.depth > 0
    full[there] = view.depth[view.depth > 0]
    weight = tuberline.weigh_depth(
        full, mask=there, intrinsics=view.intrinsics, depth_scale_m=0.001, belt_distance_m=0.345
    )
    crop = tuberline.weigh_depth(
        view.depth, intrinsics=view.intrinsics, depth_scale_m=0.001, belt_distance_m=0.345, u0=view.u0, v0=view.v0
    )
    assert weight == crop


def test_a_wide_pixel_is_divided_in_a_whole_image_too(view: View) -> None:
    """In an image of a camera far away it was not, for its size, and weighed 2 % more than its crop."""
    k, wide, every = view.intrinsics, {"depth_scale_m": 0.001, "belt_distance_m": 0.345}, 4
    told = tuberline.Intrinsics(k.width, k.height, k.fx / every, k.fy / every, k.cx / every, k.cy / every)
    depth = np.ascontiguousarray(view.depth[::every, ::every])
    rows, columns = depth.shape
    full = np.zeros((k.height, k.width), np.uint16)
    v0, u0 = view.v0 // every, view.u0 // every
    full[v0 : v0 + rows, u0 : u0 + columns] = depth
    whole = tuberline.weigh_depth(full, intrinsics=told, **wide)
    assert whole == tuberline.weigh_depth(depth, intrinsics=told, u0=u0, v0=v0, **wide)


def test_a_tuber_at_the_images_border_is_flagged(view: View) -> None:
    """Half of it was weighed as if it were whole, and nothing said."""
    half = view.depth[:, : view.depth.shape[1] // 2]
    given = {"intrinsics": view.intrinsics, "depth_scale_m": 0.001, "belt_distance_m": 0.345}
    at_border, inside = (
        tuberline.weigh_depth(half, u0=view.intrinsics.width - half.shape[1] - away, v0=view.v0, **given)
        for away in (0, 1)
    )
    assert ("cut" in at_border.flags, "cut" in inside.flags) == (True, False)


def test_a_cloud_weighs_the_same_from_an_array_and_a_file(view: View, tmp_path: Path) -> None:
    cloud = cloud_of(view)
    np.save(tmp_path / "tuber.npy", cloud)
    from_array = tuberline.weigh(cloud, belt_distance_m=0.345)
    assert from_array == tuberline.weigh(tmp_path / "tuber.npy", belt_distance_m=0.345)
    assert from_array.low_g < from_array.weight_g < from_array.high_g
    wider = tuberline.weigh(cloud, belt_distance_m=0.345, belt_sd_mm=8.0)
    assert wider.weight_g == pytest.approx(from_array.weight_g, rel=0.02), "heights count less there"
    assert wider.high_g - wider.low_g > from_array.high_g - from_array.low_g


def test_what_cannot_be_weighed_is_refused_in_words(view: View) -> None:
    cloud = cloud_of(view)
    refusals = {
        "belt_distance_m is 345": lambda: tuberline.weigh(cloud, belt_distance_m=345),
        "belt_distance_m is '0.345', which is no number; allowed is 0.05 to 5": lambda: tuberline.weigh(
            cloud,
            belt_distance_m="0.345",  # type: ignore[arg-type]
        ),
        "is 289[.0-9]* m from .* clouds are in metres, so divide one in millimetres by 1000": lambda: tuberline.weigh(
            cloud * 1000, belt_distance_m=0.345
        ),
        "path is int; give that of a file of weights": lambda: tuberline.load_weights(5),  # type: ignore[arg-type]
        "belt_sd_mm is -1": lambda: tuberline.weigh(cloud, belt_distance_m=0.345, belt_sd_mm=-1),
        "fewer than 30 points": lambda: tuberline.weigh(cloud[:20], belt_distance_m=0.345),
        "not an array of shape": lambda: tuberline.weigh(cloud[:, :2], belt_distance_m=0.345),
        "not finite": lambda: tuberline.weigh(cloud * np.nan, belt_distance_m=0.345),
        "its nearest point is": lambda: tuberline.weigh(cloud, belt_distance_m=0.9),
        "does not exist": lambda: tuberline.weigh("nothing.ply", belt_distance_m=0.345),
        "one of them": lambda: tuberline.weigh_depth(view.depth, intrinsics=view.intrinsics, depth_scale_m=0.001),
        "depth_scale_m is 1": lambda: tuberline.weigh_depth(
            view.depth, intrinsics=view.intrinsics, depth_scale_m=1, belt_distance_m=0.345
        ),
        "expected uint16": lambda: tuberline.weigh_depth(
            view.depth.astype(float), intrinsics=view.intrinsics, depth_scale_m=0.001, belt_distance_m=0.345
        ),
        "is no recording": lambda: tuberline.open_recording(ROOT / "tuberline"),
        "there is no ledger": lambda: tuberline.read_ledger("nothing"),
        "tubers 0: allowed is 1": lambda: tuberline.simulate("nothing", tubers=0),
    }
    for words, attempt in refusals.items():
        with pytest.raises(tuberline.TuberlineError, match=words):
            attempt()
    assert not Path("nothing").exists()


NO_NUMBERS: tuple[Any, ...] = (np.nan, np.inf, -1, "one", None, np.zeros(2))
"""What none of the numbers of `weigh_depth`, `replay` and `simulate` may be; `belt_distance_m` may be None."""


@pytest.mark.parametrize("name", ["belt_distance_m", "depth_scale_m", "u0", "v0", "belt_sd_mm"])
def test_a_depth_image_with_a_wrong_number_is_refused(view: View, name: str) -> None:
    given = {"belt_distance_m": 0.345, "depth_scale_m": 0.001, "u0": view.u0, "v0": view.v0, "belt_sd_mm": 2.0}
    for value in (*NO_NUMBERS, 10**7):
        with pytest.raises(tuberline.TuberlineError, match=name):
            tuberline.weigh_depth(view.depth, intrinsics=view.intrinsics, **{**given, name: value})


def test_what_is_no_depth_image_is_refused(view: View) -> None:
    """Lists, masks of NaN and intrinsics as a tuple raised AttributeErrors, or weighed something."""
    kept = {"depth": view.depth, "mask": view.depth > 0, "intrinsics": view.intrinsics, "weights": None}
    wrong: dict[str, tuple[Any, ...]] = {
        "depth": (view.depth.tolist(), None, "depth.png", view.depth[None], view.depth.astype(int)),
        "mask": (kept["mask"].tolist(), "mask.png", np.full(view.depth.shape, np.nan), np.ones((3, 3), bool)),
        "intrinsics": (None, (653.8, 652.1, 643.5, 366.1)),
        "weights": ("weights.safetensors",),
    }
    for name, values in wrong.items():
        for value in values:
            given = {**kept, name: value}
            with pytest.raises(tuberline.TuberlineError, match=name):
                tuberline.weigh_depth(given.pop("depth"), depth_scale_m=0.001, belt_distance_m=0.345, **given)
    for depth in (np.zeros((0, 0), np.uint16), np.zeros((0, 5), np.uint16)):
        with pytest.raises(tuberline.TuberlineError, match="it has no points"):
            tuberline.weigh_depth(depth, intrinsics=view.intrinsics, depth_scale_m=0.001, belt_distance_m=0.345)


def test_a_pose_that_is_none_is_refused(view: View) -> None:
    """(3, 3) raised an IndexError; a mirror, a scaled one, one in millimetres gave weights."""
    good = view.belt_from_camera
    in_mm = good.copy()
    in_mm[2, 3] *= 1000
    for pose, words in (
        (good[:3, :3], r"4 rows of 4 numbers, got \(3, 3\)"),
        (good[:3], r"4 rows of 4 numbers, got \(3, 4\)"),
        ([], "4 rows of 4 numbers"),
        ([[1, 2], [3]], "4 rows of 4 numbers"),
        ("pose", "4 rows of 4 numbers"),
        (good * np.nan, "no rigid transform"),
        (good * 2, "no rigid transform"),
        (good @ np.diag([-1, 1, 1, 1]), "no rigid transform"),
        (np.zeros((4, 4)), "no rigid transform"),
        (np.eye(4), "away from the belt"),
        (in_mm, r"is 345\.0; allowed is 0\.05 to 5"),
    ):
        with pytest.raises(tuberline.TuberlineError, match=words):
            tuberline.weigh_depth(
                view.depth,
                intrinsics=view.intrinsics,
                depth_scale_m=0.001,
                u0=view.u0,
                v0=view.v0,
                belt_from_camera=pose,  # type: ignore[arg-type]
            )


@pytest.mark.parametrize("ending", ["ply", "npy", "npz", "xyz", "txt"])
def test_a_text_is_no_cloud(tmp_path: Path, ending: str) -> None:
    (tmp_path / f"note.{ending}").write_text("dear reader\nno numbers here\n", encoding="utf-8")
    with pytest.raises(tuberline.TuberlineError, match=rf"note\.{ending}"):
        tuberline.weigh(tmp_path / f"note.{ending}", belt_distance_m=0.345)


def test_simulate_and_replay_refuse_what_there_is_not(tmp_path: Path) -> None:
    """An unknown preset was a bare KeyError, a seed below 0 a ValueError of NumPy's."""
    out = tmp_path / "out"
    for name, known in (("preset", "known: easy, field"), ("camera", "known: d405"), ("scene", "known: singulated")):
        with pytest.raises(tuberline.TuberlineError, match=f"'moon' is unknown; {known}"):
            tuberline.simulate(out, **{name: "moon"})  # type: ignore[arg-type]
    for name in ("seed", "tubers", "fps", "speed_mps", "belt_distance_m"):
        for value in (*NO_NUMBERS, *((1.5,) if name in ("seed", "tubers") else ())):
            with pytest.raises(tuberline.TuberlineError, match=name):
                tuberline.simulate(out, **{name: value})
    for value in (*(number for number in NO_NUMBERS if number is not None), 0, 1.5, 65):
        with pytest.raises(tuberline.TuberlineError, match=r"regressors is .* 1 to 64, a whole number"):
            tuberline.replay(tmp_path, out=out, regressors=value)
    assert not out.exists()
    with pytest.raises(tuberline.TuberlineError, match="seed -1: allowed is 0 to"):
        simulate_command(out=out, seed=-1)


def test_a_truth_that_is_no_object_is_refused(tmp_path: Path) -> None:
    recording = tuberline.simulate(tmp_path / "belt", tubers=1, fps=5.0, speed_mps=1.0)
    (tmp_path / "belt" / "truth.json").write_text("[]", encoding="utf-8")
    with pytest.raises(tuberline.TuberlineError, match="must be a JSON object, got list"):
        recording.truth()


def test_prepared_inputs_give_the_networks_grams(view: View) -> None:
    import torch

    weights = tuberline.load_weights()
    inputs = tuberline.prepare(cloud_of(view), 0.345, weights=weights)
    assert inputs.points.shape == (1024, 3)
    assert inputs.points.dtype == np.float32
    assert inputs.groups is not None
    assert inputs.groups.shape == (256, 3)
    assert inputs.height_m == pytest.approx(0.056, abs=0.001)
    with torch.no_grad():
        grams = weights.network([torch.from_numpy(inputs.points)], torch.tensor([inputs.height_m]))
    weight = tuberline.weigh(cloud_of(view), belt_distance_m=0.345, weights=weights)
    assert weight.network_g == pytest.approx(grams.item(), abs=0.01)


def test_what_weigh_refuses_is_not_prepared(view: View) -> None:
    """A cloud that floats above its belt was prepared, its height clamped: an exported network weighed it."""
    for belt_distance_m in (0.9, 2.0):
        for take in (tuberline.weigh, tuberline.prepare):
            with pytest.raises(tuberline.TuberlineError, match=r"the cloud: its nearest point is 0\.\d+ m from"):
                take(cloud_of(view), belt_distance_m=belt_distance_m)


def test_a_missing_mask_and_holes_in_a_cloud_are_told_how_to_mend(view: View) -> None:
    """A whole image was said to lie on its belt, and of a cloud with NaN not how to take the points that are known."""
    with_belt = np.where(view.depth > 0, view.depth, round(0.345 / view.depth_scale_m)).astype(np.uint16)
    whole = np.full((view.intrinsics.height, view.intrinsics.width), with_belt[0, 0])
    rows, columns = view.depth.shape
    whole[view.v0 : view.v0 + rows, view.u0 : view.u0 + columns] = with_belt
    with pytest.raises(tuberline.TuberlineError, match="where the image shows belt, give the mask of the tuber's"):
        tuberline.weigh_depth(
            whole, intrinsics=view.intrinsics, depth_scale_m=view.depth_scale_m, belt_distance_m=0.345
        )
    cloud = np.vstack([cloud_of(view), np.full(3, np.nan)])
    with pytest.raises(tuberline.TuberlineError, match=r"not finite.*; take cloud\[np.isfinite\(cloud\).all\(1\)\]"):
        tuberline.weigh(cloud, belt_distance_m=0.345)


def test_errors_name_parameters_and_no_options(view: View, recording: Path, tmp_path: Path) -> None:
    """They named `--belt-distance-m`, the command's, to who had called a function."""
    cloud, depth = cloud_of(view), {"intrinsics": view.intrinsics, "depth_scale_m": view.depth_scale_m}
    check = r"check belt_distance_m and the depth scale \(depth_scale_m: 0.001 for"
    for belt_distance_m in (0.9, 0.28):  # it floats above it, and lies below it
        for attempt in (
            lambda at: tuberline.weigh(cloud, belt_distance_m=at),
            lambda at: tuberline.prepare(cloud, at),
            lambda at: tuberline.weigh_depth(view.depth, belt_distance_m=at, u0=view.u0, v0=view.v0, **depth),
        ):
            with pytest.raises(tuberline.TuberlineError, match=check):
                attempt(belt_distance_m)
    (tmp_path / "ledger.db").touch()
    with pytest.raises(tuberline.TuberlineError, match=r"already holds a run; give another out, .* by --resume"):
        tuberline.replay(recording, out=tmp_path)


def test_a_recording_is_read_frame_by_frame_and_a_bad_frame_is_not_passed_over(recording: Path, tmp_path: Path) -> None:
    import shutil

    from conveyor.formats import Refused

    opened = tuberline.open_recording(recording)
    names = [camera.name for camera in opened.cameras]
    assert names == ["left", "right"]
    assert sum(1 for _ in opened.frames()) == sum(camera.frames or 0 for camera in opened.cameras)
    assert {frame.camera for frame in opened.frames("right")} == {"right"}
    truth = opened.truth()
    assert truth is not None
    assert len(truth["tubers"]) == 24
    copy = shutil.copytree(recording / "left", tmp_path / "left")
    first = next(iter(opened.frames("left"))).seq
    (copy / "depth" / f"{first + 2:06d}.png").write_bytes(b"no picture")
    damaged = tuberline.open_recording(tmp_path)
    with pytest.raises(tuberline.TuberlineError, match="png"):
        list(damaged.frames())
    refused: list[Refused] = []
    kept = list(damaged.frames(on_refused=refused.append))
    assert [item.seq for item in refused] == [first + 2]
    assert len(kept) == sum(1 for _ in opened.frames("left")) - 1


def test_a_ledger_is_read_as_the_summary_says(run_dir: Path) -> None:
    import json

    ledger = tuberline.read_ledger(run_dir)
    summary = json.loads((run_dir / "summary.json").read_text(encoding="utf-8"))
    assert ledger.summary == summary
    assert ledger.totals is not None
    assert ledger.totals.count == len(ledger.tubers) == summary["totals"]["count"]
    assert sum(tuber.weight_g for tuber in ledger.tubers) == pytest.approx(ledger.totals.as_weighed_g, abs=0.01)
    assert ledger.as_dicts()[0]["tuber_id"] == 1
    assert ledger == tuberline.read_ledger(run_dir / "ledger.db", run=ledger.run)


def _env() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}


def test_threads_may_weigh_at_once() -> None:
    """All threads wrote their edges into one block: of 60 weights of six threads 42 were wrong, by up to 80 g."""
    axes = ((0.030, 0.026, 0.022), (0.042, 0.033, 0.028), (0.055, 0.040, 0.034))
    clouds = [cloud_of(ellipsoid_view(each)) for each in axes]
    alone = [tuberline.weigh(cloud, belt_distance_m=0.345) for cloud in clouds]
    with ThreadPoolExecutor(6) as pool:
        found = list(pool.map(lambda cloud: tuberline.weigh(cloud, belt_distance_m=0.345), clouds * 12))
    assert found == alone * 12
