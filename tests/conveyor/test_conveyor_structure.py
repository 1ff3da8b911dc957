"""The shape of the system, held by tests: who may import whom, what stays light, one table of topics."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import conveyor.messages as messages
from conveyor.topics import TOPICS, Delivery

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("camera_sim", "segmenter", "regressor", "aggregator", "viewer", "conveyor")


def imports(path: Path) -> set[str]:
    """Top-level names of everything a file imports, anywhere in it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module.split(".")[0])
    return names


@pytest.mark.parametrize("package", PACKAGES)
def test_no_package_imports_another_beside_conveyor(package: str) -> None:
    allowed = {package, "conveyor"}
    for path in (ROOT / package).rglob("*.py"):
        assert not (imports(path) & set(PACKAGES)) - allowed, path


def test_help_loads_nothing_heavy() -> None:
    code = (
        "import sys\nfrom tuberline.cli import build_app\n"
        "try:\n    build_app()(['--help'])\nexcept SystemExit:\n    pass\n"
        "heavy = {'torch', 'cv2', 'numba', 'scipy', 'rerun', 'zenoh', 'numpy', 'pydantic'} & set(sys.modules)\n"
        "sys.exit(str(sorted(heavy)) if heavy else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_command_exists_and_explains_itself() -> None:
    from tuberline.cli import build_app

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
        parts = {
            part: f"x-{part}" for part in ("camera", "regressor", "role", "name", "source") if f"<{part}>" in topic.path
        }
        assert topic.parts(topic.key("line", **parts)) == parts
