"""What readers of pages have already: a recording, a run, a line's file, clouds. Made by our own commands, small."""

from __future__ import annotations

import json
import re
import shutil
import sqlite3
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from tests.docs.stage import Stage

LINE = """name = "{name}"
[link]
router = "{router}"
[cameras.front]
path = "{recording}"
speed = {speed}
[regressor]
processes = 1
[aggregator]
out = "runs/{name}"
"""
SLOW = 0.05
"""Times real time: a belt of some seconds lasts as long as its page, and costs a busy machine little."""


def line_toml(stage: Stage, name: str, *, speed: float = SLOW) -> str:
    """A line's file that plays the given recording."""
    return LINE.format(name=name, router=stage.router, recording="recordings/monday", speed=speed)


def recording(stage: Stage) -> None:
    """recordings/monday with its truth, also under the names that pages use."""
    made = stage.clone.parent.parent / "recording-of-pages"
    if not (made / "truth.json").is_file():
        stage.type(f"tuberline simulate --out {made} --scene singulated --tubers 12 --seed 4 --fps 15")
    recordings_folder(stage)
    shutil.copytree(made, stage.clone / "recordings" / "monday")
    for name in ("RECORDING", "rec/today"):
        (stage.clone / name).parent.mkdir(exist_ok=True)
        (stage.clone / name).symlink_to(stage.clone / "recordings" / "monday")
    shutil.copy(made / "truth.json", stage.clone / "truth.json")
    shutil.copy(made / "truth.json", stage.clone / "rec" / "truth.json")


def recordings_folder(stage: Stage) -> None:
    """The folder that a first recording goes to."""
    (stage.clone / "recordings").mkdir(exist_ok=True)


def run(stage: Stage) -> None:
    """runs/monday, a replay's."""
    _copy_of_run(stage, "monday")


def run_today(stage: Stage) -> None:
    """runs/today, the same under another name."""
    _copy_of_run(stage, "today")


def _copy_of_run(stage: Stage, name: str) -> None:
    """A run that all pages share, of this page's own recording."""
    made = stage.clone.parent.parent / "run-of-pages"
    if not (made / "summary.json").is_file():
        stage.type(f"tuberline replay recordings/monday --out {made} --regressors 1")
    shutil.copytree(made, stage.clone / "runs" / name)
    line = stage.clone / "runs" / name / "line.toml"
    own = f'path = "{stage.clone}/recordings/monday"'
    line.write_text(re.sub(r'path = ".*/recordings/monday"', own, line.read_text(encoding="utf-8")), encoding="utf-8")


def line_file(stage: Stage) -> None:
    """line.toml and LINE.toml."""
    for name in ("line.toml", "LINE.toml"):
        (stage.clone / name).write_text(line_toml(stage, "line"), encoding="utf-8")


def two_lines(stage: Stage) -> None:
    """north.toml and south.toml, at one router."""
    for name in ("north", "south"):
        (stage.clone / f"{name}.toml").write_text(line_toml(stage, name), encoding="utf-8")


def router(stage: Stage) -> None:
    """A router that both lines use."""
    stage.do(f"tuberline router --listen {stage.router} &")


def graphviz(stage: Stage) -> None:
    """Graphviz draws, where it is installed; elsewhere what it would be given is kept."""
    if shutil.which("dot") is None:
        stage.words["| dot -Tsvg > north.svg"] = "> north.dot"


def bucket(stage: Stage) -> None:
    """A bucket of all tubers that ran over the belt."""
    truth = json.loads((stage.clone / "truth.json").read_text(encoding="utf-8"))["tubers"]
    kg = sum(tuber["weight_g"] for tuber in truth) / 1000
    (summary,) = (stage.clone / "runs").glob("*/summary.json")
    run = json.loads(summary.read_text(encoding="utf-8"))["run"]
    stage.words |= {
        "--run monday --kind load": f"--run {run} --kind bucket --part 'tubers 1 to {len(truth)}'",
        "--kg 8.61": f"--kg {kg:.2f}",
        "--ticket-kg 8412": f"--ticket-kg {kg:.2f}",
        "--count 50": f"--count {len(truth)}",
        "--first 12 --last 61": f"--first 1 --last {len(truth)}",
        "--from-x -1.5 --to-x -9.0": "--from-x 9.0 --to-x -9.0",
    }


def contract(stage: Stage) -> None:
    """The buyer's classes of docs/sizes.md."""
    page = (stage.clone / "docs" / "sizes.md").read_text(encoding="utf-8")
    classes = page.partition("```toml\n")[2].partition("```")[0]
    (stage.clone / "contract.toml").write_text(classes, encoding="utf-8")


