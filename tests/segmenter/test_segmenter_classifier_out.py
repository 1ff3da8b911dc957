"""Where `train-classifier` and `make-patches` write: told before minutes of work, and over nothing that is there."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from conveyor.errors import InputError
from regressor.network.pointraft import PointRaft
from segmenter.training.run import earlier
from tuberline.cli.train_classifier import make_patches, train_classifier


def _train(out: Path, **more: object) -> None:
    """With belts that are not there: what is refused before is refused first."""
    train_classifier(data=[out / "no belts"], val=out / "no belts", out=out, **more)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["../x", "a/b", "/tmp/x", "..", ""])
def test_a_name_is_no_way_to_another_folder(tmp_path: Path, name: str) -> None:
    """`--name ../x` wrote beside the folder that --out names, over whatever was there."""
    with pytest.raises(InputError, match=r"--name is .*; allowed is the name of a file without its folder"):
        _train(tmp_path / "out", name=name)
    assert not list(tmp_path.iterdir())


def test_a_network_that_is_there_is_not_overwritten(tmp_path: Path) -> None:
    """A second call with the same options took the first one's network away without a word."""
    network = tmp_path / "tuberline-classifier.onnx"
    network.write_bytes(b"hours of work")
    with pytest.raises(InputError, match=r"tuberline-classifier.onnx is there already: choose another --out or --name"):
        _train(tmp_path)
    assert network.read_bytes() == b"hours of work"
    with pytest.raises(InputError, match="no belts"):
        _train(tmp_path, name="other")
    with pytest.raises(InputError, match=r"tuberline-classifier.pt is no training to go on from: No such file"):
        _train(tmp_path, start=tmp_path / "tuberline-classifier.pt")  # which goes on with the one that is there


@pytest.mark.parametrize("command", [_train, lambda out: make_patches(data=[out / "no belts"], out=out)])
def test_a_file_in_the_place_of_the_folder_is_told_first(tmp_path: Path, command: object) -> None:
    """It was told after the training, with exit code 1."""
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(InputError, match=r"--out .*file cannot be made: .*a file lies where a folder is needed"):
        command(tmp_path / "file")  # type: ignore[operator]


def test_what_is_wrong_with_a_start_is_said_in_words(tmp_path: Path) -> None:
    """Pages of torch's names of tensors, or the number 105."""
    torch.save(PointRaft().state_dict(), tmp_path / "other.pt")
    (tmp_path / "text.pt").write_text("no network")
    for name in ("other.pt", "text.pt"):
        with pytest.raises(InputError) as refusal:
            earlier(tmp_path / name)
        words = f"{tmp_path / name} is no training to go on from: it holds something else; give the .pt that "
        assert str(refusal.value).startswith(words)
