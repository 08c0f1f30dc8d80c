"""Variables as the machine publishes them whenever they change."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import AsyncIterator
from typing import TYPE_CHECKING

from .errors import RequestRefused
from .messages import PublishedVariables

if TYPE_CHECKING:
    from .plc import Plc

COUNT_MAX = 1024


def values_of(published: PublishedVariables, first: int, count: int) -> list[float] | None:
    """Return values of variables from ``first`` on, or ``None`` if not all of them are published."""
    known: dict[int, float] = {}
    for row in published.variables:
        known.update(enumerate(map(float, row.values), row.from_))
    numbers = range(first, first + count)
    return [known[number] for number in numbers] if all(number in known for number in numbers) else None


async def changes(plc: Plc, path: str, kind: str, first: int, count: int) -> AsyncIterator[list[float]]:
    """Follow variables that are published on a topic."""
    last: bytes | None = None
    if not 1 <= count <= COUNT_MAX:
        raise _refused(kind, first, count)
    async with contextlib.aclosing(plc._connection.hub.follow(path)) as messages:
        async for message in messages:
            values = values_of(message, first, count)
            if values is None:
                raise _refused(kind, first, count)
            # NaN must equal NaN here
            bits = struct.pack(f"{count}d", *values)
            if bits != last:
                last = bits
                yield values


def _refused(kind: str, first: int, count: int) -> RequestRefused:
    which = f"{kind}{first} is" if count == 1 else f"{count} variables from {kind}{first} on are"
    to_write = f'[[variables.published]] from = "{kind}{first}", count = {count}'
    text = f"{which} not published by this machine: name them in its configuration, such as {to_write}"
    return RequestRefused("not_found", text)
