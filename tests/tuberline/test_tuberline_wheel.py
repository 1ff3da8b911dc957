"""The wheel, of the sdist, holds what the program needs beside its code, and works where nothing else of ours is."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

from tests.kernels import take_compiled

pytestmark = pytest.mark.timeout(900)
ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("tuberline", "conveyor", "camera_sim", "segmenter", "regressor", "aggregator", "viewer")
DATA = (".safetensors", ".onnx", ".json", ".html", ".css", ".js", ".svg", ".md", "py.typed")
"""Endings of files that are read when the program runs, or that say what it is."""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built from the sdist, as who installs from that does; from a copy, so that nothing is left in the repository."""
    pytest.importorskip("hatchling", reason="building a wheel needs hatchling, of the extra 'dev'")
    folder = tmp_path_factory.mktemp("wheel")
    source = folder / "source"
    listed = run("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", cwd=ROOT).split("\0")
    for name in filter(None, listed):
        if (ROOT / name).is_file():
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(ROOT / name, source / name)
    run(sys.executable, "-m", "hatchling", "build", "--target", "sdist", "--directory", str(folder), cwd=source)
    (sdist,) = folder.glob("tuberline-*.tar.gz")
    build = ("wheel", str(sdist), "--quiet", "--no-deps", "--no-index", "--no-build-isolation")
    run(sys.executable, "-m", "pip", *build, "--wheel-dir", str(folder), cwd=folder)
    (built,) = folder.glob("tuberline-*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The interpreter of a new environment with the wheel; the libraries are lent by this one, ours are not.

    Machine code is lent, too: numba takes what was made of the same source, and all other tests compile that.
    """
    home = tmp_path_factory.mktemp("env") / "venv"
    venv.create(home, with_pip=False, symlinks=True)
    site = home / "lib" / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    run(sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(site), str(wheel))
    # A line of a .pth file is a folder to look in; .pth files inside that folder, an editable install's, do not count.
    (site / "libraries.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    take_compiled(ROOT, site)
    return home / "bin" / "python"


def test_the_wheel_has_weights_pages_and_marks_of_types(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        there = set(archive.namelist())
    needed = {
        str(path.relative_to(ROOT))
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and path.name.endswith((*DATA, ".py"))
    }
    assert not needed - there
    assert {f"{package}/py.typed" for package in PACKAGES} <= there
    tops = {name.split("/")[0] for name in there}
    assert tops <= {*PACKAGES, *(top for top in tops if top.endswith(".dist-info"))}, "nothing else is installed"


def test_import_and_the_first_example_work_there(python: Path, tmp_path: Path) -> None:
    where = run(str(python), "-c", "import tuberline; print(tuberline.__file__, tuberline.__version__)", cwd=tmp_path)
    assert where.startswith(str(python.parents[1])), "the installed one, not this repository"
    example = tmp_path / "example.py"
    shutil.copyfile(ROOT / "docs" / "examples" / "01_weigh_one_cloud.py", example)
    assert " g, 90 % interval " in run(str(python), str(example), cwd=tmp_path)


def test_the_command_line_works_there(python: Path, tmp_path: Path) -> None:
    said = run(str(python), "-m", "tuberline", "simulate", "--out", "belt", "--tubers", "1", "--fps", "5", cwd=tmp_path)
    assert "belt: 1 tubers" in said
    run(str(python), "-m", "tuberline", "info", "belt", "--json", cwd=tmp_path)


def run(*command: str, cwd: Path | None = None) -> str:
    """What a program printed; this repository is on its path only where that is wanted."""
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd, env=env, timeout=600)
    assert done.returncode == 0, f"{command}:\n{done.stdout}\n{done.stderr}"
    return done.stdout