def today(stage: Stage) -> None:
    """The page names a day; a replayed run's is the one on which it was replayed."""
    ledger = sqlite3.connect(stage.clone / "runs" / "monday" / "ledger.db")
    ((started_ns,),) = ledger.execute("SELECT started_ns FROM run")
    ledger.close()
    stage.words["2026-11-22"] = time.strftime("%Y-%m-%d", time.localtime(started_ns / 1e9))


def cloud(stage: Stage) -> None:
    """cloud.ply and tuber.ply: an ellipsoid of 80 x 60 x 60 mm from above."""
    x, y = np.meshgrid(np.arange(-0.04, 0.04, 0.001), np.arange(-0.03, 0.03, 0.001))
    inside = (x / 0.04) ** 2 + (y / 0.03) ** 2
    z = 0.345 - 0.03 - 0.03 * np.sqrt(np.maximum(0, 1 - inside))
    rows = [f"{a:.4f} {b:.4f} {c:.5f}" for a, b, c in np.stack([x, y, z], -1)[inside < 0.9].tolist()]
    head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\nproperty float x\nproperty float y\nproperty float z\n"
    for name in ("cloud.ply", "tuber.ply"):
        (stage.clone / name).write_text(head + "end_header\n" + "\n".join(rows) + "\n", encoding="utf-8")


def clouds(stage: Stage) -> None:
    """The folder clouds/."""
    cloud(stage)
    (stage.clone / "clouds").mkdir()
    shutil.copy(stage.clone / "cloud.ply", stage.clone / "clouds")


def foreign_frames(stage: Stage) -> None:
    """Frames as other cameras' programs save them: Kinect's PNG, an SR300's, one .npz in metres, one with labels."""
    camera = stage.clone / "recordings" / "monday" / "front"
    k = json.loads((camera / "camera.json").read_text(encoding="utf-8"))
    frames = sorted((camera / "depth").glob("*.png"))[:6]
    matrix = {name: k[name] for name in ("fx", "fy", "cx", "cy")}
    (stage.clone / "kinect" / "depth").mkdir(parents=True)
    (stage.clone / "sr300").mkdir()
    for n, frame in enumerate(frames):
        shutil.copy(frame, stage.clone / "kinect" / "depth")
        depth = cv2.imread(str(frame), cv2.IMREAD_UNCHANGED)
        cv2.imwrite(str(stage.clone / "sr300" / f"{n:04d}.depth.png"), depth.astype(np.uint16) * 10)
    (stage.clone / "kinect" / "K.json").write_text(json.dumps(matrix), encoding="utf-8")
    rows = f"{k['fx']} 0 {k['cx']}\n0 {k['fy']} {k['cy']}\n0 0 1\n"
    (stage.clone / "sr300" / "K.txt").write_text(rows, encoding="utf-8")
    info = {"K": [k["fx"], 0, k["cx"], 0, k["fy"], k["cy"], 0, 0, 1], "width": k["width"], "height": k["height"]}
    (stage.clone / "camera_info.json").write_text(json.dumps(info), encoding="utf-8")
    stack = np.stack([cv2.imread(str(frame), cv2.IMREAD_UNCHANGED) for frame in frames])
    np.savez(stage.clone / "scene.npz", depth=(stack * k["depth_scale_m"]).astype(np.float32))
    _labelled_frame(stage, matrix)


def _labelled_frame(stage: Stage, matrix: dict[str, float]) -> None:
    """depth.png, labels.png and K.json: a tuber of 80 x 60 mm under a camera 345 mm above the belt."""
    v, u = np.mgrid[0:480, 0:848]
    x, y = (u - matrix["cx"]) / matrix["fx"] * 0.315, (v - matrix["cy"]) / matrix["fy"] * 0.315
    inside = (x / 0.04) ** 2 + (y / 0.03) ** 2
    depth = np.where(inside < 0.95, 0.345 - 0.03 - 0.03 * np.sqrt(np.maximum(0, 1 - inside)), 0.345)
    cv2.imwrite(str(stage.clone / "depth.png"), np.round(depth * 1000).astype(np.uint16))
    cv2.imwrite(str(stage.clone / "labels.png"), (inside < 0.95).astype(np.uint16))
    (stage.clone / "K.json").write_text(json.dumps(matrix), encoding="utf-8")


def packs(stage: Stage) -> None:
    """Views of simulated tubers, as several pages call them."""
    for name, preset in (("test-field", "field"), ("test-easy", "easy"), ("cal", "worlds")):
        stage.type(f"tuberline simulate-views --out packs/{name} --tubers 24 --views 2 --seed 7 --preset {preset}")


