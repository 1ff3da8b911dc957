"""A host without torch: a whole line runs there and weighs; what needs torch says so in a sentence."""

from __future__ import annotations

import ast
import os
import re
import runpy
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.regressor.ellipsoids import upper_side

DOCKER = ROOT / "deploy" / "docker"
NEED_NO_TORCH = (
    *("camera_sim.node", "camera_sim.recorder", "segmenter.node", "regressor.serve.node", "aggregator.node"),
    "viewer.page.server",
)
CONFIG = """name = "field"
[cameras.left]
path = "recording"
[regressor]
precision = "bfloat16"
[aggregator]
out = "ledger"
"""


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of an environment that has every library of this one but torch."""
    home = tmp_path_factory.mktemp("edge") / "venv"
    venv.create(home, with_pip=False, symlinks=True)
    site = home / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    for entry in Path(sysconfig.get_path("purelib")).iterdir():
        if not re.match(r"(torch|functorch|__editable__|_editable|tuberline)", entry.name):
            (site / entry.name).symlink_to(entry)
    return home / "bin" / "python"


def run(python: Path, *words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}
    return subprocess.run(
        [str(python), *words], capture_output=True, text=True, check=False, cwd=cwd, env=environment, timeout=120
    )


def test_no_node_of_a_line_needs_torch(python: Path, tmp_path: Path) -> None:
    code = f"import importlib.util, {', '.join(NEED_NO_TORCH)}; assert importlib.util.find_spec('torch') is None"
    done = run(python, "-c", code, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


def test_nothing_of_ours_imports_what_images_leave_out() -> None:
    """No image could be built since intervals from few tubers came to import scipy.stats."""
    slim = runpy.run_path(str(DOCKER / "slim.py"))
    left_out = {part.replace("/", ".") for part in slim["UNUSED"] if "*" not in part}
    imported = {
        (f"{node.module}.{name.name}" if isinstance(node, ast.ImportFrom) else name.name, str(file.relative_to(ROOT)))
        for package in slim["OURS"]
        for file in (ROOT / package).rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in node.names
    }
    assert {each for each in imported if any(f"{each[0]}.".startswith(f"{part}.") for part in left_out)} == set()
    assert "scipy.stats" in left_out
    assert ("scipy.spatial.cKDTree", "aggregator/scoring/align.py") in imported


def test_it_weighs_what_a_host_with_torch_weighs(python: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "cloud.npy", upper_side(0.46))
    words = ("-m", "tuberline", "weigh", "cloud.npy", "--belt-distance-m", "0.46", "--json")
    without, beside = (run(which, *words, cwd=tmp_path) for which in (python, Path(sys.executable)))
    assert (without.returncode, without.stderr) == (0, "")
    assert without.stdout == beside.stdout


@pytest.mark.parametrize(
    "words",
    [
        ("regressor", "--config", "line.toml", "--run", "r", "--name", "r1"),
        ("train", "--data", "pack", "--val", "other", "--out", "run"),
    ],
)
def test_what_needs_torch_says_so_in_a_sentence_for_good(python: Path, tmp_path: Path, words: tuple[str, ...]) -> None:
    (tmp_path / "line.toml").write_text(CONFIG)
    done = run(python, "-m", "tuberline", *words, cwd=tmp_path)
    (sentence,) = done.stderr.splitlines()
    assert f"`{words[0]}` needs torch for this, which is not installed here" in sentence
    assert done.returncode == 2, "permanent: neither supervisor nor systemd tries again"


def test_weights_that_torch_alone_reads_are_refused_by_name(python: Path, tmp_path: Path) -> None:
    (tmp_path / "upstream.pth").write_bytes(b"of torch")
    np.save(tmp_path / "cloud.npy", upper_side(0.46))
    words = ("weigh", "cloud.npy", "--belt-distance-m", "0.46", "--weights", "upstream.pth")
    done = run(python, "-m", "tuberline", *words, cwd=tmp_path)
    assert done.returncode == 2
    (sentence,) = done.stderr.splitlines()
    assert "weights upstream.pth can be read by torch alone, which is not installed here: make a .saf" in sentence


def test_the_edge_images_list_has_everything_but_torch() -> None:
    def listed(*options: str) -> set[str]:
        words = [sys.executable, str(DOCKER / "requirements.py"), *options]
        said = subprocess.run(words, capture_output=True, text=True, check=True, cwd=ROOT).stdout
        return {re.split(r"[^\w.-]", line)[0] for line in said.splitlines()}

    assert listed("deploy") - listed("--without", "torch", "deploy") == {"torch"}
    assert listed("--only", "viewer") == {"rerun-sdk"}
    words = [sys.executable, str(DOCKER / "requirements.py"), "cook"]
    refused = subprocess.run(words, capture_output=True, text=True, check=False, cwd=ROOT)
    assert refused.returncode != 0
    assert "extra 'cook' is not in pyproject.toml; known: alarms" in refused.stderr
