"""What every message has in common: every field and array checked against what its class declares, in and out.

A class declares its fields' ranges in its annotations (`conveyor.ranges`) and its arrays' in `ARRAYS`. What comes from
the wire is within all of them, or was refused; what is not within them is not sent.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from typing import Any, ClassVar, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, TypeAdapter, ValidationError

from conveyor.errors import MessageError, Refusal, TuberlineError, UnsendableError
from conveyor.refused import in_words
from conveyor.wire import DTYPES, Announced, pack, read_array, read_header, shown

_OUT_OF_RANGE = (
    "greater_than_equal",
    "less_than_equal",
    "too_long",
    "string_too_long",
    "string_pattern_mismatch",
    "finite_number",
    "literal_error",
)
"""Pydantic's names for values of the right type that a field may not hold."""


@dataclass(frozen=True, slots=True)
class ArraySpec:
    """What an array field must be.

    Attributes:
        dtype: its name on the wire.
        sides: lowest and highest size of each dimension.
        optional: it may be None.
        low, high: what its values lie within, where it holds floats; they are finite in any case.
        unit: of its values.
    """

    dtype: str
    sides: tuple[tuple[int, int], ...]
    optional: bool = False
    low: float = -math.inf
    high: float = math.inf
    unit: str = ""

    def fault(self, dtype: str, shape: tuple[int, ...]) -> str:
        """What is wrong with a dtype and a shape, in words; empty where they are allowed."""
        fits = len(shape) == len(self.sides) and all(
            low <= n <= high for n, (low, high) in zip(shape, self.sides, strict=True)
        )
        if dtype == self.dtype and fits:
            return ""
        allowed = ", ".join(str(low) if low == high else f"{low}..{high}" for low, high in self.sides)
        return f"must be {self.dtype} with {len(self.sides)} dimensions of ({allowed}), got {dtype} {shape}"

    def value_fault(self, array: NDArray[Any]) -> str:
        """What is wrong with its values, in words; empty where they are allowed."""
        if self.dtype[0] != "f" or not array.size:
            return ""
        low, high = float(array.min()), float(array.max())  # NaN where one is among them
        if self.low <= low and high <= self.high and math.isfinite(low) and math.isfinite(high):
            return ""
        return f"holds values from {low} to {high}; allowed are {self.low:g} to {self.high:g} {self.unit}".rstrip()


@dataclass(frozen=True, slots=True)
class Message:
    """Base of all messages. Subclasses are frozen, slotted dataclasses; their name is the kind on the wire."""

    ARRAYS: ClassVar[dict[str, ArraySpec]] = {}
    LATER_FIELDS: ClassVar[Literal["forbid", "ignore"]] = "forbid"
    """What a reader does with fields that it does not know. Reports, which nothing is counted from, are read without
    them: so a page or a viewer goes on where the line's other hosts already run a later version."""
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(
        extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True
    )

    def encode(self, *, codec: str = "raw") -> bytes:
        """This message as bytes; arrays stored 'raw' or 'zstd'.

        Raises:
            UnsendableError: it holds what its class does not allow.
        """
        header, arrays = self._parts()
        self._check(header, arrays)
        return pack(type(self).__name__, header, arrays, codec=codec)

    def check(self) -> None:
        """For values that come of what was measured: find out before sending.

        Raises:
            UnsendableError: this message holds what its class does not allow, so it cannot be sent.
        """
        self._check(*self._parts())

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """The message in `data`; every value within what this class declares.

        Raises:
            MessageError: other kind, missing or unknown field (but see `LATER_FIELDS`), wrong type, out of range,
                wrong array.
        """
        header = read_header(data)
        if header.kind != cls.__name__:
            raise MessageError(
                f"expected a message of kind '{cls.__name__}', got {shown(header.kind)}", reason=Refusal.KIND
            )
        announced = {array.name: array for array in header.arrays}
        _check_arrays(cls, {name: (array.dtype, array.shape) for name, array in announced.items()})
        return _checked(cls, header.fields, _read_arrays(cls, data, announced), extra=cls.LATER_FIELDS)

    def _parts(self) -> tuple[dict[str, Any], dict[str, NDArray[Any] | None]]:
        header = {}
        for name, optional in _header_fields(type(self)):
            value = getattr(self, name)
            # What may be left out and is not known is left out, so that a version without that field can read the rest.
            if not (value is None and optional):
                header[name] = plain(value)
        return header, {name: _as_spec(getattr(self, name), spec) for name, spec in self.ARRAYS.items()}

    def _check(self, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any] | None]) -> None:
        try:
            there = {name: array for name, array in arrays.items() if array is not None}
            _check_arrays(type(self), {name: (array.dtype.str[1:], array.shape) for name, array in there.items()})
            _check_array_values(type(self), there)
            _checked(type(self), header, arrays)
        except MessageError as error:
            raise UnsendableError(f"not sent: {error}", reason=error.reason) from error


