"""What a training is refused for before it prepares a view, and how it keeps its folder to itself.

Views take minutes to prepare, hours where there are many: what can be told without them is told first.
"""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from conveyor.errors import InputError, OutputError
from conveyor.files import check_folder
from conveyor.formats.packs.views import count_views
from conveyor.formats.potatotwin.layout import SPLITS, is_potatotwin
from regressor.network.checkpoint import read_checkpoint
from regressor.network.networks import new_network
from regressor.training.labelled import count_labelled, labelled_files, part_of
from regressor.training.loop import load_state
from regressor.training.recipe import TrainSettings
from regressor.training.train import check_batch, check_settings, check_start_weights

CACHE = "cache"
"""Folder of prepared clouds in that of a training."""


@contextmanager
def gone_where_refused(folder: Path) -> Iterator[None]:
    """A folder that work makes goes again where nothing came of it, with views prepared for work that is refused."""
    fresh = not folder.exists()
    try:
        yield
    except BaseException as error:
        if fresh:
            if isinstance(error, InputError):
                shutil.rmtree(folder / CACHE, ignore_errors=True)
            with suppress(OSError):  # something lies in it, or it was not made
                folder.rmdir()
        raise


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """`folder`, made where it is not there, with no other training in it: two would mix states, weights and logs.

    Where a file system knows no locks of folders nothing keeps the other out.

    Raises:
        InputError: it cannot be made or written. OutputError: its disk is full, or another process trains in it.
    """
    with gone_where_refused(folder):
        check_folder(folder, option="--out")
        lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            with suppress(OSError):
                _take(lock, folder)
            yield
        finally:
            os.close(lock)


def _take(lock: int, folder: Path) -> None:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise OutputError(
            f"another process trains in {folder}: wait until it has ended or stop it, or give another --out"
        ) from error


def parts_of(data: Path, validation: Path) -> tuple[str | None, str | None]:
    """The parts of splits.csv that a training reads: of `data`, and of `validation`; None is all of it.

    Raises:
        InputError: both are the same folder, and it has no parts.
    """
    parts = part_of(data, "train"), part_of(validation, "val")
    if parts[0] is None and data.resolve() == validation.resolve() and data.is_dir():
        fix = (
            f"`tuberline split {data}` shares its tubers out"
            if is_potatotwin(data)
            else "only a 3DPotatoTwin folder has parts, so give a pack of its own for each part"
        )
        raise InputError(
            f"--data and --val are both {data}, which has no {SPLITS}: a network is judged by tubers that it has not "
            f"learned from; {fix}"
        )
    return parts


def check_views(data: Path, validation: Path, settings: TrainSettings) -> None:
    """Refuse folders without views, and fewer training views than one batch.

    Raises:
        InputError: says which.
    """
    part, validation_part = parts_of(data, validation)
    labelled_files(validation, split=validation_part)
    shards = [path for path in labelled_files(data, split=part) if path.suffix == ".npz"]
    if all(map(count_views, shards)):  # what is wrong with one that cannot be read its reader says
        check_batch(count_labelled(data, split=part), settings.batch)


def check_out(state: Path, weights: Path, *, resume: bool) -> None:
    """Refuse a folder in which there is no training to go on with, or where one begins weights or a training.

    Raises:
        InputError: with how to go on.
    """
    out = state.parent
    if resume and not state.is_file():
        raise InputError(f"{out} holds no training to go on with (no {state.name}): leave --resume out to begin one")
    if not resume and state.is_file():
        raise InputError(f"{out} already holds a training: go on with --resume or give another --out")
    if not resume and weights.is_file():
        raise InputError(
            f"{out} already holds {weights.name}, which a new training would overwrite: give another --out, or move "
            f"{weights.name} and {weights.with_suffix('.json').name} away"
        )


def begun_state(path: Path, settings: TrainSettings, start: dict[str, Tensor] | None) -> dict[str, Any]:
    """The state to go on with.

    Raises:
        InputError: unreadable, or of a training with other settings or begun from other weights than `start`.
    """
    state = load_state(path)
    check_settings(state, settings)
    _same_start(state, start)
    return state


def _same_start(begun: dict[str, Any], now: dict[str, Tensor] | None) -> None:
    """Refuse to go on from other weights than a training was begun with: they would stand in its sidecar's command.

    Both are of one network: its settings are compared before.

    Raises:
        InputError: the state was begun with others, with none, or with some where none are given.
    """
    before = begun.get("start")
    if "start" not in begun or (before is None and now is None):
        return
    if before is None or now is None or not all(torch.equal(before[name], now[name].cpu()) for name in before):
        with_what = "without weights to start from" if before is None else "from other weights"
        raise InputError(
            f"this training was begun {with_what}. A training goes on as it was begun: give the --start of its first "
            "call with --resume, or begin another one with another --out"
        )


def start_weights(path: Path | None, settings: TrainSettings) -> dict[str, Tensor] | None:
    """The weights that a training begins with; None for random ones.

    Raises:
        InputError: not there, unreadable, or of another network than `settings` trains.
    """
    if path is None:
        return None
    if not path.is_file():
        why = "is a folder: give the .safetensors file in it" if path.is_dir() else "is not there"
        raise InputError(f"--start {path} {why}")
    weights = read_checkpoint(path)[0]
    with torch.random.fork_rng(devices=[]):
        model = new_network(settings.network, height_embedding=settings.height_embedding, dropout=settings.dropout)
    check_start_weights(weights, model, where=str(path), network=settings.network)
    return weights
