"""Messages built from what their classes declare: header by header, field by field, at and beyond each limit.

`build` takes every choice by one function, so that hypothesis and a plain random generator drive the same builder; of
the options the first is the plainest one. It says whether it put anything in that must be refused.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import msgpack
import numpy as np
import zstandard

from conveyor import messages as m
from conveyor import wire
from conveyor.errors import MessageError
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages.base import ArraySpec, Message
from conveyor.ranges import Items
from regressor.serve.messages import CloudAnswer, WeightsParcel, WeightsReport, WeightsState
from tests.fuzz.declared import NO_FIELD, fault, form_of, hints_of, names_of, outside

CLASSES: tuple[type[Message], ...] = (
    *(cls for name in m.__all__ if issubclass(cls := getattr(m, name), Message) and cls is not Message),
    CloudAnswer,
    WeightsParcel,
    WeightsReport,
    WeightsState,
)
"""Every message that crosses a process boundary."""
Pick = Callable[[Sequence[Any]], Any]
SMALL_BYTES = 4096
MOST_ERROR_CHARACTERS = 2000


@dataclass(frozen=True, slots=True)
class Built:
    """A message's bytes, and what in them must be refused; empty where only fields may contradict each other."""

    data: bytes
    wrong: str


class _Builder:
    """One message: `faults` says how many more things may be put in that must be refused."""

    def __init__(self, pick: Pick, faults: int) -> None:
        self._pick = pick
        self._left = faults
        self.wrong: list[str] = []

    def value(self, hint: Any, where: str) -> Any:
        """A value for a field of this type; sometimes one that it may not hold."""
        if self._left and self._pick(range(6)) == 5:
            bad = outside(hint)
            if bad:
                self._left -= 1
                self.wrong.append(where)
                return self._pick(bad)
        return self._allowed(hint, where)

    def _allowed(self, hint: Any, where: str) -> Any:
        """A value that the field may hold, though what lies in it may not be."""
        form = form_of(hint)
        if len(form.options) > 1:
            return self._allowed(self._pick(form.options), where)
        if form.is_record:
            return self.record(form.kind, where)
        if form.origin is dict:
            keys, values = form.args
            return {
                self._key(keys, where) if n == 0 else f"k{n}": self.value(values, f"{where}.{n}")
                for n in range(self._items(form.marks, where))
            }
        if form.origin is tuple:
            return [self.value(form.args[0], f"{where}.{n}") for n in range(self._items(form.marks, where))]
        return self._pick(form.inside)

    def record(self, cls: Any, where: str, *, arrays: Sequence[str] = ()) -> dict[str, Any]:
        """The fields of a dataclass."""
        hints = hints_of(cls)
        return {name: self.value(hints[name], f"{where}.{name}") for name in names_of(cls) if name not in arrays}

    def _key(self, hint: Any, where: str) -> str:
        if self._left and self._pick(range(6)) == 5:
            self._left -= 1
            self.wrong.append(f"{where}.key")
            return str(self._pick([v for v in outside(hint) if isinstance(v, str)]))
        return str(self._pick(form_of(hint).inside))

    def _items(self, marks: tuple[Any, ...], where: str) -> int:
        most = next((mark.most for mark in marks if isinstance(mark, Items)), 3)
        if self._pick(range(200)) < 199:
            return int(self._pick((1, 0, 2, 3)))
        if self._left and self._pick(range(2)):
            self._left -= 1
            self.wrong.append(f"{where} has too many")
            return most + 1
        return most

    def descriptor(self, name: str, spec: ArraySpec, shape: tuple[int, ...] | None) -> tuple[dict[str, Any], bytes]:
        """An array's entry in the header and its bytes."""
        if shape is None:
            shape = tuple(
                self._pick([n for n in (low, low + 1, 3, high) if low <= n <= high]) for low, high in spec.sides
            )
        dtype = np.dtype(wire.DTYPES[spec.dtype])
        size = math.prod(shape) * dtype.itemsize
        codec, body = ("raw", bytes(size)) if size <= SMALL_BYTES else ("zstd", _zeros(min(size, 1 << 22)))
        if spec.dtype == "f8":
            body = self._floats(name, spec, size // 8)
        claim = {"name": name, "dtype": spec.dtype, "shape": list(shape), "codec": codec, "size": len(body)}
        if size > 1 << 22:
            self.wrong.append(f"{name} is larger than its bytes")
        if self._left and self._pick(range(3)) == 2:
            self._left -= 1
            self.wrong.append(self._spoil(claim, spec))
        return claim, body

    def _floats(self, name: str, spec: ArraySpec, count: int) -> bytes:
        """A pose, most of the time that of a camera that looks down."""
        values = straight_down_belt_from_camera(0.46).ravel()[:count]
        if self._left and self._pick(range(3)) == 2:
            self._left -= 1
            bad = self._pick((math.nan, math.inf, -math.inf, 1e308, math.nextafter(spec.high, math.inf), spec.low - 1))
            values[self._pick(range(count))] = bad
            self.wrong.append(f"{name} holds {bad}")
        elif self._pick(range(4)) == 3:
            values[self._pick(range(count))] = self._pick((spec.low, spec.high, 5e-324, -0.0))
        return bytes(values.astype("<f8").tobytes())

    def _spoil(self, claim: dict[str, Any], spec: ArraySpec) -> str:
        key = self._pick(tuple(claim))
        if key == "shape" and self._pick(range(4)):
            at = self._pick(range(len(spec.sides)))
            low, high = spec.sides[at]
            beyond = (
                low - 1,
                high + 1,
                1 << 26,
                1 << 31,
                1 << 32,
                1 << 62,
                (1 << 63) - 1,
                1 << 63,
                -(1 << 63),
                1.0,
                None,
            )
            claim["shape"][at] = self._pick([n for n in beyond if not (type(n) is int and low <= n <= high)])
            return f"shape {claim['shape']}"
        known = {"name": (), "dtype": tuple(wire.DTYPES), "codec": ("raw", "zstd")}
        before = claim[key]
        options = [v for v in (*NO_FIELD, *known.get(key, ())) if type(v) is not type(before) or v != before]
        claim[key] = self._pick(options)
        if key == "codec" and claim[key] in ("raw", "zstd") and claim["size"] == 0:
            return ""  # no bytes in either codec: an array of size 0 is read as raw
        return f"{key} {claim[key]!r}"


def build(cls: type[Message], pick: Pick) -> Built:
    """A message of `cls`: its header as declared, with none, one or two things in it that must be refused."""
    builder = _Builder(pick, pick((0, 1, 1, 2)))
    header = builder.record(cls, cls.__name__, arrays=tuple(cls.ARRAYS))
    _agree(cls, header, pick)
    claims, bodies = [], []
    for name, spec in cls.ARRAYS.items():
        if spec.optional and pick(range(2)):
            continue
        claim, body = builder.descriptor(name, spec, _shape_of(cls, name, header, pick))
        claims.append(claim)
        bodies.append(body)
    whole = {"kind": cls.__name__, "fields": header, "arrays": claims}
    if builder._left and pick(range(8)) == 7:
        builder.wrong.append(_spoil_whole(cls, whole, pick))
    wrong = "; ".join(text for text in builder.wrong if text)
    try:
        packed: bytes = msgpack.packb(whole)
    except (OverflowError, ValueError):  # what MessagePack cannot say
        return Built(b"", "not sayable")
    return Built(b"TBL\x01" + len(packed).to_bytes(4, "little") + packed + b"".join(bodies), wrong)


def read(cls: type[Message], built: Built) -> str:
    """'value', or the reason for which the message was refused.

    Raises:
        AssertionError: it was taken though it must be refused, or holds what its class does not allow.
    """
    try:
        message = cls.decode(built.data)
    except MessageError as error:
        said, reason = str(error), str(error.reason)
    else:
        found = built.wrong or fault(message, cls, cls.__name__)
        if found:
            raise AssertionError(f"taken in spite of {found:.500}: {str(message)[:500]}")
        return "value"
    if not said.strip() or len(said) > MOST_ERROR_CHARACTERS:
        raise AssertionError(f"the error has {len(said)} characters: {said:.500}")
    return reason


def _spoil_whole(cls: type[Message], whole: dict[str, Any], pick: Pick) -> str:
    where = pick(("drop", "add", "kind", "fields", "arrays", "more"))
    match where:
        case "drop":
            required = list(whole["fields"])[:1]
            del whole["fields"][required[0]]
        case "add":
            whole["fields"][pick(("", "unknown", "__class__", "x" * 5000))] = pick(NO_FIELD)
            if cls.LATER_FIELDS == "ignore":
                return ""
        case "kind" | "fields":
            whole[where] = pick(NO_FIELD)
        case "arrays":
            whole["arrays"] = pick([v for v in NO_FIELD if v != []]) if pick(range(2)) else whole["arrays"] + [{}]
        case "more":
            whole["more"] = pick(NO_FIELD)
    return str(where)


def _agree(cls: type[Message], header: dict[str, Any], pick: Pick) -> None:
    """Most messages of classes whose fields must fit each other are made to."""
    if pick(range(8)) == 7:
        return
    if cls.__name__ == "Weight" and not fault(header["status"], hints_of(cls)["status"], ""):
        weighed = all(header[name] is not None for name in ("weight_g", "low_g", "high_g"))
        header["status"] = "weighed" if weighed else "refused"
    if cls.__name__ == "WeightsParcel" and not fault(header["file"], hints_of(cls)["file"], ""):
        header["file"] = pick(("a.safetensors", "b.pth"))


def _shape_of(cls: type[Message], name: str, header: dict[str, Any], pick: Pick) -> tuple[int, ...] | None:
    """A frame's pictures have the size of its intrinsics, a view's lies within, most of the time."""
    intrinsics = header.get("intrinsics")
    if cls.ARRAYS[name].dtype != "u2" or not isinstance(intrinsics, dict) or pick(range(8)) == 7:
        return None
    size = (intrinsics.get("height"), intrinsics.get("width"))
    if not all(type(n) is int and 0 < n <= 16384 for n in size):
        return None
    if cls.__name__ == "Frame":
        return size  # type: ignore[return-value]
    for at in ("u0", "v0"):
        if type(header[at]) is int and 0 <= header[at] <= 16384:
            header[at] = 0
    return tuple(min(n, pick((1, 2, 0))) for n in size)


@cache
def _zeros(size: int) -> bytes:
    return zstandard.ZstdCompressor(level=1).compress(bytes(size))
