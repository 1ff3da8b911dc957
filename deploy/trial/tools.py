"""What the trials have in common: asking for root and tools, running commands, their folder, tables for the docs."""

from __future__ import annotations

import fcntl
import os
import platform
import re
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs" / "deploy.md"
SUITE = "bookworm"
"""Debian's, of the roots."""
MAKE = {"images": "make images", "containers": "make images", "boot": "make boot", "powercuts": "make powercuts"}
"""The command that makes each table of the docs."""


PATIENCE_S = 1800.0
"""The longest wait for one step: a machine that has other work takes minutes for what takes a quiet one seconds."""


class TrialError(Exception):
    """What stopped a trial, in one sentence."""


def say(text: str) -> None:
    print(text, flush=True)


def need_root(what: str, changes: str) -> None:
    """Refuse all but root, with what it is needed for; tell root what is changed."""
    if os.geteuid() != 0:
        raise TrialError(f"{what} needs root: {changes}. Run it with sudo, on a machine that you may change")
    say(f"{what}: {changes}")


def need_tools(tools: dict[str, str]) -> None:
    """Refuse where a program is missing; `tools` maps each to its Debian package."""
    missing = {tool: package for tool, package in tools.items() if shutil.which(tool) is None}
    if missing:
        packages = " ".join(sorted(set(missing.values())))
        raise TrialError(f"{', '.join(missing)} not found: apt-get install {packages}")


@contextmanager
def alone(space: str) -> Iterator[None]:
    """Hold the names that a trial takes for its network and control groups; a second trial with them is refused."""
    with (Path("/run/lock") / space).open("w", encoding="utf-8") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise TrialError(f"another trial has the network {space} of this machine: wait for it, or end it") from None
        yield


def run(
    command: Sequence[str | Path], *, check: bool = True, timeout_s: float = PATIENCE_S, text: str | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command with its output kept; a failure is told with the end of what it said."""
    words = [str(word) for word in command]
    try:
        done = subprocess.run(words, capture_output=True, text=True, input=text, check=False, timeout=timeout_s)
    except subprocess.TimeoutExpired:
        raise TrialError(f"{' '.join(words)[:300]} was not done after {timeout_s:.0f} s") from None
    if check and done.returncode != 0:
        said = "\n".join((done.stdout + done.stderr).strip().splitlines()[-15:])[-1500:]
        raise TrialError(f"{' '.join(words)[:300]} ended with {done.returncode}:\n{said}")
    return done


def output(command: Sequence[str | Path], **options: float) -> str:
    """What a command printed, stripped."""
    return run(command, **options).stdout.strip()  # type: ignore[arg-type]


def until(true: Callable[[], object], what: str, *, timeout_s: float = PATIENCE_S, every_s: float = 0.5) -> float:
    """Seconds until `true()` was; asking again and again, an error after `timeout_s`."""
    from time import sleep

    start = monotonic()
    while not true():
        if monotonic() - start > timeout_s:
            raise TrialError(f"{what}: not within {timeout_s:.0f} s")
        sleep(every_s)
    return monotonic() - start


def workdir(name: str) -> Path:
    """The trial's own folder, out/trial/NAME unless TUBERLINE_TRIAL names another place; made when it is not there."""
    folder = Path(os.environ.get("TUBERLINE_TRIAL", ROOT / "out" / "trial")).resolve() / name
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def version() -> str:
    """The version of this clone."""
    scope: dict[str, str] = {}
    for line in (ROOT / "conveyor" / "__init__.py").read_text(encoding="utf-8").splitlines():
        if line.startswith("__version__"):
            exec(line, scope)
    return scope["__version__"]


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Markdown."""
    lines = ["| " + " | ".join(map(str, row)) + " |" for row in (head, ["---"] * len(head), *rows)]
    return "\n".join(lines)


def made_by(command: str, tools: Iterable[str]) -> str:
    """When, by what and with which versions a table was made."""
    system = f"{platform.system()} {platform.release().split('-')[0]}, {os.cpu_count()} cores"
    with_tools = [
        " ".join(re.findall(r"^\S+|(?<=\s)v?\d[\w.+~]*", output([tool, "--version"]).splitlines()[0])[:2])
        for tool in tools
    ]
    return (
        f"{datetime.now(UTC):%d %B %Y}, `{command}`, tuberline {version()}, "
        f"{', '.join(with_tools)}, Debian {SUITE} on {system}:"
    )


def into_docs(name: str, text: str, tools: Iterable[str]) -> None:
    """Put a table between the marks of `name` in docs/deploy.md, under the line that says how it was made."""
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    page = DOCS.read_text(encoding="utf-8")
    if begin not in page or end not in page:
        raise TrialError(f"{DOCS} lacks the marks {begin} and {end}")
    before, rest = page.split(begin)
    line = textwrap.fill(made_by(MAKE[name], tools), 100)
    DOCS.write_text(f"{before}{begin}\n{line}\n\n{text}\n{end}{rest.split(end)[1]}", encoding="utf-8")


def ended(main: Callable[[], None]) -> None:
    """Run a trial's main function: one sentence and exit code 2 where it cannot."""
    try:
        main()
    except TrialError as error:
        sys.stderr.write(f"trial: {error}\n")
        raise SystemExit(2) from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None
