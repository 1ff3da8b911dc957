"""Takes out of an installed environment what no program of it reads: `slim.py ENVIRONMENT`, while an image is built.

The libraries' own tests, headers and stubs, the installers, debugging symbols of compiled modules (where `strip` is
there), and the bytecode of those parts of large libraries that nothing of ours imports.
"""

from __future__ import annotations

import pkgutil
import re
import shutil
import subprocess
import sys
from pathlib import Path

INSTALLERS = ("pip", "setuptools", "pkg_resources", "_distutils_hack", "distutils-precedence.pth")
FOR_DEVELOPERS = ("torch/test", "torch/include", "torch/share", "numpy/_core/include")
UNUSED = (
    # The same runtime once more, for programs in C.
    "onnxruntime/capi/libonnxruntime.so*",
    # Cameras on a DDS network, and a tool for sending them logs.
    *(f"pyrealsense2/{part}" for part in ("pyrealdds*", "pyrsutils*")),
    *(
        f"scipy/{part}"
        for part in (
            *("cluster", "datasets", "differentiate", "fftpack", "integrate", "interpolate", "misc"),
            *("odr", "signal", "stats"),
        )
    ),
    *(f"onnxruntime/{part}" for part in ("backend", "datasets", "quantization", "tools", "transformers")),
)
"""Parts of libraries that nothing here imports; every import of scipy in our sources is tried after they are gone."""
STRIPPED = ("cryptography", "llvmlite", "lz4", "numba", "pydantic_core", "zenoh", "zstandard")
"""Not those whose makers moved libraries into a folder NAME.libs: strip breaks what patchelf has laid out."""
SOURCES = (".pyi", ".pyx", ".pxd", ".h", ".hpp", ".c", ".a")
"""Endings of what only compilers and type checkers read."""
COMPILES = "triton"
"""It hands its own to a compiler at run time, for a GPU."""
OURS = ("conveyor", "camera_sim", "segmenter", "regressor", "aggregator", "viewer", "tuberline")
LARGE = ("scipy", "numpy", "torch", "sympy", "networkx", "rerun", "pygments")


def size_mb(folder: Path) -> float:
    return sum(file.lstat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6


def remove(found: Path) -> None:
    """A folder with all that is in it, or a file; nothing where there is neither any more."""
    if found.is_dir():
        shutil.rmtree(found)
    else:
        found.unlink(missing_ok=True)


def slim(site: Path) -> None:
    """Slim one site-packages folder in place."""
    for folder in [folder for folder in site.rglob("tests") if folder.is_dir()]:
        remove(folder)
    for pattern in FOR_DEVELOPERS + UNUSED:
        for found in list(site.glob(pattern)):
            remove(found)
    for file in [file for file in site.rglob("*") if file.suffix in SOURCES]:
        if file.relative_to(site).parts[0] != COMPILES:
            remove(file)
    for name in INSTALLERS:
        for found in [site / name, *site.glob(f"{name}-*.dist-info")]:
            remove(found)
    if shutil.which("strip") is None:
        return
    for library in [file for name in STRIPPED for file in (site / name).rglob("*.so")]:
        stripped = library.with_name(library.name + ".stripped")
        done = subprocess.run(["strip", "--strip-unneeded", "-o", stripped, library], capture_output=True, check=False)
        if done.returncode == 0 and stripped.stat().st_size < library.stat().st_size:
            shutil.copymode(library, stripped)
            stripped.replace(library)
        stripped.unlink(missing_ok=True)


def only_used_bytecode(site: Path) -> None:
    """Bytecode of large libraries: thrown away, and written again for what importing all of ours loads."""
    for name in LARGE:
        for cache in list((site / name).rglob("__pycache__")):
            shutil.rmtree(cache)
    modules = [m.name for name in OURS for m in pkgutil.walk_packages([str(site / name)], f"{name}.")]
    code = """
import importlib, sys
for name in sys.argv[1:]:
    try:
        importlib.import_module(name)
    except Exception as error:
        if not isinstance(error.__cause__ or error, ModuleNotFoundError):
            raise  # it is broken; the others need what this image does not have
"""
    # Those inside functions too, for they run later.
    sources = [file.read_text(encoding="utf-8") for name in OURS for file in (site / name).rglob("*.py")]
    code += "\n".join(sorted({line for text in sources for line in re.findall(r"^ *(from scipy.*)$", text, re.M)}))
    names = [name for name in modules if not name.endswith("__main__")]
    done = subprocess.run([str(site.parents[2] / "bin" / "python"), "-c", code, *names], check=False)
    if done.returncode != 0:
        raise SystemExit("slim.py: something that is imported has been taken out, see above")


def main() -> None:
    (environment,) = map(Path, sys.argv[1:])
    (site,) = environment.glob("lib/python3.*/site-packages")
    before = size_mb(site)
    slim(site)
    only_used_bytecode(site)
    print(f"{site}: {before:.0f} MB, {size_mb(site):.0f} MB without what no program reads")


if __name__ == "__main__":
    main()