def twin(stage: Stage) -> None:
    """A folder in 3DPotatoTwin's layout under its name: the data themselves are not ours to hand out."""
    stage.type("tuberline simulate-views --layout potatotwin --out 3DPotatoTwin --tubers 30 --views 3 --seed 5")


def apples(stage: Stage) -> None:
    """The same layout without a split."""
    shutil.copytree(stage.clone / "3DPotatoTwin", stage.clone / "apples")
    (stage.clone / "apples" / "splits.csv").unlink()


def checkpoint(stage: Stage) -> None:
    """pointraft_potato.pth: a plain checkpoint with a state dict of the network."""
    import torch
    from safetensors.torch import load_file

    weights = load_file(stage.clone / "regressor" / "weights" / "tuberline-sim.safetensors")
    torch.save({"state_dict": weights}, stage.clone / "pointraft_potato.pth")


def other_weights(stage: Stage) -> None:
    """monday.safetensors: weights under another name, that answer as the shipped ones."""
    source = stage.clone / "regressor" / "weights" / "tuberline-sim"
    for ending in (".safetensors", ".json"):
        shutil.copy(source.with_suffix(ending), stage.clone / f"monday{ending}")


def track(stage: Stage) -> None:
    """monday.nmea: a straight drive while the recording ran, too short to tell the time from ground to camera."""
    stage.words["--track monday.nmea"] = "--track monday.nmea --delay-s 5 --cell-m 1"
    frames = (stage.clone / "recordings" / "monday" / "front" / "frames.csv").read_text(encoding="utf-8").splitlines()
    first, last = (int(frames[n].split(",")[1]) / 1e9 for n in (1, -1))
    sentences = []
    for n, at in enumerate(np.arange(first - 120, last + 60, 1.0)):
        clock = time.gmtime(at)
        minutes = 30.0 + 1.2 * n / 1852
        clock_text, place = time.strftime("%H%M%S", clock), f"52{minutes:08.5f},N,00530.00000,E"
        for body in (
            f"GPRMC,{clock_text}.00,A,{place},2.3,0.0,{time.strftime('%d%m%y', clock)},,,A",
            f"GPGGA,{clock_text}.00,{place},2,12,0.8,10.0,M,45.0,M,,",
        ):
            sum_ = 0
            for letter in body.encode():
                sum_ ^= letter
            sentences.append(f"${body}*{sum_:02X}")
    (stage.clone / "monday.nmea").write_text("\r\n".join(sentences) + "\r\n", encoding="utf-8")


def page_token(stage: Stage) -> None:
    """page-token.txt."""
    token = stage.clone / "page-token.txt"
    token.write_text("0123456789abcdef0123456789abcdef\n", encoding="utf-8")
    token.chmod(0o600)


def shared(stage: Stage) -> None:
    """../shared, and a real potato's cloud under the name that pages use; skips where there is none."""
    import os

    import pytest

    root = Path(os.environ.get("TUBERLINE_SHARED", Path(__file__).resolve().parents[3] / "shared")).resolve()
    potato = root / "data" / "potatotwin_sample" / "R9-9_pcd_365.ply"
    if not potato.is_file():
        pytest.skip(f"the real data are not at {root}; set TUBERLINE_SHARED to run this page")
    stage.words["../shared"] = str(root)
    shutil.copy(potato, stage.clone)


@contextmanager
def beside(stage: Stage, wanted: tuple[str, ...]) -> Iterator[None]:
    """What runs beside a page and is not ours: a PostgreSQL, a Rerun that listens."""
    if "database" in wanted:
        from tests.sync.postgres import Postgres

        server = Postgres()
        server.start()
        stage.words["postgresql://farm@10.0.0.9/yield"] = server.url
        try:
            yield
        finally:
            server.remove()
    elif "hub" in wanted:
        from viewer.rerun.launch import native_program

        words = ["--bind", "127.0.0.1", "--port", "9976", "--serve-web", "--web-viewer-port", "9977"]
        program = subprocess.Popen([str(native_program()), *words], stdout=subprocess.DEVNULL)
        stage.words["127.0.0.1:9876/proxy"] = "127.0.0.1:9976/proxy"
        try:
            yield
        finally:
            program.terminate()
            program.wait(20)
    else:
        yield


OUTSIDE = ("database", "hub")
MADE: tuple[Callable[[Stage], None], ...] = (
    *(apples, bucket, checkpoint, cloud, clouds, contract, foreign_frames, graphviz, line_file, other_weights, packs),
    *(page_token, recording, recordings_folder, router, run, run_today, shared, today, track, twin, two_lines),
)
GIVEN = {made.__name__: made for made in MADE}
