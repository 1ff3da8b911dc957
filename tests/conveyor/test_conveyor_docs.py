"""The documentation is held to the code: generated pages, commands, links, pictures, the site's table of contents."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from cyclopts import App
from cyclopts.exceptions import CycloptsError, MissingArgumentError

from tuberline.cli.commands import build_app
from tuberline.cli.reference import pages

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", *sorted(DOCS.rglob("*.md"))]
GENERATED = ("../regressor/weights/MODEL_CARD.md", "api.md", "commands.md", "config.md", "evaluation.md", "topics.md")
REFERENCE = ("api.md", "commands.md", "topics.md")
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
CODE = re.compile(r"`([^`\n]+)`")
STOP = re.compile(r"\s*(?:\||;|&&|&(?=\s|$)|>|<(?=\s)|#(?=\s)|\s{3,}(?!-)).*")
"""What follows a command on its line: a pipe, another command, a redirection, a remark behind a '#' or a wide gap."""
SHORTHAND = {"...", "…", "[OPTIONS]"}


@pytest.fixture(scope="module")
def made() -> dict[str, str]:
    """All pages that are made from the code."""
    return pages()


@pytest.mark.parametrize("name", GENERATED)
def test_a_page_made_from_the_code_is_up_to_date(made: dict[str, str], name: str) -> None:
    assert (DOCS / name).read_text(encoding="utf-8") == made[name], "run: make docs"


@pytest.mark.parametrize("name", NAMES)
def test_links_and_pictures_lead_somewhere(name: str) -> None:
    page = ROOT / name
    text = page.read_text(encoding="utf-8")
    assert [
        target
        for target in re.findall(r"\]\((?!https?:|#|mailto:)([^)#\s]+)", text)
        if not (page.parent / target).exists()
    ] == []
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#\s]*)#([^)\s]+)\)", text):
        there = (page.parent / target) if target else page
        assert anchor in anchors(there.read_text(encoding="utf-8")), f"{target}#{anchor}"


def anchors(text: str) -> set[str]:
    """What headings of a page are linked by."""
    heads = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


@pytest.fixture(scope="module")
def app() -> App:
    """The command tree."""
    return build_app()


@pytest.mark.parametrize("name", [name for name in NAMES if Path(name).name not in REFERENCE])
def test_every_command_that_is_written_down_parses(name: str, app: App) -> None:
    refused = [
        f"{line} ({reason})"
        for line in commands((ROOT / name).read_text(encoding="utf-8"))
        if (reason := fault(app, line))
    ]
    assert refused == []


def test_the_check_of_commands_finds_what_is_wrong(app: App) -> None:
    text = "    tuberline replay REC --out out/x   # a remark\n`tuberline top --config a.toml`, `tuberline topp`\n"
    lines = list(commands(text))
    assert lines == ["replay REC --out out/x", "top --config a.toml", "topp"]
    assert [bool(fault(app, line)) for line in lines] == [False, False, True]
    assert fault(app, "replay REC --outt x")
    assert fault(app, "calibrate belts REC")
    assert fault(app, "simulate --scene a --out b --tubers many")
    assert fault(app, "replay") == "", "a command may be named without what it needs"


def commands(text: str) -> Iterator[str]:
    """The arguments of every `tuberline ...` in code: indented or fenced lines, and words between back-ticks."""
    fenced = False
    for line in text.splitlines():
        if line.lstrip().startswith("```"):
            fenced = not fenced
        elif fenced or line.startswith("    "):
            found = re.match(
                r"(?:\s*(?:[A-Z_]+=\S+|sudo|\$|\S*/?\.venv/bin/(?=tuberline)))*\s*(?:\S*/)?tuberline\s+(.*)", line
            )
            if found:
                yield STOP.sub("", found[1]).strip()
                for further in re.findall(r"&\s+tuberline\s+([^&|;#]+)", line):
                    yield further.strip()
        else:
            for code in CODE.findall(line):
                if found := re.match(r"(?:\S*/)?tuberline\s+(.*)", code):
                    yield STOP.sub("", found[1]).strip()


def fault(app: App, line: str) -> str:
    """Why the command line would be refused; empty where it would not, or only lacks what it needs."""
    words = [word for word in shlex.split(line.replace("[", "").replace("]", "")) if word not in SHORTHAND]
    try:
        command, bound, _ = app.parse_args(words, print_error=False, exit_on_error=False)
    except MissingArgumentError:
        unknown = [
            word for word in words if word.startswith("--") and word.partition("=")[0] not in options(app, words)
        ]
        return f"no option {unknown[0]}" if unknown else ""
    except CycloptsError as error:
        return str(error).splitlines()[0] if str(error) else type(error).__name__
    if command.__name__ == "help_print" or command == app.help_print:
        rest = [word for word in words if not word.startswith("-")]
        return "" if not rest or names_a_command(app, rest) else f"no command '{line}'"
    return "" if bound is not None else "not parsed"


def options(app: App, words: list[str]) -> set[str]:
    """The option names of the command that the first words name."""
    for word in words:
        if word.startswith("-") or word not in app:
            break
        app = app[word]
    return {name for argument in app.assemble_argument_collection() for name in argument.names}


def names_a_command(app: App, words: list[str]) -> bool:
    """The words are a path in the command tree."""
    for word in words:
        if word not in app:
            return False
        app = app[word]
    return True


def test_the_site_is_built_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("zensical", reason="the docs' site needs the extra 'docs' (zensical): not built")
    shutil.copytree(DOCS, tmp_path / "docs")
    shutil.copy(ROOT / "zensical.toml", tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "zensical", "build", "--strict"],
        cwd=tmp_path,
        env={**os.environ, "NO_COLOR": "1"},
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout + done.stderr[-2000:]
    html = "".join(page.read_text(encoding="utf-8") for page in (tmp_path / "site").glob("*.html"))
    assert not re.findall(r'<(?:script|link|img)[^>]+(?:src|href)="https?://[^"]+', html), "nothing from elsewhere"


def test_the_site_has_every_page_and_no_other() -> None:
    config = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]
    listed = set(re.findall(r"[\w-]+\.md", str(config["nav"])))
    # docs/results is what the page of results is made from.
    assert listed == {str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md") if "results" not in page.parts}
    assert config["theme"]["font"] is False, "nothing is loaded from elsewhere"
