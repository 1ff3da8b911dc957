"""`python -m benchmarks [NAME [options]]`: run a benchmark by name; without a name, list them.

A benchmark is a module of this folder with `main(arguments)`; its docstring's first line says what it measures.
"""

from __future__ import annotations

import ast
import importlib
import signal
import sys
from pathlib import Path

from conveyor.errors import TuberlineError


def benchmarks() -> dict[str, str]:
    """What each benchmark measures, by name; read without importing anything."""
    found = {}
    for path in sorted(Path(__file__).parent.glob("[a-z]*.py")):
        module = ast.parse(path.read_text(encoding="utf-8"))
        if any(isinstance(node, ast.FunctionDef) and _takes_arguments(node) for node in module.body):
            found[path.stem] = (ast.get_docstring(module) or "").partition("\n")[0]
    return found


def _takes_arguments(function: ast.FunctionDef) -> bool:
    return function.name == "main" and [a.arg for a in function.args.args] == ["arguments"]


def _run(arguments: list[str]) -> int:
    known = benchmarks()
    if not arguments or arguments[0] in ("-h", "--help"):
        width = max(map(len, known), default=0)
        sys.stdout.writelines(f"{name:<{width}}  {about}\n" for name, about in known.items())
        return 0
    if arguments[0] not in known:
        raise TuberlineError(f"benchmark '{arguments[0]}' is unknown; known: {', '.join(known)}")
    return importlib.import_module(f"benchmarks.{arguments[0]}").main(arguments[1:]) or 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # what was started is ended, and removed
    try:
        sys.exit(_run(sys.argv[1:]))
    except TuberlineError as error:
        sys.stderr.write(f"benchmarks: {error}\n")
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
