"""Reading TASKDATA of other terminals: a zip or a folder, file names in any case, files that refer to others."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path
from types import TracebackType
from typing import Self
from xml.etree import ElementTree

from conveyor.errors import InputError
from tuberline.export.isoxml.time_log import LogRecord, unpack_records

MOST_BYTES = 256 << 20
"""Of one file unpacked: a zip of some kilobytes may claim any size."""
MOST_EXTERNAL = 1000
_DAMAGED = (OSError, EOFError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error)
"""What the zip library raises of a file that is none, is damaged, or is packed in a way it does not know."""


class Archive:
    """One TASKDATA. Use as a context manager."""

    def __init__(self, path: Path | str) -> None:
        self._path = Path(path)
        self._zip: zipfile.ZipFile | None = None
        self._files: dict[str, str] = {}

    def __enter__(self) -> Self:
        if self._path.is_dir():
            names = [str(file.relative_to(self._path)) for file in self._path.rglob("*") if file.is_file()]
        else:
            try:
                self._zip = zipfile.ZipFile(self._path)
            except _DAMAGED as error:
                raise InputError(f"{self._path} is neither a TASKDATA folder nor a zip of one: {error}") from error
            names = [name for name in self._zip.namelist() if not name.endswith("/")]
        top = [name for name in names if Path(name).name.upper() == "TASKDATA.XML"]
        if len(top) != 1:
            raise InputError(f"{self._path} holds {len(top)} files TASKDATA.XML; ISOXML has one")
        folder = Path(top[0]).parent
        self._files = {Path(name).name.upper(): name for name in names if Path(name).parent == folder}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._zip is not None:
            self._zip.close()

    def time_logs(self) -> list[str]:
        """Names of all time logs, in the order of their tasks.

        Raises:
            InputError: a file that is referred to is not there, or XML that cannot be read.
        """
        roots = [self._xml("TASKDATA.XML")]
        external = [f"{xfr.get('A', '')}.XML" for xfr in roots[0].findall("XFR")][:MOST_EXTERNAL]
        roots += [self._xml(name) for name in external]
        return [tlg.get("A", "") for root in roots for tlg in root.iter("TLG")]

    def records(self, name: str) -> list[LogRecord]:
        """The records of one time log.

        Raises:
            InputError: its files are missing or damaged.
        """
        return unpack_records(
            self._read(f"{name}.XML"), self._read(f"{name}.BIN"), where=f"{self._path}, time log {name}"
        )

    def _xml(self, name: str) -> ElementTree.Element:
        try:
            return ElementTree.fromstring(self._read(name))
        except ElementTree.ParseError as error:
            raise InputError(f"{self._path}, {name} is no XML: {error}") from error

    def _read(self, name: str) -> bytes:
        known = self._files.get(name.upper())
        if known is None:
            raise InputError(f"{self._path} refers to {name}, which it does not hold")
        try:
            if self._zip is None:
                file = self._path / known
                if file.stat().st_size > MOST_BYTES:
                    raise InputError(f"{file} has more than {MOST_BYTES >> 20} MiB")
                return file.read_bytes()
            with self._zip.open(known) as stream:
                data = stream.read(MOST_BYTES + 1)
        except _DAMAGED as error:
            raise InputError(f"{self._path}, {name} cannot be read: {_said(error)}") from error
        if len(data) > MOST_BYTES:
            raise InputError(f"{self._path}, {name} has more than {MOST_BYTES >> 20} MiB unpacked")
        return data


def _said(error: Exception) -> str:
    return str(error) or "it is cut short"  # an EOFError says nothing


def read_time_logs(path: Path | str) -> dict[str, list[LogRecord]]:
    """All time logs of a TASKDATA zip or folder, of any terminal, by their names.

    Raises:
        InputError: no TASKDATA.XML, XML that cannot be read, or a log whose file is missing or damaged.
    """
    with Archive(path) as archive:
        return {name: archive.records(name) for name in archive.time_logs()}