_HEADER_FIELDS: dict[type[Message], tuple[tuple[str, bool], ...]] = {}


def _header_fields(cls: type[Message]) -> tuple[tuple[str, bool], ...]:
    """Its fields that are no arrays, and which of them may be left out; looked up once."""
    if cls not in _HEADER_FIELDS:
        named = ((field.name, field.default is None) for field in fields(cls))
        _HEADER_FIELDS[cls] = tuple((name, optional) for name, optional in named if name not in cls.ARRAYS)
    return _HEADER_FIELDS[cls]


T = TypeVar("T")


def _check_arrays(cls: type[Message], announced: Mapping[str, tuple[str, tuple[int, ...]]]) -> None:
    for name in announced:
        if name not in cls.ARRAYS:
            raise MessageError(
                f"{cls.__name__} has an unknown array {shown(name)}; known: {sorted(cls.ARRAYS)}", reason=Refusal.ARRAY
            )
    for name, spec in cls.ARRAYS.items():
        if name in announced:
            if fault := spec.fault(*announced[name]):
                raise MessageError(f"{cls.__name__}.{name} {fault}", reason=Refusal.ARRAY)
        elif not spec.optional:
            raise MessageError(f"{cls.__name__} lacks its array '{name}'", reason=Refusal.ARRAY)


def _check_array_values(cls: type[Message], arrays: Mapping[str, NDArray[Any]]) -> None:
    for name, array in arrays.items():
        if fault := cls.ARRAYS[name].value_fault(array):
            raise MessageError(f"{cls.__name__}.{name} {fault}", reason=Refusal.RANGE)


def _read_arrays(cls: type[Message], data: bytes, announced: Mapping[str, Announced]) -> dict[str, NDArray[Any] | None]:
    arrays = {name: read_array(data, array) for name, array in announced.items()}
    _check_array_values(cls, arrays)
    return {name: arrays.get(name) for name in cls.ARRAYS}


def _checked(
    cls: type[T],
    header: Mapping[str, Any],
    arrays: Mapping[str, Any],
    *,
    extra: Literal["forbid", "ignore"] = "forbid",
) -> T:
    """The message of these fields and arrays, each field within its range."""
    try:
        message: T = _adapter(cls).validate_python({**header, **arrays}, extra=extra)
    except ValidationError as error:
        first, *others = error.errors(include_url=False)
        more = f"; {len(others)} more like it" if others else ""
        where = shown(".".join(str(part)[:60] for part in first["loc"])).strip("'\"")
        raise MessageError(
            f"{cls.__name__}.{where}: {in_words(first)} (got {shown(first.get('input'))}{more})",
            reason=Refusal.RANGE if first["type"] in _OUT_OF_RANGE else Refusal.FIELD,
        ) from error
    except MessageError:
        raise
    except TuberlineError as error:
        raise MessageError(f"{cls.__name__}: {error}", reason=Refusal.RANGE) from error
    return message


def check_part(value: Any) -> None:
    """For a part of a message that comes of what was measured, a `Track` say: find out before it is sent.

    Raises:
        UnsendableError: `value` holds what its class does not allow.
    """
    try:
        _checked(type(value), plain(value), {})
    except MessageError as error:
        raise UnsendableError(f"not sent: {error}", reason=error.reason) from error


_ADAPTERS: dict[type[Any], TypeAdapter[Any]] = {}


def _adapter(cls: type[Any]) -> TypeAdapter[Any]:
    """The validator of a message class; building one costs milliseconds, so each is built once."""
    if cls not in _ADAPTERS:
        _ADAPTERS[cls] = TypeAdapter(cls)
    return _ADAPTERS[cls]


_PLAIN = frozenset((str, int, float, bool, type(None)))


_FIELD_NAMES: dict[type[Any], tuple[str, ...] | None] = {}


def _field_names(kind: type[Any]) -> tuple[str, ...] | None:
    """Of a dataclass; None for another class. Looked up once."""
    if kind not in _FIELD_NAMES:
        _FIELD_NAMES[kind] = tuple(field.name for field in fields(kind)) if is_dataclass(kind) else None
    return _FIELD_NAMES[kind]


def plain(value: Any) -> Any:
    """Dataclasses, tuples and numpy scalars as maps, lists and numbers."""
    kind = type(value)
    if kind in _PLAIN:
        return value
    if (names := _field_names(kind)) is not None:
        return {name: plain(getattr(value, name)) for name in names}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.generic):
        return value.item()
    return value


def _as_spec(value: Any, spec: ArraySpec) -> NDArray[Any] | None:
    """The array as it goes on the wire."""
    if value is None:
        return None
    array: NDArray[Any] = np.ascontiguousarray(value, dtype=np.dtype(DTYPES[spec.dtype]).newbyteorder("<"))
    return array
