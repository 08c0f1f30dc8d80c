"""Inputs and outputs of the plant: sensor values, and the commands of sequence programs to actuators."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING

from .errors import NotConnected, Refused
from .messages import IoState

if TYPE_CHECKING:
    from .plc import Plc


class Io:
    """One input or output, by its name in the configuration: ``plc.io_in("door_closed")``, ``plc.io_out("lamp")``."""

    def __init__(self, plc: Plc, side: str, name: str) -> None:
        self._plc = plc
        self.side = side
        """``in`` or ``out``."""
        self.name = name

    @property
    def path(self) -> str:
        """Its topic, below the machine's root."""
        return f"io/{self.side}/{self.name}"

    @property
    def state(self) -> IoState:
        """Its value with its owner, and whether it is forced.

        Raises:
            Refused: the configuration does not declare it, or the machine has not published it yet.
        """
        message = self._plc._connection.hub.last(self.path)
        if isinstance(message, IoState):
            return message
        self._check(None)
        raise Refused("not_found", f"{self.path}: the machine has not told of it yet")

    @property
    def value(self) -> bool | float:
        """Current value: the forced value, else the value written by its owner, else its safe value."""
        return self.state.value

    async def values(self) -> AsyncIterator[bool | float]:
        """Follow it: the current value, then each different one. It ends with the connection."""
        last = None
        async with contextlib.aclosing(self._plc._connection.hub.follow(self.path)) as states:
            async for state in states:
                if state.value != last:
                    last = state.value
                    yield state.value

    async def wait_until(self, fits: Callable[[bool | float], bool] = bool) -> bool | float:
        """Wait for a value that fits, and return it: until it is on, or a condition such as ``lambda v: v > 12.5``.

        Raises:
            Refused: the configuration does not declare it.
            NotConnected: the connection was closed here.
        """
        self._check(None)
        async for value in self.values():
            if fits(value):
                return value
        raise NotConnected("the connection was closed here")

    async def set(self, value: bool | float) -> None:
        """Write it.

        A program that serves the machine owns each output that it writes: the value is written again on each connection
        and at each boot, and no other client writes it while the program is online. After that it gets its safe value.
        If the machine is offline, the program waits for it. A client without handlers writes outputs that no handler
        owns.

        Raises:
            Refused: it is not declared, the value has the wrong kind or range, or another handler owns it.
            NotConnected: there is no connection, for a client without handlers.
            NoAnswer: it was sent, but its arrival is unknown.
        """
        self._check(value)
        if self._plc.is_connected:
            self._check_owner()
        await self._plc._levels.set((f"{self.path}/set", ""), {"value": value})

    async def force(self, value: bool | float) -> None:
        """Replace the written value, as an operator does, until :meth:`release`.

        Raises:
            Refused: it is not declared, or the value has the wrong kind or range.
        """
        self._check(value)
        await self._put_in_place(value)

    async def release(self) -> None:
        """Remove the forced value: the value written by its owner applies again."""
        self._check(None)
        await self._put_in_place(None)

    async def _put_in_place(self, value: bool | float | None) -> None:
        connection = self._plc._connection
        payload = {"value": value, "by": connection.handler_id or connection.client_id}
        await connection.request(f"{self.path}/force", payload)

    def _check(self, value: bool | float | None) -> None:
        """Validate a write against the machine's messages, because the broker does not report a refused write."""
        birth = self._plc.birth
        if birth is None:
            return
        declared = birth.io.get(self.side, {})
        if self.name not in declared:
            there = ", ".join(list(declared)[:20]) or "none"
            text = f"the configuration has no [io.{self.side}.{self.name}]; there are {there}"
            raise Refused("not_found", text)
        wrong = None if value is None else declared[self.name].wrong(value)
        if wrong is not None:
            raise Refused("invalid", f"{self.path}: {wrong}")

    def _check_owner(self) -> None:
        state, own = self._plc._connection.hub.last(self.path), self._plc._levels.owner
        if (
            not isinstance(state, IoState)
            or state.owner is None
            or state.owner == own
            or (state.lost and own is not None)
        ):
            return
        whose = f"it waits for handler {state.owner}" if state.lost else f"it is handler {state.owner}'s"
        raise Refused("not_allowed", f"{self.path}: {whose}; an operator puts a value in its place by force")
