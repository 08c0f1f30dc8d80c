"""Inputs and outputs of the plant: sensor values, and the commands of sequence programs to actuators."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING

from .errors import NotConnected, RequestRefused
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
        """Topic of the input or output, below the machine's root."""
        return f"io/{self.side}/{self.name}"

    @property
    def state(self) -> IoState:
        """State: the value, the owner, and whether the value is forced.

        Raises:
            RequestRefused: the configuration does not declare the input or output, or the machine has not published it
                yet.
        """
        message = self._plc._connection.hub.last(self.path)
        if isinstance(message, IoState):
            return message
        self._check(None)
        raise RequestRefused("not_found", f"{self.path}: the machine has not published its state yet")

    @property
    def value(self) -> bool | float:
        """Current value: the forced value, otherwise the value that the owner has written, otherwise the safe value."""
        return self.state.value

    async def values(self) -> AsyncIterator[bool | float]:
        """Follow the value: the current value, then each changed value. The sequence ends with the connection."""
        last = None
        async with contextlib.aclosing(self._plc._connection.hub.follow(self.path)) as states:
            async for state in states:
                if state.value != last:
                    last = state.value
                    yield state.value

    async def wait_until(self, fits: Callable[[bool | float], bool] = bool) -> bool | float:
        """Wait for a value for which ``fits`` is true, and return it; by default until the value is on.

        Example: ``await level.wait_until(lambda v: v > 12.5)``.

        Raises:
            RequestRefused: the configuration does not declare the input or output.
            NotConnected: the connection was closed here.
        """
        self._check(None)
        async for value in self.values():
            if fits(value):
                return value
        raise NotConnected("the connection was closed here")

    async def set(self, value: bool | float) -> None:
        """Write a value.

        A program that serves the machine owns each output that it writes: the value is written again on each connection
        and at each boot, and no other client writes it while the program is online. After that the output gets its safe
        value. If the machine is offline, the program waits for it. A client without handlers writes outputs that no
        handler owns.

        Raises:
            RequestRefused: the output is not declared, another handler owns it, or the value has the wrong kind or
                range.
            NotConnected: there is no connection, for a client without handlers.
            NoAnswer: the value was sent, but its arrival is unknown.
        """
        self._check(value)
        if self._plc.is_connected:
            self._check_owner()
        await self._plc._levels.set((f"{self.path}/set", ""), {"value": value})

    async def force(self, value: bool | float) -> None:
        """Replace the written value, as an operator does, until :meth:`release`.

        Raises:
            RequestRefused: the input or output is not declared, or the value has the wrong kind or range.
        """
        self._check(value)
        await self._send_force(value)

    async def release(self) -> None:
        """Remove the forced value: the value that the owner has written applies again."""
        self._check(None)
        await self._send_force(None)

    async def _send_force(self, value: bool | float | None) -> None:
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
            raise RequestRefused("not_found", text)
        wrong = None if value is None else declared[self.name].wrong(value)
        if wrong is not None:
            raise RequestRefused("invalid", f"{self.path}: {wrong}")

    def _check_owner(self) -> None:
        state, own = self._plc._connection.hub.last(self.path), self._plc._levels.owner
        if (
            not isinstance(state, IoState)
            or state.owner is None
            or state.owner == own
            or (state.lost and own is not None)
        ):
            return
        whose = f"it waits for handler {state.owner}" if state.lost else f"handler {state.owner} owns it"
        raise RequestRefused("not_allowed", f"{self.path}: {whose}; an operator can force a value")
