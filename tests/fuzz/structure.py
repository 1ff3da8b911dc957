"""Messages built from what their classes declare: header by header, field by field, at and beyond each limit.

`build` takes every choice by one function, so that hypothesis and a plain random generator drive the same builder; of
the options the first is the plainest one. It says whether it put anything in that must be refused. `fault` finds,
without the library that the decoder uses, what a decoded message holds that its class does not allow.
"""

from __future__ import annotations

import math
import re
import types
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgpack
import numpy as np
import zstandard

from conveyor import messages as m
from conveyor import wire
from conveyor.errors import MessageError
from conveyor.geometry import straight_down_belt_from_camera
from conveyor.messages.base import ArraySpec, Message
from conveyor.ranges import Items, Range, Text
from regressor.serve.messages import WeightsParcel, WeightsReport, WeightsState

CLASSES: tuple[type[Message], ...] = (
    m.Frame, m.CameraInfo, m.FrameProgress, m.Travel, m.View, m.Weight, m.TrackEntry, m.Committed, m.Tuber, m.Totals,
    m.Counters, m.Picture, WeightsParcel, WeightsReport, WeightsState,
)  # fmt: skip
"""Every message that crosses a process boundary."""
Pick = Callable[[Sequence[Any]], Any]
NO_FIELD: tuple[Any, ...] = (
    None, True, False, "", "1", "nan", "\x00", "ü" * 300, "a/b", "9" * 5000, 0.5, -1.0, 1e300, -1e300, 5e-324, 1e308,
    math.inf, -math.inf, math.nan, -1, 1 << 31, (1 << 53) + 1, (1 << 63) - 1, 1 << 63, (1 << 64) - 1, -(1 << 63),
    [], {}, [[]], {"a": []}, [0] * 40, [1e308], {"": math.nan}, b"", b"x", msgpack.ExtType(1, b""),
    msgpack.Timestamp(0), [[[[[[[[[[]]]]]]]]]], {"a": {"a": {"a": {"a": {"a": {"a": {"a": {}}}}}}}},
)  # fmt: skip
"""Values that many fields may not hold."""
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
        form = _form(hint)
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
        hints = _hints(cls)
        return {name: self.value(hints[name], f"{where}.{name}") for name in _names(cls) if name not in arrays}

    def _key(self, hint: Any, where: str) -> str:
        if self._left and self._pick(range(6)) == 5:
            self._left -= 1
            self.wrong.append(f"{where}.key")
            return str(self._pick([v for v in outside(hint) if isinstance(v, str)]))
        return str(self._pick(_form(hint).inside))

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
        builder.wrong.append(_spoil_whole(whole, pick))
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


def _spoil_whole(whole: dict[str, Any], pick: Pick) -> str:
    where = pick(("drop", "add", "kind", "fields", "arrays", "more"))
    match where:
        case "drop":
            required = list(whole["fields"])[:1]
            del whole["fields"][required[0]]
        case "add":
            whole["fields"][pick(("", "unknown", "__class__", "x" * 5000))] = pick(NO_FIELD)
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
    if cls.__name__ == "Weight" and not fault(header["status"], _hints(cls)["status"], ""):
        weighed = all(header[name] is not None for name in ("weight_g", "low_g", "high_g"))
        header["status"] = "weighed" if weighed else "refused"
    if cls.__name__ == "WeightsParcel" and not fault(header["file"], _hints(cls)["file"], ""):
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


_HINTS: dict[Any, dict[str, Any]] = {}


def _hints(cls: Any) -> dict[str, Any]:
    if cls not in _HINTS:
        _HINTS[cls] = get_type_hints(cls, include_extras=True)
    return _HINTS[cls]


@cache
def _taken_apart(hint: Any) -> tuple[Any, tuple[Any, ...]]:
    """(type, marks) of `Annotated[type, *marks]`."""
    if get_origin(hint) is Annotated:
        kind, *marks = get_args(hint)
        return kind, tuple(marks)
    return hint, ()


def _alternatives(kind: Any) -> tuple[Any, ...]:
    return get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)


@dataclass(slots=True)
class _Form:
    """A field's type taken apart, once: asking `typing` again and again took two thirds of the time.

    `options` are what a union is made of, `each` the same with the union's own marks; `inside` and `outside` are made
    when they are first asked for.
    """

    hint: Any
    kind: Any
    marks: tuple[Any, ...]
    options: tuple[Any, ...]
    each: tuple[Any, ...]
    origin: Any
    args: tuple[Any, ...]
    is_record: bool
    _inside: tuple[Any, ...] | None = None
    _outside: tuple[Any, ...] | None = None

    @property
    def inside(self) -> tuple[Any, ...]:
        if self._inside is None:
            self._inside = inside(self.hint)
        return self._inside

    @property
    def outside(self) -> tuple[Any, ...]:
        if self._outside is None:
            self._outside = _outside(self.hint)
        return self._outside


_FORMS: dict[int, _Form] = {}


def _form(hint: Any) -> _Form:
    """By the object itself: to hash a type costs more than all that is done with it."""
    form = _FORMS.get(id(hint))
    if form is None or form.hint is not hint:
        kind, marks = _taken_apart(hint)
        options = _alternatives(kind)
        each = tuple(Annotated[option, *marks] if marks else option for option in options)
        form = _Form(hint, kind, marks, options, each, get_origin(kind), get_args(kind), is_dataclass(kind))
        _FORMS[id(hint)] = form
    return form


