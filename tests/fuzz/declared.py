"""What a field may hold by what its class declares, what it may not, and what is wrong with a value that it holds.

`fault` finds that without the library that the decoder uses.
"""

from __future__ import annotations

import math
import re
import types
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import msgpack

from conveyor.messages.base import ArraySpec
from conveyor.ranges import Items, Range, Text

NO_FIELD: tuple[Any, ...] = (
    None, True, False, "", "1", "nan", "\x00", "ü" * 300, "a/b", "9" * 5000, 0.5, -1.0, 1e300, -1e300, 5e-324, 1e308,
    math.inf, -math.inf, math.nan, -1, 1 << 31, (1 << 53) + 1, (1 << 63) - 1, 1 << 63, (1 << 64) - 1, -(1 << 63),
    [], {}, [[]], {"a": []}, [0] * 40, [1e308], {"": math.nan}, b"", b"x", msgpack.ExtType(1, b""),
    msgpack.Timestamp(0), [[[[[[[[[[]]]]]]]]]], {"a": {"a": {"a": {"a": {"a": {"a": {"a": {}}}}}}}},
)  # fmt: skip
"""Values that many fields may not hold."""

_HINTS: dict[Any, dict[str, Any]] = {}


def hints_of(cls: Any) -> dict[str, Any]:
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
class Form:
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


_FORMS: dict[int, Form] = {}


def form_of(hint: Any) -> Form:
    """By the object itself: to hash a type costs more than all that is done with it."""
    form = _FORMS.get(id(hint))
    if form is None or form.hint is not hint:
        kind, marks = _taken_apart(hint)
        options = _alternatives(kind)
        each = tuple(Annotated[option, *marks] if marks else option for option in options)
        form = Form(hint, kind, marks, options, each, get_origin(kind), get_args(kind), is_dataclass(kind))
        _FORMS[id(hint)] = form
    return form


@cache
def names_of(cls: Any) -> tuple[str, ...]:
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
    return form_of(hint).outside


def _fits(text: str, mark: Text) -> bool:
    pattern = mark.pattern.removeprefix("^").removesuffix("$")
    return len(text) <= mark.most and (not pattern or re.fullmatch(pattern, text) is not None)


def fault(value: Any, hint: Any, where: str) -> str:
    """What `value` holds that a field of this type may not, with its place; empty where all is allowed."""
    form = form_of(hint)
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


def _container_fault(value: Any, form: Form, where: str) -> str:
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
    hints = hints_of(cls)
    for name in names_of(cls):
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
