"""Time logs of ISOXML by the name of their file, as docs/exports.md calls the reader."""

from __future__ import annotations

import contextlib
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest

from conveyor.errors import InputError
from tuberline.export.isoxml.archive import read_time_logs
from tuberline.export.isoxml.time_log import LoggedValue, LogRecord, header_xml, pack_records

TASK = '<ISO11783_TaskData VersionMajor="4"><TSK A="TSK1"><TLG A="TLG00001"/></TSK></ISO11783_TaskData>'


def test_a_path_may_be_text(tmp_path: Path) -> None:
    """It was an AttributeError: 'str' object has no attribute 'is_dir'."""
    column = LoggedValue(84, "DET-1")
    record = LogRecord(datetime(2026, 9, 14, 12, tzinfo=UTC), 52.7, 5.75, {column: 45_000_00})
    files = {
        "TASKDATA.XML": TASK.encode(),
        "TLG00001.XML": header_xml([column]),
        "TLG00001.BIN": pack_records([record], [column]),
    }
    folder, packed = tmp_path / "TASKDATA", tmp_path / "out.isoxml"
    folder.mkdir()
    with zipfile.ZipFile(packed, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
            (folder / name).write_bytes(data)
    for path in (folder, packed):
        assert read_time_logs(str(path)) == read_time_logs(path) == {"TLG00001": [record]}
    with pytest.raises(InputError, match="neither a TASKDATA folder nor a zip"):
        read_time_logs(str(tmp_path / "none.isoxml"))


def test_a_damaged_zip_is_one_error(shared: Path, tmp_path: Path) -> None:
    """A quarter of them ended in zlib's own error."""
    whole = (shared / "data" / "isoxml_examples" / "2021-04-09T15_33_26_taskdata.zip").read_bytes()
    rng, broken = np.random.default_rng(73031), tmp_path / "broken.zip"
    for _ in range(40):
        data = bytearray(whole)
        data[int(rng.integers(len(data)))] ^= int(rng.integers(1, 256))
        broken.write_bytes(data)
        with contextlib.suppress(InputError):
            read_time_logs(broken)
