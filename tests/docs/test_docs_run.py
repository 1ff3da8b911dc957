"""What the pages tell a reader to type is typed here, in order, in a clean clone.

Slow, a page by its name: `pytest -m slow tests/docs/test_docs_run.py -k first-line`. Sizes are limited by
TUBERLINE_DOCS_TUBERS and its like (tests/docs/blocks.py). tests/docs/pages.py says what each page takes for granted and
which lines are not typed, with why. That every command of every page parses is tested in
tests/conveyor/test_conveyor_docs.py.
"""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import pytest

from conveyor.config import parse_config
from conveyor.contract import Contract
from tests.docs.blocks import Code, Command, File, blocks, made_small
from tests.docs.given import GIVEN, LINE, OUTSIDE, beside, line_toml
from tests.docs.pages import ELSEWHERE, PAGES
from tests.docs.stage import Stage

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
ALL = [
    "README.md",
    "CONTRIBUTING.md",
    *(str(page.relative_to(ROOT)) for top in ("docs", "deploy") for page in sorted((ROOT / top).rglob("*.md"))),
]
OTHERS = "python|python3|make|sudo|docker|kubectl|for|cd|git|pip|rerun|ssh|scp|nginx|printf|zenohd|source"
PROGRAMS = re.compile(rf"(tuberline|{OTHERS}|deploy/\S+|[A-Z_]+=\S+) ")
LIMIT_S = 900


@pytest.mark.parametrize("name", ALL)
def test_every_block_of_every_page_is_typed_or_says_why_not(name: str) -> None:
    """A new block that runs nowhere fails here."""
    found = list(blocks(text(name)))
    if name in ELSEWHERE or (name not in PAGES and not found):
        return
    assert name in PAGES, "say in tests/docs/pages.py what this page takes for granted"
    lines = [part.line for part in found if isinstance(part, Command)]
    assert [line for line in lines if not PROGRAMS.match(line)] == [], "no command: fence it as text, toml or json"
    assert [why for why in PAGES[name].shown if not any(line.startswith(why) for line in lines)] == [], "it is gone"
    assert [given for given in PAGES[name].given if given not in {*GIVEN, *OUTSIDE}] == []


def test_reasons_name_files_that_exist() -> None:
    reasons = {why for page in PAGES.values() for why in page.shown.values()} | set(ELSEWHERE.values())
    named = {path for why in reasons for path in re.findall(r"[\w./]+\.py|\.ci/run", why)}
    assert [path for path in sorted(named) if not (ROOT / path).is_file()] == []
    lines = [(name, part.line) for name in PAGES for part in blocks(text(name)) if isinstance(part, Command)]
    shown = [line for name, line in lines if _why_not(name, line)]
    assert len(shown) < 0.25 * len(lines), shown


def _why_not(name: str, line: str) -> str:
    return next((why for begins, why in PAGES[name].shown.items() if line.startswith(begins)), "")


@pytest.mark.parametrize("page", sorted(DOCS.glob("*.md")), ids=lambda page: page.name)
def test_every_toml_and_json_on_a_page_is_accepted(page: Path) -> None:
    for kind, inside in re.findall(
        r"^```(toml|json)\b.*\n((?:.*\n)*?)```$", page.read_text(encoding="utf-8"), re.MULTILINE
    ):
        if kind == "json":
            json.loads(inside)
        elif "[[classes]]" in inside:
            Contract.model_validate(tomllib.loads(inside))
        else:
            parse_config(tomllib.loads(inside), where=page.name)


def test_the_given_line_is_accepted() -> None:
    filled = LINE.format(name="north", router="tcp/127.0.0.1:7447", recording="recordings/monday", speed=0.05)
    assert parse_config(tomllib.loads(filled), where="given").cameras["front"].speed == 0.05


def test_sizes_are_limited_and_never_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TUBERLINE_DOCS_TUBERS", "20")
    monkeypatch.setenv("TUBERLINE_DOCS_MINUTES", "0.5")
    assert made_small("tuberline simulate --tubers 300 --seed 300") == "tuberline simulate --tubers 20 --seed 300"
    assert made_small("tuberline simulate --tubers 5") == "tuberline simulate --tubers 5"
    assert made_small("tuberline train --data a") == "tuberline train --data a --minutes 0.5"
    assert made_small("tuberline train --minutes 60 --lr 1") == "tuberline train --minutes 0.5 --lr 1"


def test_blocks_come_in_order_and_other_fences_are_only_shown() -> None:
    page = '# A\n    tuberline a   # remark\n\n```toml title="b.toml"\nc = 1\n```\n\n'
    page += "```text\nshown\n```\n    for b in c; do\n      d \\\n        e\n    done\n"
    page += "```console\ntuberline f\n```\n```python\ng = 1\n```\n"
    loop = "for b in c; do\nd e\ndone"
    found = [Command("tuberline a"), File("b.toml", "c = 1\n"), Command(loop), Command("tuberline f"), Code("g = 1\n")]
    assert list(blocks(page)) == found


@pytest.fixture
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of one page, beside the recording and the run that all pages share."""
    return tmp_path_factory.mktemp("page")


@pytest.mark.slow
@pytest.mark.timeout(4 * LIMIT_S)
@pytest.mark.parametrize("name", list(PAGES))
def test_a_page_is_typed_from_top_to_bottom(name: str, folder: Path) -> None:
    page, stage = PAGES[name], Stage(folder)
    stage.words |= page.words
    if page.line:
        (stage.clone / "line.toml").write_text(line_toml(stage, page.line), encoding="utf-8")
        (stage.clone / "LINE.toml").write_text(line_toml(stage, page.line), encoding="utf-8")
    try:
        with beside(stage, page.given):
            for given in page.given:
                if given in GIVEN:
                    GIVEN[given](stage)
            if page.line:
                stage.do("tuberline run line.toml &")
            for part in blocks(text(name)):
                if isinstance(part, File):
                    (stage.clone / part.name).write_text(part.text, encoding="utf-8")
                elif isinstance(part, Code):
                    stage.run_python(part.text)
                elif not _why_not(name, part.line):
                    codes = next((codes for begins, codes in page.codes.items() if part.line.startswith(begins)), (0,))
                    stage.do(part.line, codes=codes)
            stage.end()
    finally:
        stage.kill()


def text(name: str) -> str:
    """The page `name`."""
    return (ROOT / name).read_text(encoding="utf-8")
