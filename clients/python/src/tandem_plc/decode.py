"""Converts JSON to dataclasses and validates it: received data may be wrong, and an error names the mistake."""

from __future__ import annotations

import contextlib
import enum
import math
import types
import typing
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from typing import Any, Literal, TypeVar

T = TypeVar("T")

DEPTH_MAX = 16


class DecodeError(ValueError):
    """A received value does not have the expected form."""


@cache
def _fields(cls: type) -> tuple[tuple[str, str, Any, bool], ...]:
    """Return the fields of a dataclass: name in JSON, name in Python, type, and whether a message must contain it."""
    hints = typing.get_type_hints(cls)
    return tuple(
        # a name that Python reserves has an underscore at its end
        (
            item.name.removesuffix("_"),
            item.name,
            hints[item.name],
            item.default is MISSING and item.default_factory is MISSING,
        )
        for item in fields(cls)
    )


def decode(cls: type[T], value: object) -> T:
    """Read a dataclass from parsed JSON; unknown fields are ignored.

    Raises:
        DecodeError: a field is missing or of another type.
    """
    return typing.cast(T, _read(cls, value, cls.__name__, 0))


def _read(kind: Any, value: object, where: str, depth: int) -> object:
    if depth > DEPTH_MAX:
        raise DecodeError(f"{where}: nested too deeply")
    origin = typing.get_origin(kind)
    if origin in (typing.Union, types.UnionType):
        return _read_union(typing.get_args(kind), value, where, depth)
    if origin is tuple:
        item, *others = typing.get_args(kind)
        if not isinstance(value, list) or (others[0] is not Ellipsis and len(value) != 1 + len(others)):
            raise DecodeError(f"{where}: not a list of {kind}")
        return tuple(_read(item, entry, f"{where}[{at}]", depth + 1) for at, entry in enumerate(value))
    if origin is dict:
        if not isinstance(value, dict):
            raise DecodeError(f"{where}: not an object")
        item = typing.get_args(kind)[1]
        return {str(key): _read(item, entry, f"{where}.{key}", depth + 1) for key, entry in value.items()}
    if origin is Literal:
        # a later machine may use further words
        return _read_scalar(str, value, where)
    if is_dataclass(kind) and isinstance(kind, type):
        return _read_object(kind, value, where, depth)
    return _read_scalar(kind, value, where)


def _read_union(kinds: tuple[Any, ...], value: object, where: str, depth: int) -> object:
    if value is None and type(None) in kinds:
        return None
    rest = [kind for kind in kinds if kind is not type(None)]
    for kind in rest[:-1]:
        with contextlib.suppress(DecodeError):
            return _read(kind, value, where, depth)
    return _read(rest[-1], value, where, depth)


def _read_object(kind: type, value: object, where: str, depth: int) -> object:
    if not isinstance(value, dict):
        raise DecodeError(f"{where}: not an object")
    given = {}
    for name, field, hint, is_required in _fields(kind):
        if name in value:
            given[field] = _read(hint, value[name], f"{where}.{name}", depth + 1)
        elif is_required:
            raise DecodeError(f"{where}.{name} is missing")
    return kind(**given)


def _read_scalar(kind: Any, value: object, where: str) -> object:
    if kind is Any:
        return value
    if isinstance(kind, type) and issubclass(kind, enum.Enum):
        try:
            return kind(value)
        except ValueError:
            raise DecodeError(f"{where}: {value!r} is no {kind.__name__}") from None
    if kind is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            number = float(value)
        except OverflowError:
            raise DecodeError(f"{where}: out of range") from None
        if math.isfinite(number):
            return number
    elif kind in (int, str, bool) and type(value) is kind:
        return value
    raise DecodeError(f"{where}: {value!r:.80} is no {getattr(kind, '__name__', kind)}")
