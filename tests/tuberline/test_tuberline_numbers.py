"""Numbers on the command line: none is rounded, made up or taken where it says nothing."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Literal, get_args, get_origin

import pytest
from cyclopts import App, Argument
from cyclopts.exceptions import CycloptsError

from conveyor.errors import ConfigError, InputError
from conveyor.served import ServedAt
from tuberline.cli.commands import build_app
from tuberline.cli.metrics import metrics
from tuberline.cli.page import page

ROOT = Path(__file__).resolve().parents[2]


def commands(app: App, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], list[Argument]]]:
    """Every command, by its words, with its options and places."""
    for name in app:
        if name.startswith("-") or name in ("lab", "parts"):
            continue
        command, words = app[name], (*path, name)
        if command.default_command is not None:
            yield words, [option for option in command.assemble_argument_collection() if not option.children]
        yield from commands(command, words)


def numbers(app: App) -> Iterator[tuple[tuple[str, ...], str, type]]:
    """Every option of every command that is a number: a line that lacks nothing else, the option, float or int."""
    for words, options in commands(app):
        for option in options:
            kind = next((kind for kind in (float, int) if kind in (option.hint, *get_args(option.hint))), None)
            if kind is not None:
                others = [word for other in options if other is not option for word in needed(other)]
                yield (*words, *others), option.name, kind


def needed(option: Argument) -> list[str]:
    """What a command line must say of this option."""
    if not option.required:
        return []
    value = next(iter(get_args(option.hint)), "1") if get_origin(option.hint) is Literal else "1"
    return [str(value)] if option.index is not None else [option.name, str(value)]


NUMBERS = list(numbers(build_app()))
TOLD = {int: "whole number", float: "number"}


def refused(*words: str) -> str:
    """What is said of a command line that is refused."""
    with pytest.raises(CycloptsError) as error:
        build_app().parse_args(words, exit_on_error=False, print_error=False)
    return str(error.value)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("init line.toml --ros-domain 5", "--ros-router"),
        ("calibrate load RUN --load 3 --scale-error-kg 5 --run monday", "--run and --scale-error-kg"),
        ("segment RECORDING --frame 5", "--picture"),
        ("evaluate-segmentation RECORDING --method classical --weights net.onnx", "asks no network"),
    ],
)
def test_an_option_that_would_do_nothing_is_refused(words: str, named: str) -> None:
    with pytest.raises(InputError, match=named):
        build_app()(words.split(), exit_on_error=False, print_error=False)


def test_all_numbers_are_found() -> None:
    named = {f"{words[0]} {name}" for words, name, _ in NUMBERS}
    assert {"simulate --tubers", "weigh --belt-distance-m", "load --limit", "load --wait-s"} <= named
    assert len(NUMBERS) > 100


@pytest.mark.parametrize(("words", "name", "kind"), NUMBERS, ids=[f"{' '.join(w)} {name}" for w, name, _ in NUMBERS])
def test_every_option_that_is_a_number_takes_numbers_alone(words: tuple[str, ...], name: str, kind: type) -> None:
    """`nan` passed every check that asks whether a number is too large."""
    assert refused(*words, f"{name}=nan").startswith(f'Invalid value for {name}: "nan" is no {TOLD[kind]}; write it')


@pytest.mark.parametrize("text", ["1.5", "-0.1", "nan", "1e3", "0x10", "12 kg", ""])
def test_a_whole_number_is_not_rounded(text: str) -> None:
    """`simulate --tubers 1.5` made two of them."""
    told = f'Invalid value for --tubers: "{text}" is no whole number; write it like 12.'
    assert refused("simulate", "--out", "x", f"--tubers={text}") == told


@pytest.mark.parametrize("text", ["inf", "-inf", "1e999", "12 kg", ""])
def test_a_number_is_finite(text: str) -> None:
    told = f'Invalid value for --belt-distance-m: "{text}" is no number; write it like 8.61.'
    assert refused("weigh", "cloud.ply", f"--belt-distance-m={text}") == told


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("status --wait-s -1", 'Invalid value "-1.0" for --wait-s. Allowed is 0 to 3600 s.'),
        ("health --timeout-s -1", 'Invalid value "-1.0" for --timeout-s. Allowed is 0.1 to 3600 s.'),
        ("load show --limit -1", 'Invalid value "-1" for --limit. Allowed is 1 to 100000.'),
        ("segment rec --frame -1", 'Invalid value "-1" for --frame.'),
        ("evaluate-segmentation rec --every 0", 'Invalid value "0" for --every.'),
        ("calibrate belt rec --frames 0", 'Invalid value "0" for --frames.'),
        ("certs make line.toml --days -1", 'Invalid value "-1" for --days. Allowed is 1 to 3650 days.'),
        ("watch tcp/127.0.0.1:1 --hub-port 70000", 'Invalid value "70000" for --hub-port. Allowed is 0 to 65535.'),
        ("export-onnx --out net.onnx --batch 0", 'Invalid value "0" for --batch.'),
        ("split folder --seed -1", 'Invalid value "-1" for --seed.'),
        ("train --data a --val b --out c --threads 0", 'Invalid value "0" for --threads. Allowed is 1 to 64.'),
        ("evaluate --data a --out b --max-views 0", 'Invalid value "0" for --max-views.'),
        ("replay rec --out b --regressors 65", 'Invalid value "65" for --regressors. Allowed is 1 to 64.'),
        ("replay rec --out b --resting-sd-mm 21", 'Invalid value "21.0" for --resting-sd-mm. Allowed is 0 to 20 mm.'),
        ("weigh a --belt-distance-m 0.4 --resting-offset-mm 0.0055", "cannot be known; 0.0055 m are 5.5 mm."),
        ("replay rec --out b --resting-sd-mm 0.0015", "cannot be known; 0.0015 m are 1.5 mm."),
        ("convert a b --belt-distance-m -1", 'Invalid value "-1.0" for --belt-distance-m. Allowed is 0.05 to 5 m.'),
    ],
)
def test_a_number_out_of_range_is_told_with_what_is_allowed(words: str, told: str) -> None:
    assert told in refused(*words.split())


def test_what_is_allowed_is_taken() -> None:
    command, given, _ = build_app().parse_args(["watch", "tcp/127.0.0.1:1", "--hub-port", "0", "--page-port", "65535"])
    assert command.__name__ == "watch"
    assert given.arguments == {"connect": "tcp/127.0.0.1:1", "hub_port": 0, "page_port": 65535}
    _, given, _ = build_app().parse_args(["import-checkpoint", "a.pth", "--out", "b", "--seed", "3.0"])
    assert given.arguments["seed"] == 3


def test_every_option_says_what_it_is() -> None:
    """`ablate --compute` and `--device` shared one entry of the docstring, and had no words in the help."""
    page = (ROOT / "docs" / "commands.md").read_text(encoding="utf-8")
    options = re.findall(r"^\* `([^`]*)`: *(.*)$", page, flags=re.MULTILINE)
    assert len(options) > 400
    assert [name for name, words in options if not re.sub(r"\*+\[[^]]*\]\*+", "", words).strip()] == []


@pytest.mark.parametrize("text", ["9180", "127.0.0.1", "::1:9180", ":9180", "127.0.0.1:70000", "127.0.0.1:²", "a b:1"])
def test_where_to_serve_is_refused_by_each_command_alike(text: str) -> None:
    """Each had bounds of its own: `::1:9180` was a host to two of them, and port 0 free to two others."""
    for command in (page, metrics):
        with pytest.raises(ConfigError, match=rf"--listen {re.escape(text)} is not HOST:PORT, e\.g\. 127\.0\.0\.1:9"):
            command(listen=text)


def test_where_to_serve_is_read_and_told() -> None:
    for text, host, port in (("127.0.0.1:0", "127.0.0.1", 0), ("[::1]:9180", "::1", 9180), ("barn:80", "barn", 80)):
        at = ServedAt.parse(text, option="--listen", example="127.0.0.1:9180")
        assert (at.host, at.port, str(at)) == (host, port, text)
