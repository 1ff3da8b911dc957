"""On PYTHONPATH of real processes: functions named in TUBERLINE_RAISE raise once, as a fault of the program would.

Each entry is `ROLE MODULE FUNCTION CALL`: in a process `tuberline ROLE`, the CALL-th call of FUNCTION (of that process)
raises; the folder TUBERLINE_RAISED remembers it, so that the process that is started again does not raise there.
"""

from __future__ import annotations

import functools
import importlib.abc
import importlib.machinery
import importlib.util
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any

FAULTS = [line.split() for line in os.environ.get("TUBERLINE_RAISE", "").splitlines()]
RAISED = Path(os.environ.get("TUBERLINE_RAISED", "."))


def raising(work: Callable[..., Any], role: str, name: str, call: int) -> Callable[..., Any]:
    """`work` that raises at its `call`-th call, in one process of that role."""
    calls = 0

    @functools.wraps(work)
    def faulty(*args: Any, **named: Any) -> Any:
        nonlocal calls
        if sys.argv[1:2] == [role]:
            calls += 1
            if calls == call:
                try:
                    with (RAISED / f"{role} {name}").open("x") as file:
                        file.write(str(os.getpid()))
                except FileExistsError:
                    return work(*args, **named)
                raise RuntimeError(f"injected into {name} of the {role}")
        return work(*args, **named)

    return faulty


class Loader(importlib.abc.Loader):
    """Runs the module as its own loader does, then puts the faults in."""

    def __init__(self, own: importlib.abc.Loader) -> None:
        self._own = own

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType | None:
        return self._own.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        self._own.exec_module(module)
        for role, name, function, call in FAULTS:
            if name == module.__name__:
                *path, last = function.split(".")
                owner = functools.reduce(getattr, path, module)
                setattr(owner, last, raising(getattr(owner, last), role, function, int(call)))


class Finder(importlib.abc.MetaPathFinder):
    """Finds the modules that get a fault."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if name not in {fault[1] for fault in FAULTS}:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path)
        if spec is not None and spec.loader is not None:
            spec.loader = Loader(spec.loader)
        return spec


sys.meta_path.insert(0, Finder())
