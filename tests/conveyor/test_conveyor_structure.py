"""The shape of the system, held by tests: who may import whom, what stays light, one table of topics."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import conveyor.messages as messages
from conveyor.topics import TOPICS, Delivery

ROOT = Path(__file__).resolve().parents[2]
ROLES = ("camera_sim", "segmenter", "regressor", "aggregator", "viewer")
PACKAGES = (*ROLES, "conveyor", "tuberline")
LABORATORY = ("training", "studies", "scoring", "sim")
"""Parts of the roles that no node imports: what trains, studies, judges and simulates."""
NODES = (
    "camera_sim.node",
    "camera_sim.recorder",
    "segmenter.node",
    "regressor.serve.node",
    "aggregator.node",
    "viewer.node",
    "tuberline.cli.router",
)
MOST_LINES_OF_A_FILE = 400
MOST_LINES_OF_A_FUNCTION = 70
"""Beside its docstring: that of a command is its help, and every option stands in it."""
LONGER_FILES: dict[str, int] = {}
LONGER_FUNCTIONS: dict[str, int] = {}
"""Exceptions, with their length; aim at none."""
SOURCES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for package in PACKAGES
    for path in (ROOT / package).rglob("*.py")
}
"""Every module of ours by its name."""


@cache
def imports(path: Path, *, types: bool) -> frozenset[str]:
    """Full names of everything a file imports, anywhere in it; of `from a import b` both a and a.b.

    Without `types` those imports are left out that only a type checker follows.
    """
    names: set[str] = set()
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for_types_alone = {
        inner
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if node in for_types_alone and not types:
            continue
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, f"{path} imports relatively"
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return frozenset(names)


def tops(path: Path) -> set[str]:
    """Packages that a file imports."""
    return {name.split(".")[0] for name in imports(path, types=True)}


def reached(module: str) -> dict[str, str]:
    """Modules of ours that `module` imports, and those import, and so on; each with the one that first did."""
    found, waiting = {module: ""}, [module]
    while waiting:
        here = waiting.pop()
        parents = {here.rsplit(".", n)[0] for n in range(1, here.count(".") + 1)}
        for name in sorted(
            {name for name in imports(SOURCES[here], types=False) | parents if name in SOURCES} - set(found)
        ):
            found[name] = here
            waiting.append(name)
    return found


@pytest.mark.parametrize("role", ROLES)
def test_roles_import_conveyor_and_nothing_else_of_ours(role: str) -> None:
    for module, path in SOURCES.items():
        if module.split(".")[0] == role:
            assert tops(path) & set(PACKAGES) <= {role, "conveyor"}, path


def test_the_ground_imports_nothing_above_it() -> None:
    for module, path in SOURCES.items():
        if module.split(".")[0] == "conveyor":
            assert tops(path) & set(PACKAGES) <= {"conveyor"}, path


@pytest.mark.parametrize("node", NODES)
def test_no_node_imports_the_laboratory(node: str) -> None:
    modules = reached(node)
    assert len(modules) > 5, "the walk found the node's own modules"
    for module, by in modules.items():
        assert not set(module.split(".")) & set(LABORATORY), f"{node} reaches {module} through {by}"


def test_the_walk_finds_what_it_looks_for() -> None:
    assert "camera_sim.sim.record" in reached("tuberline.api.recordings"), "imports inside functions count"
    assert reached("regressor.training.run")["regressor.training.loop"] == "regressor.training.run"


def test_files_and_functions_stay_short() -> None:
    files = {
        str(path.relative_to(ROOT)): lines
        for path in SOURCES.values()
        if (lines := path.read_text(encoding="utf-8").count("\n")) > MOST_LINES_OF_A_FILE
    }
    assert files == LONGER_FILES
    functions = {
        f"{path.relative_to(ROOT)}:{name}": lines
        for path in SOURCES.values()
        for name, lines in function_lines(path)
        if lines > MOST_LINES_OF_A_FUNCTION
    }
    assert functions == LONGER_FUNCTIONS


def function_lines(path: Path) -> Iterator[tuple[str, int]]:
    """Name and length of each function in a file, without its docstring."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            about = node.body[0] if ast.get_docstring(node) is not None else None
            docstring = (about.end_lineno or 0) - about.lineno + 1 if about else 0
            yield node.name, (node.end_lineno or 0) - node.lineno + 1 - docstring


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom tuberline.cli.commands import build_app\n"
        "try:\n    build_app()(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'torch', 'cv2', 'numba', 'scipy', 'rerun', 'zenoh', 'numpy', 'pydantic'} & set(sys.modules)\n"
        "sys.exit(str(sorted(heavy)) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_router_loads_neither_numpy_nor_messages() -> None:
    """A third of its start and 13 MB, for the reports that only a node reads."""
    code = (
        "import sys, tuberline.cli.router\n"
        "heavy = {'torch', 'cv2', 'numba', 'scipy', 'numpy', 'conveyor.messages'} & set(sys.modules)\n"
        "sys.exit(str(sorted(heavy)) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_command_exists_and_explains_itself() -> None:
    from tuberline.cli.commands import build_app

    app = build_app()
    names = [name for name in app if not name.startswith("-")]
    assert {"demo", "replay", "run", "weigh", "score", "simulate", "status", "top", "recover"} <= set(names)
    for name in names:
        assert app[name].help, name


def test_topics_have_unique_keys_and_real_messages() -> None:
    keys = [topic.path for topic in TOPICS]
    assert len(set(keys)) == len(keys)
    for topic in TOPICS:
        if topic.delivery in (Delivery.TOKEN, Delivery.QUERY):
            assert topic.message == ""
        else:
            assert hasattr(messages, topic.message), topic


def test_a_key_gives_its_parts_back() -> None:
    for topic in TOPICS:
        parts = {part: f"x-{part}" for part in topic.part_names}
        assert topic.parts(topic.key("line", **parts)) == parts
