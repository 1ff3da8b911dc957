"""How a package that only some installs need is installed; it is in every error that misses one."""

from __future__ import annotations

import importlib
import re
from importlib import metadata
from typing import Any

from conveyor.errors import ConfigError, InputError

SYSTEM_LIBRARIES = {"libusb-1.0.so.0": "libusb-1.0-0"}
"""Libraries of the system that packages of extras need, and the package of Debian and Ubuntu that each is in."""
_NO_LIBRARY = re.compile(r"(lib\S+\.so[.\d]*): cannot open shared object file")


def install_hint(extra: str) -> str:
    """The command that adds the extra `extra` of pyproject.toml. Tuberline is installed from a clone of its repository:
    no package index has it.
    """
    return f"in the clone of the repository: .venv/bin/pip install -e '.[{extra}]'"


def check_version(package: str, supported: str, *, extra: str, what: str) -> None:
    """Refuse a version of an installed package that this program was not written for.

    Args:
        supported: what its version begins with, e.g. '0.41.'.

    Raises:
        ConfigError: another one is installed.
    """
    found = metadata.version(package)
    if not found.startswith(supported):
        raise ConfigError(f"{what} needs {package} {supported}*, found {found}; install it {install_hint(extra)}")


def needed(module: str, *, extra: str, what: str) -> Any:
    """A module of a package that only some installs have.

    Raises:
        InputError: it, or a package or a library that it needs itself, is not installed; names that one.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        if isinstance(error.__cause__, SystemExit):  # told to end while a compiled module was loaded
            raise error.__cause__ from None
        raise InputError(missing_package(error, module, extra=extra, what=what)) from error


def missing_package(error: ImportError, package: str, *, extra: str, what: str) -> str:
    """Which package is missing, and how it is installed: `package`, one that it imports in its turn, or a library of
    the system, which pip does not bring.
    """
    library = _NO_LIBRARY.search(str(error))
    if library is not None:
        there = SYSTEM_LIBRARIES.get(library[1])
        how = f" (Debian, Ubuntu: sudo apt-get install {there})" if there else ""
        return (
            f"{what} needs the system's library {library[1]}, which {package} is built on and which is not on this "
            f"machine; install it{how}"
        )
    lacking = (error.name or package).split(".")[0]
    own = lacking.replace("-", "_") == package.split(".")[0].replace("-", "_")
    lacking = package if own else lacking
    if error.name is not None and "." in error.name and lacking == "backports":
        lacking = error.name  # a name that several packages share
    through = "" if own else f" (which {package} needs)"
    broken = "" if isinstance(error, ModuleNotFoundError) else f", which is there and cannot be loaded ({error})"
    return f"{what} needs the package {lacking}{through}{broken}; {install_hint(extra)}"
