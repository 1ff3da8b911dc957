"""What every message has in common: fields checked on decoding, arrays checked by dtype and dimensions."""

from __future__ import annotations

from dataclasses import dataclass, fields, is_dataclass
from typing import Any, ClassVar, Self

import numpy as np
from pydantic import ConfigDict, TypeAdapter, ValidationError

from conveyor.errors import MessageError, TuberlineError
from conveyor.wire import DTYPES, pack, unpack


@dataclass(frozen=True, slots=True)
class ArraySpec:
    """Dtype (wire name) and number of dimensions an array field must have; it may be None if `optional`."""

    dtype: str
    ndim: int
    optional: bool = False


@dataclass(frozen=True, slots=True)
class Message:
    """Base of all messages. Subclasses are frozen, slotted dataclasses; their name is the kind on the wire."""

    ARRAYS: ClassVar[dict[str, ArraySpec]] = {}
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(
        extra="forbid", allow_inf_nan=False, arbitrary_types_allowed=True
    )

    def encode(self, *, codec: str = "raw") -> bytes:
        """This message as bytes; arrays stored 'raw' or 'zstd'."""
        header = {f.name: plain(getattr(self, f.name)) for f in fields(self) if f.name not in self.ARRAYS}
        arrays = {
            name: None if (value := getattr(self, name)) is None else _as_spec(name, value, spec)
            for name, spec in self.ARRAYS.items()
        }
        return pack(type(self).__name__, header, arrays, codec=codec)

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """The message in `data`.

        Raises:
            MessageError: other kind, missing or unknown field, wrong type, wrong array.
        """
        kind, header, arrays = unpack(data)
        if kind != cls.__name__:
            raise MessageError(f"expected a message of kind '{cls.__name__}', got '{kind}'")
        for name in arrays:
            if name not in cls.ARRAYS:
                raise MessageError(f"{kind} has an unknown array '{name}'; known: {sorted(cls.ARRAYS)}")
        checked: dict[str, Any] = {}
        for name, spec in cls.ARRAYS.items():
            array = arrays.get(name)
            if array is None and not spec.optional:
                raise MessageError(f"{kind} lacks its array '{name}'")
            if array is not None and (array.dtype != DTYPES[spec.dtype] or array.ndim != spec.ndim):
                raise MessageError(
                    f"{kind}.{name} must be {spec.dtype} with {spec.ndim} dimensions, got {array.dtype} {array.shape}"
                )
            checked[name] = array
        try:
            message: Self = _adapter(cls).validate_python({**header, **checked})
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            raise MessageError(
                f"{kind}.{where}: {first['msg']} (got {str(first.get('input'))[:80]!r}; {error.error_count()} faults)"
            ) from error
        except MessageError:
            raise
        except TuberlineError as error:
            raise MessageError(f"{kind}: {error}") from error
        return message


_ADAPTERS: dict[type[Any], TypeAdapter[Any]] = {}


def _adapter(cls: type[Any]) -> TypeAdapter[Any]:
    """The validator of a message class; building one costs milliseconds, so each is built once."""
    if cls not in _ADAPTERS:
        _ADAPTERS[cls] = TypeAdapter(cls)
    return _ADAPTERS[cls]


def plain(value: Any) -> Any:
    """Dataclasses, tuples and numpy scalars as maps, lists and numbers."""
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.generic):
        return value.item()
    return value


def _as_spec(name: str, value: Any, spec: ArraySpec) -> Any:
    array = np.ascontiguousarray(value, dtype=np.dtype(DTYPES[spec.dtype]).newbyteorder("<"))
    if array.ndim != spec.ndim:
        raise MessageError(f"array '{name}' must have {spec.ndim} dimensions, got shape {array.shape}")
    return array
