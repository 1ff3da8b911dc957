"""A file in which nothing is whole is no recording, and is not made one."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from conveyor.errors import InputError
from conveyor.formats.conversion import convert_recording
from conveyor.formats.inspection import inspect_recording
from conveyor.formats.mcap.recovery import recover
from tuberline.cli.recordings import recover as recover_command

MAGIC = b"\x89MCAP0\r\n"


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "is no MCAP file: it is empty"),
        (b"random bytes", "is no MCAP file: it does not begin with MCAP's magic bytes"),
        (MAGIC, "of 8 bytes that is cut within its first record"),
        (MAGIC + b"\x01", "of 9 bytes that is cut within its first record"),
        (MAGIC + struct.pack("<BQ", 1, 100) + b"tuberline", "of 26 bytes that is cut within its first record"),
        (MAGIC + struct.pack("<BQ", 1, 1 << 63), "of 17 bytes that is cut within its first record"),
    ],
)
def test_recover_is_advised_for_what_it_can_save(tmp_path: Path, content: bytes, text: str) -> None:
    """Cut within its first record it was said to be an invalid argument, and recovery told it was no MCAP file."""
    (tmp_path / "r.mcap").write_bytes(content)
    with pytest.raises(InputError, match=text) as told:
        inspect_recording(tmp_path / "r.mcap")
    assert "tuberline recover" not in str(told.value)
    with pytest.raises(InputError, match=text):
        recover(tmp_path / "r.mcap", tmp_path / "saved.mcap")
    assert [path.name for path in tmp_path.iterdir()] == ["r.mcap"]


@pytest.mark.parametrize("kept", [400, 100_000])
def test_of_a_file_without_a_whole_message_nothing_is_made(small_recording: Path, tmp_path: Path, kept: int) -> None:
    """It was a recording of 0 messages, with exit code 0."""
    convert_recording(small_recording, tmp_path / "whole.mcap")
    cut = tmp_path / "cut.mcap"
    cut.write_bytes((tmp_path / "whole.mcap").read_bytes()[:kept])
    with pytest.raises(InputError, match=r"tuberline recover"):
        inspect_recording(cut)
    with pytest.raises(
        InputError, match=r"cut\.mcap holds no whole message: \d+ bytes could not be read \(\w+"
    ) as told:
        recover(cut, tmp_path / "saved.mcap")
    assert "partial" not in str(told.value)
    assert not (tmp_path / "saved.mcap").exists()


def test_a_first_record_that_is_damaged_is_said_to_be(tmp_path: Path) -> None:
    (tmp_path / "r.mcap").write_bytes(MAGIC + struct.pack("<BQ", 1, 8) + struct.pack("<II", 1 << 30, 0) + b"rest")
    with pytest.raises(InputError, match=r"r\.mcap: its first record is damaged \(.+\), and there is nothing to save"):
        recover(tmp_path / "r.mcap", tmp_path / "saved.mcap")
    assert not (tmp_path / "saved.mcap").exists()


def test_a_whole_file_is_said_to_need_no_repair(
    small_recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It said that nothing was lost, and left a second recording beside the first that no one needed."""
    convert_recording(small_recording, tmp_path / "r.mcap")
    recover_command(tmp_path / "r.mcap")
    said = capsys.readouterr().out.splitlines()
    whole, copy = tmp_path / "r.mcap", tmp_path / "r.recovered.mcap"
    assert said[-1] == f"{whole} was whole and needed no repair: {copy} holds the same, and may be deleted"
