"""The command line: help on one screen, no option that says nothing, one way to address a line, tab completion."""

from __future__ import annotations

import io
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from cyclopts import App
from rich.console import Console

from conveyor.errors import InputError
from tests.belts import here
from tuberline.cli.commands import FORMER, GROUPS, LAB, PARTS, build_app
from tuberline.cli.width import LEAST_WIDTH, least_width

ROOT = Path(__file__).resolve().parents[2]
WATCHES = (
    "status",
    "top",
    "graph",
    "health",
    "metrics",
    "page",
    "watch",
    "doctor",
    "bundle",
    "weights list",
    "weights use",
)
"""Commands that look at a line."""
TAKES_A_CONFIG = (*WATCHES, "run", "access", "certs make", "certs add", "config check", "config show", *PARTS)


def help_of(*words: str, width: int = 80) -> str:
    """What `--help` prints at `width` columns."""
    text = io.StringIO()
    build_app().help_print([*words], console=Console(file=text, width=width, no_color=True))
    return text.getvalue()


def leaves(app: App, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Every command that does something, as words."""
    for name in app:
        if name.startswith("-") or name in ("lab", "parts"):
            continue
        inner = [word for word in app[name] if not word.startswith("-")]
        if inner:
            yield from leaves(app[name], (*path, name))
        else:
            yield (*path, name)


ALL = sorted(leaves(build_app()))


def test_help_in_a_terminal_of_one_column_is_readable() -> None:
    """It wrote empty lines for ever."""
    command = [sys.executable, "-m", "tuberline", "demo", "--help"]
    narrow = {**_env(), "COLUMNS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=narrow, timeout=60)
    assert done.returncode == 0
    assert "Number of weighing" in done.stdout
    assert max(map(len, done.stdout.splitlines())) == LEAST_WIDTH


@pytest.mark.parametrize(
    ("given", "laid_out"), [("0", "40"), ("2", "40"), ("39", "40"), ("41", "41"), ("wide", "wide")]
)
def test_a_narrow_terminal_is_taken_for_one_of_40_columns(
    given: str, laid_out: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", given)
    least_width()
    assert os.environ["COLUMNS"] == laid_out


def test_help_is_one_screen_of_what_a_user_needs() -> None:
    lines = help_of().rstrip().splitlines()
    assert 24 <= len(lines) <= 40, len(lines)
    assert max(map(len, lines)) <= 80
    listed = {line.split()[0] for line in lines if line.startswith("  ")}
    assert {name for group in GROUPS.values() for name in group} | {"lab", "parts", "completion"} <= listed
    assert not listed & {*LAB, *PARTS, *FORMER}
    for title in GROUPS:
        assert f"{title}:" in lines


@pytest.mark.parametrize(("listing", "commands"), [("lab", LAB), ("parts", PARTS)])
def test_the_rest_is_listed_one_step_further_and_works_by_its_own_name(
    listing: str, commands: dict[str, object]
) -> None:
    shown = {line.split()[0] for line in help_of(listing).splitlines() if line.startswith("  ")}
    assert set(commands) <= shown
    app = build_app()
    for name in commands:
        assert app[name].help == app[listing][name].help
    done = subprocess.run(
        [sys.executable, "-m", "tuberline", listing], capture_output=True, text=True, check=False, env=_env()
    )
    assert done.returncode == 0
    assert next(iter(commands)) in done.stdout


@pytest.mark.parametrize("words", ALL, ids=" ".join)
def test_help_shows_every_word_and_no_empty_option(words: tuple[str, ...]) -> None:
    text = help_of(*words, width=200)
    for nonsense in ("--no-no-", "--empty-", "[default: False]", "[default: None]", "[default: ()]"):
        assert nonsense not in text, nonsense
    assert f"Usage: tuberline {' '.join(words)}" in text


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("calibrate", "bucket", "run", "--kg", "8,61"), ('"8,61" is no number; write it like 8.61.', "bucket --help")),
        (
            ("replay", "rec", "--out", "x", "--regressors", "many"),
            ('"many" is no whole number; write it like 12.', "--help"),
        ),
        (("raplay",), ('Did you mean "replay"?', "What is allowed: tuberline --help")),
        (("score", "run", "truth.json"), ("tuberline score needs --truth. 'truth.json' was not expected.", "--help")),
        (("score", "run", "--truht", "truth.json"), ("Did you mean --truth instead of --truht?",)),
        (("score", "run", "--truth"), ("--truth requires an argument",)),
        (("info",), ("tuberline info needs RECORDING.", "What is allowed: tuberline info --help")),
        (("info", "rec", "--json", "3"), ("tuberline info: '3' was not expected.",)),
    ],
)
def test_a_mistake_is_told_with_the_right_words(words: tuple[str, ...], told: tuple[str, ...]) -> None:
    """'Unable to convert "8,61" into float' was said of a decimal comma."""
    done = tuberline(*words)
    assert done.returncode == 2
    for part in told:
        assert part in " ".join(done.stderr.replace("│", " ").split()), done.stderr


def test_angle_and_square_brackets_are_shown() -> None:
    assert "<name>.recovered.mcap" in help_of("recover")
    assert "tuberline-<line>-<time>.tar.gz" in help_of("bundle", width=200)
    commands = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    assert "default: &lt;name>.recovered.mcap" in commands


@pytest.mark.parametrize("words", WATCHES)
def test_commands_that_look_at_a_line_take_the_same_address(words: str) -> None:
    text = help_of(*words.split(), width=200)
    for option in ("--config", "--connect", "--line"):
        assert option in text, option


@pytest.mark.parametrize("words", [words for words in TAKES_A_CONFIG if words != "topics"])
def test_a_lines_file_is_given_by_config_everywhere(words: str) -> None:
    assert "--config" in help_of(*words.split(), width=200)


def test_the_first_word_may_be_the_lines_file_where_it_always_was(tmp_path: Path) -> None:
    line = tmp_path / "line.toml"
    line.write_text('name = "north"\n', encoding="utf-8")
    for words in (("config", "check"), ("config", "show"), ("access",)):
        by_place, by_name = tuberline(*words, line), tuberline(*words, "--config", line)
        assert by_place.returncode == by_name.returncode == 0, by_place.stderr
        assert by_place.stdout == by_name.stdout


def test_a_commands_page_says_what_it_does_without_its_neighbours() -> None:
    """Its line in the list is short and leans on the one above: 'The same, live.'"""
    assert "The same, live." in help_of()
    words = subprocess.run(
        [sys.executable, "-m", "tuberline", "top", "--help"], capture_output=True, text=True, check=True, env=_env()
    ).stdout
    assert "Watch totals and nodes of a running line" in words


def test_one_command_is_named_export(tmp_path: Path) -> None:
    assert "export" not in {line.split()[0] for line in help_of("ledger").splitlines() if line.startswith("  ")}
    assert "ONNX" in help_of("export-onnx")
    assert "JSON lines" in help_of("ledger", "dump")
    assert "Now dump." in help_of("ledger", "export"), "its former name works"
    assert "GeoParquet" in help_of("export") or "ISOXML" in help_of("export")
    with pytest.raises(InputError, match=r"must end in \.onnx"):
        here("export-onnx", "--out", tmp_path / "net.txt")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("ticket", "--kg", "-4"), 'Invalid value "-4.0" for --kg. Allowed is 0.001 to 200000 kg.'),
        (("start", "trailer\n7"), "such an order cannot be given: fields.name: "),
        (("end", "--request", "no id!"), "such an order cannot be given: request: "),
    ],
)
def test_an_order_that_no_line_takes_is_the_askers_mistake(words: tuple[str, ...], told: str, free_port: int) -> None:
    """'not sent: LoadOrder.kg: ...; 1 faults' was said, with the exit code of a fault of the program."""
    done = tuberline("load", *words, "--connect", f"tcp/127.0.0.1:{free_port}")
    assert done.returncode == 2
    assert told in " ".join(done.stderr.replace("│", " ").split()), done.stderr


def test_health_says_as_json_why_not(free_port: int) -> None:
    done = tuberline("health", "--connect", f"tcp/127.0.0.1:{free_port}", "--timeout-s", "0.5", "--json")
    assert done.returncode == 75
    report = json.loads(done.stdout)
    assert (report["well"], report["router"]) == (False, f"tcp/127.0.0.1:{free_port}")
    assert report["why"]


COMPLETED = {
    "zsh": ("source {}; print ${{_comps[tuberline]}}", "_cyclopts_tuberline"),
    "fish": ("source {}; complete -C 'tuberline simul'", "simulate-views"),
}
"""What a shell is asked once it has read its script, as the help says, and its answer."""


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_knows_commands_and_options(shell: str, tmp_path: Path) -> None:
    script = tuberline("completion", shell).stdout
    for word in ("replay", "simulate-views", "ledger", "--json"):
        assert word.removeprefix("--") in script, word
    path = tmp_path / f"completion.{shell}"
    path.write_text(script, encoding="utf-8")
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"{shell} is not installed: its script was made and not run")
    done = subprocess.run([program, "-n", str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    if (ask := COMPLETED.get(shell)) is not None:
        words = [program, "-c", ask[0].format(path)] if shell == "fish" else [program, "-f", "-c", ask[0].format(path)]
        done = subprocess.run(
            words, capture_output=True, text=True, check=False, env={**os.environ, "HOME": str(tmp_path)}
        )
        assert ask[1] in done.stdout, done.stdout + done.stderr


def test_bash_completes_what_is_begun(tmp_path: Path) -> None:
    if shutil.which("bash") is None:
        pytest.skip("bash is not installed")
    (tmp_path / "script").write_text(tuberline("completion", "bash").stdout, encoding="utf-8")
    ask = (
        f"source {tmp_path}/script; COMP_WORDS=(tuberline {{}}); COMP_CWORD={{}}; COMP_LINE='tuberline {{}}'; "
        "COMP_POINT=${{#COMP_LINE}}; f=$(complete -p tuberline | sed 's/.*-F \\([^ ]*\\).*/\\1/'); $f; "
        'printf "%s\\n" "${{COMPREPLY[@]}}"'
    )
    for words, expected in ((("simul",), {"simulate", "simulate-views"}), (("simulate", "--see"), {"--seed"})):
        line = " ".join(words)
        done = subprocess.run(
            ["bash", "-c", ask.format(line, len(words), line)], capture_output=True, text=True, check=False
        )
        assert expected <= {word.strip() for word in done.stdout.split("\n")}, done.stdout + done.stderr


def test_a_log_gets_no_bars(tmp_path: Path) -> None:
    small = ("--tubers", "1", "--fps", "5", "--camera", "d405-848")
    done = tuberline("simulate", "--out", tmp_path / "belt", *small, "--json")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert json.loads(done.stdout)["tubers"] == 1


def tuberline(*words: object) -> subprocess.CompletedProcess[str]:
    """A command line as a user types it."""
    return subprocess.run(
        [sys.executable, "-m", "tuberline", *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        env=_env(),
        timeout=120,
    )


def _env() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "COLUMNS": "80"}


@pytest.mark.parametrize(("module", "code"), [("cyclopts", -signal.SIGINT), ("aggregator.ledger.totals_by", 130)])
def test_ctrl_c_while_modules_are_loaded_says_nothing(module: str, code: int) -> None:
    """In the first third of a second it was a traceback of Python's imports."""
    pressed = (
        "import os, signal, sys\n"
        "class Loading:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == {module!r}:\n"
        "            os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Loading())\n"
        "sys.argv = ['tuberline', 'ledger', 'totals', 'nowhere']\n"
        "from tuberline.cli import main\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", pressed], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (code, "", "")
