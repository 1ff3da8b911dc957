"""GDAL's own Parquet driver for the GDAL inside pyogrio's wheel, which comes without it.

The driver's source is in npm's `gdal-async` (the whole GDAL, of the same minor version), Arrow's headers and libraries
are in pyarrow's wheel. Of them g++ makes the plugin that GDAL's own build would; `GDAL_DRIVER_PATH` names its folder.
"""

from __future__ import annotations

import shutil
import subprocess
import tarfile
from pathlib import Path

import pytest

SOURCE = "3.12.3"
"""Of gdal-async, whose versions are GDAL's."""
PARTS = ("driver", "drivercore", "dataset", "layer", "writerdataset", "writerlayer")
"""Without folders of several files (Arrow's datasets)."""
HEADERS = (
    "gdal/gcore", "gdal/port", "gdal/alg", "gdal/apps", "gdal/ogr", "gdal/ogr/ogrsf_frmts",
    "gdal/ogr/ogrsf_frmts/generic", "gdal/ogr/ogrsf_frmts/arrow_common", "gdal/ogr/ogrsf_frmts/parquet",
    "gdal/frmts/mem", "arch/unix",
)  # fmt: skip


def parquet_driver(folder: Path) -> Path:
    """A folder with the plugin, made in `folder`; two minutes. The test is skipped where it cannot be made."""
    pyogrio, pyarrow = pytest.importorskip("pyogrio"), pytest.importorskip("pyarrow")
    for tool in ("npm", "g++"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed: GDAL's Parquet driver cannot be built")
    if pyogrio.__gdal_version__[:2] != tuple(int(part) for part in SOURCE.split(".")[:2]):
        pytest.skip(f"pyogrio has GDAL {pyogrio.__gdal_version_string__}, the driver's source is {SOURCE}")
    gdal = _source(folder)
    arrow, libraries = Path(pyarrow.__file__).parent, Path(pyogrio.__file__).parent.parent / "pyogrio.libs"
    include = [f"-I{gdal / header}" for header in HEADERS] + [f"-I{arrow / 'include'}"]
    flags = ["-std=c++20", "-O0", "-w", "-fPIC", "-DGDAL_COMPILATION"]
    plugins = folder / "plugins"
    plugins.mkdir()
    for part in PARTS:
        source = gdal / f"gdal/ogr/ogrsf_frmts/parquet/ogrparquet{part}.cpp"
        _run("g++", *flags, "-c", *include, str(source), "-o", str(folder / f"{part}.o"))
    _run(
        "g++", "-shared", "-o", str(plugins / "ogr_Parquet.so"), *(str(folder / f"{part}.o") for part in PARTS),
        *(str(next(at.glob(f"{name}.so*"))) for at, name in ((arrow, "libarrow"), (arrow, "libparquet"))),
        str(next(libraries.glob("libgdal-*.so*"))), f"-Wl,-rpath,{arrow}:{libraries}",
    )  # fmt: skip
    return plugins


def _source(folder: Path) -> Path:
    """`deps/libgdal` of the package."""
    if subprocess.run(
        ["npm", "pack", "--silent", f"gdal-async@{SOURCE}"], cwd=folder, timeout=600, check=False
    ).returncode:
        pytest.skip("npm's registry gives no gdal-async: GDAL's Parquet driver cannot be built")
    with tarfile.open(folder / f"gdal-async-{SOURCE}.tgz") as package:
        wanted = [member for member in package if member.name.startswith("package/deps/libgdal/")]
        package.extractall(folder, members=wanted, filter="data")
    return folder / "package/deps/libgdal"


def _run(*command: str) -> None:
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
