"""What all sections of a line's file have in common."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo, field_validator
from pydantic_core import PydanticKnownError

from conveyor.endpoints import host_and_port
from conveyor.errors import TuberlineError
from conveyor.stated import BELT_SD_MM, RESTING_OFFSET_MM, RESTING_SD_MM, level_fault
from conveyor.topics import check_name

Metres = Annotated[float, Field(gt=0, le=10)]
BeltSd = Annotated[float, Field(ge=BELT_SD_MM[0], le=BELT_SD_MM[1])]


def _level(stated_mm: float) -> float:
    if fault := level_fault(stated_mm):
        raise ValueError(fault)
    return stated_mm


RestingOffset = Annotated[float, Field(ge=RESTING_OFFSET_MM[0], le=RESTING_OFFSET_MM[1]), AfterValidator(_level)]
RestingSd = Annotated[float, Field(ge=RESTING_SD_MM[0], le=RESTING_SD_MM[1]), AfterValidator(_level)]


_NUMBERS: set[type] = {int, float}


def _kinds(annotation: object) -> set[type]:
    """What the values of a field are, those in its lists too."""
    if isinstance(annotation, type) and not get_args(annotation):
        return {annotation}
    return {kind for part in get_args(annotation) for kind in _kinds(part)}


def _items(value: object) -> Iterator[object]:
    """The value, or what lists hold in its place."""
    if isinstance(value, list | tuple):
        for item in value:
            yield from _items(item)
    else:
        yield value


class Section(BaseModel):
    """Base of all sections: frozen, no unknown keys, every default checked."""

    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _path_that_names_something(cls, value: object, info: ValidationInfo) -> object:
        """Else it would be the folder of the line's file."""
        if value == "" and cls.model_fields[info.field_name or ""].annotation in (Path, Path | None):
            raise ValueError('"" names no file and no folder: give a path, or leave the key out; "." is this folder')
        return value

    @field_validator("*", mode="before")
    @classmethod
    def _of_its_kind(cls, value: object, info: ValidationInfo) -> object:
        """Pydantic would read true as 1, 1 and "yes" as true, and "2" as 2."""
        kinds = _kinds(cls.model_fields[info.field_name or ""].annotation)
        for item in _items(value):
            if isinstance(item, bool) and bool not in kinds:
                raise ValueError("true and false are not allowed here")
            if isinstance(item, str) and kinds & _NUMBERS and str not in kinds:
                raise PydanticKnownError("int_type" if int in kinds else "float_type")
            if not isinstance(item, bool) and bool in kinds and item is not None:
                raise PydanticKnownError("bool_type")
        return value

    @field_validator("*")
    @classmethod
    def _at_home(cls, value: object) -> object:
        """`~` is the home of who runs the line, as in a shell, and no folder of that name."""
        if not isinstance(value, Path):
            return value
        try:
            return value.expanduser()
        except RuntimeError as error:
            raise ValueError(f"no home is known for '{value.parts[0]}': write the whole path") from error


LEAST_BAUD, MOST_BAUD = 300, 4_000_000


def serial_rate(given: str | None, *, usual: int) -> int:
    """The rate of a serial port as its address gives it, baud; `usual` where it does not.

    Raises:
        ValueError: it is no whole number that a port may have.
    """
    rate = usual if given is None else int(given)
    if not LEAST_BAUD <= rate <= MOST_BAUD:
        raise ValueError(rate)
    return rate


WITH_PORT = ("tcp", "tls", "udp", "quic", "ws")
"""Protocols whose addresses are HOST:PORT."""
WITH_PATH = ("unixsock-stream",)
"""Those whose address is a path. Zenoh's library knows no others as it is built for Python."""


def checked_endpoint(text: str) -> str:
    """`text` where it names a protocol and an address, as 'tcp/10.0.0.1:7447'; raises ValueError else."""
    protocol, slash, address = text.partition("/")
    host, port = host_and_port(text)
    if protocol in WITH_PORT and host and port.isdecimal() and 0 < int(port) <= 65535:
        return text
    if protocol in WITH_PATH and address:
        return text
    host = (host.lstrip("/") if slash else text.split(":")[0]) or "HOST"
    known = (*WITH_PORT, *WITH_PATH)
    allowed = f"; protocols are {', '.join(known)}" if slash and protocol not in known else ""
    protocol = protocol if protocol in WITH_PORT else "tcp"
    raise ValueError(f"'{text}' is no router's endpoint: write it like {protocol}/{host}:7447{allowed}")


Endpoint = Annotated[str, AfterValidator(checked_endpoint)]


def checked_name(name: str, what: str) -> str:
    """`name` where it may be part of keys and file names; pydantic tells what is wrong else."""
    try:
        return check_name(name, what=what)
    except TuberlineError as error:
        raise ValueError(str(error)) from error