@cache
def _names(cls: Any) -> tuple[str, ...]:
    return tuple(f.name for f in fields(cls))


@cache
def inside(hint: Any) -> tuple[Any, ...]:
    """Values of a simple field at, and just within, its limits."""
    kind, marks = _taken_apart(hint)
    if get_origin(kind) is Literal:
        return get_args(kind)
    if kind is type(None):
        return (None,)
    if kind is bool:
        return (True, False)
    for mark in marks:
        if isinstance(mark, Range) and kind is int:
            low, high = int(mark.low), int(mark.high)
            near = (low, low + 1, low + 2, 1, 2, (low + high) // 2, high - 1, high)
            return tuple(n for n in dict.fromkeys(near) if low <= n <= high)
        if isinstance(mark, Range):
            first, last = float(mark.low), float(mark.high)
            steps = (first, math.nextafter(first, last), 0.0, -0.0, 5e-324, 0.5, math.nextafter(last, first), last)
            return tuple(x for x in steps if first <= x <= last)
        if isinstance(mark, Text):
            texts = ("a", "r1", "a.b-c_d", "0" * mark.most, "m@1/x", "", "ü" * mark.most, "two words", "new\nline")
            return tuple(text for text in texts if _fits(text, mark))
    raise TypeError(f"{hint} declares no range")


@cache
def _outside(hint: Any) -> tuple[Any, ...]:
    beyond: list[Any] = list(NO_FIELD)
    for option in _alternatives(_taken_apart(hint)[0]):
        kind, marks = _taken_apart(option)
        for mark in (*_taken_apart(hint)[1], *marks):
            if isinstance(mark, Range) and kind is int:
                beyond += [int(mark.low) - 1, int(mark.high) + 1, float(mark.low)]
            elif isinstance(mark, Range):
                beyond += [math.nextafter(mark.low, -math.inf), math.nextafter(mark.high, math.inf), str(mark.low)]
            elif isinstance(mark, Text):
                beyond += ["a" * (mark.most + 1), "ü" * (mark.most + 1)]
    return tuple(value for value in beyond if fault(value, hint, "it"))


def outside(hint: Any) -> tuple[Any, ...]:
    """Values that a field of this type may not hold: beyond its limits, of other types, of any other kind."""
    return _form(hint).outside


def _fits(text: str, mark: Text) -> bool:
    pattern = mark.pattern.removeprefix("^").removesuffix("$")
    return len(text) <= mark.most and (not pattern or re.fullmatch(pattern, text) is not None)


def fault(value: Any, hint: Any, where: str) -> str:
    """What `value` holds that a field of this type may not, with its place; empty where all is allowed."""
    form = _form(hint)
    kind, marks = form.kind, form.marks
    if len(form.options) > 1:
        found = [fault(value, each, where) for each in form.each]
        return "" if "" in found else found[0]
    if form.is_record:
        return _record_fault(value, kind, where)
    if form.origin is Literal:
        return "" if isinstance(value, str) and value in form.args else f"{where} is {value!r}"
    if kind in (type(None), bool):
        return "" if type(value) is kind else f"{where} is {value!r}"
    if form.origin in (dict, tuple):
        return _container_fault(value, form, where)
    for mark in marks:
        if isinstance(mark, Text) and not (type(value) is str and _fits(value, mark)):
            return f"{where} is {value!r:.60}"
        if isinstance(mark, Range):
            number = type(value) is int or (kind is float and type(value) is float and math.isfinite(value))
            if not (number and mark.low <= value <= mark.high):
                return f"{where} is {value!r:.60}"
    return "" if any(isinstance(mark, (Text, Range)) for mark in marks) else f"{where} of {hint} declares no range"


def _container_fault(value: Any, form: _Form, where: str) -> str:
    most = next((mark.most for mark in form.marks if isinstance(mark, Items)), None)
    if most is None:
        return f"{where} declares no number of items"
    if not isinstance(value, dict if form.origin is dict else list | tuple) or len(value) > most:
        return f"{where} is {value!r:.60}"
    if isinstance(value, dict):
        keys, values = form.args
        found = [fault(k, keys, f"{where}.key") or fault(v, values, f"{where}.{k}") for k, v in value.items()]
    else:
        found = [fault(item, form.args[0], f"{where}.{n}") for n, item in enumerate(value)]
    return next(filter(None, found), "")


def _record_fault(value: Any, cls: Any, where: str) -> str:
    if not isinstance(value, cls):
        return f"{where} is {value!r:.60}, no {cls.__name__}"
    arrays: dict[str, ArraySpec] = getattr(cls, "ARRAYS", {})
    hints = _hints(cls)
    for name in _names(cls):
        if name not in arrays and (found := fault(getattr(value, name), hints[name], f"{where}.{name}")):
            return found
    for name, spec in arrays.items():
        array = getattr(value, name)
        if array is None:
            if not spec.optional:
                return f"{where}.{name} is None"
        elif found := spec.fault(array.dtype.str[1:], array.shape) or spec.value_fault(array):
            return f"{where}.{name} {found}"
    return ""
