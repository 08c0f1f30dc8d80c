"""A machine: its coordinate systems, alarms, and variables."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any, cast

from .changes import changes
from .connection import ANSWER_TIMEOUT_S, PRESENT_TIMEOUT_S, Connection, Credentials
from .coordinate_system import CoordinateSystem
from .errors import Alarm, RequestRefused
from .io import Io
from .levels import Levels
from .messages import AlarmRecord, Birth, CommandReply, Presence, ToolData
from .person import NOT_AFTER_S, PersonConnection, PersonLevels


class Plc:
    """One machine behind a broker.

    ``async with Plc.connect("mqtt://127.0.0.1:1883/mill-1") as plc: await plc.cs(1).start()``
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._levels = Levels(connection)
        self._numbers = itertools.count(1)
        self._fences: dict[int, int] = {}

    @classmethod
    def connect(
        cls, address: str, *, credentials: Credentials | None = None, timeout_s: float = PRESENT_TIMEOUT_S
    ) -> Connecting:
        """Connect to a machine, for use in ``async with`` or ``await``.

        Args:
            address: ``mqtt://[user:password@]host[:port][,host[:port]..]/[prefix/]machine``, ``mqtts://`` with TLS. If
                the address names several nodes, the first node that answers is used until its connection is lost.
            credentials: user, password and TLS, which an address should not contain.
            timeout_s: time limit for the first contact with the machine; later losses have no time limit.

        Raises:
            AddressError: the address is invalid.
            ConnectError: no broker answers, the broker refuses the user, or no machine of that name is online.
        """
        return Connecting(cls(Connection(address, credentials)), timeout_s)

    async def close(self) -> None:
        """End the connection."""
        await self._connection.stop()

    def for_person(self, *, within_s: float = NOT_AFTER_S) -> Plc:
        """Return a handle for a request that a person makes at this moment, such as by pressing a button.

        Requests of this handle expire ``within_s`` after the newest heartbeat that this connection has received: the
        machine then rejects them as ``expired``. Take a new handle for each press of a button. Sequence programs do
        not need such a handle, because an output causes their requests.

        Raises:
            NotConnected: no heartbeat of the machine has been received.
        """
        person = copy.copy(self)
        connection = PersonConnection(self._connection, within_s)
        person._connection = cast(Connection, connection)
        person._levels = cast(Levels, PersonLevels(connection))
        return person

    def cs(self, number: int) -> CoordinateSystem:
        """Return a coordinate system by its number, from 1. If it does not exist, each call on it fails."""
        return CoordinateSystem(self, number)

    def io_in(self, name: str) -> Io:
        """Return an input of the plant, by its name in the configuration (``[io.in.NAME]``)."""
        return Io(self, "in", name)

    def io_out(self, name: str) -> Io:
        """Return an output of the plant, by its name in the configuration (``[io.out.NAME]``)."""
        return Io(self, "out", name)

    @property
    def is_connected(self) -> bool:
        """True while the machine can be reached."""
        return self._connection.is_connected

    @property
    def boot_id(self) -> str | None:
        """The boot of the runtime that is online; ``None`` while it is offline."""
        return self._connection.boot_id

    @property
    def birth(self) -> Birth | None:
        """Description of the machine."""
        birth: Birth | None = self._connection.hub.last("birth")
        return birth

    async def until(self, holds: Callable[[], bool]) -> None:
        """Wait until the received messages satisfy a condition, such as ``lambda: plc.cs(1).interlock.value``."""
        await self._connection.until(holds)

    async def presences(self) -> AsyncIterator[Presence]:
        """Follow whether the runtime is online."""
        async for presence in self._connection.hub.follow("presence"):
            yield presence

    @property
    def alarms(self) -> tuple[AlarmRecord, ...]:
        """Alarms and warnings that are active, ascending by id."""
        active = self._connection.hub.last("alarm/active")
        return () if active is None else tuple(active.alarms)

    async def alarm_events(self) -> AsyncIterator[AlarmRecord]:
        """Follow alarms: each alarm that is raised, acknowledged or cleared from now on."""
        async for record in self._connection.hub.follow("alarm/event"):
            yield record

    async def raise_alarm(self, alarm: Alarm, *, cs: int | None = None) -> None:
        """Raise an alarm that belongs to no output, such as low air pressure; it stops one coordinate system, or all.

        Raises:
            NotConnected: the request was not sent.
            NoAnswer: the request was sent, but its arrival is unknown.
        """
        payload: dict[str, Any] = {"code": alarm.code, "text": alarm.text}
        if cs is not None:
            payload["cs"] = cs
        await self._connection.request("alarm/raise", payload)

    async def set_skip_input(self, motor: int, value: bool) -> None:
        """Set the skip input of a motor (G31). Not real time: captures the position when the servo receives it.

        Raises:
            NotConnected: the request was not sent.
            NoAnswer: the request was sent, but its arrival is unknown.
        """
        await self._connection.request(f"motor/{motor}/skip_input/set", {"value": value})

    async def read_p(self, first: int, count: int = 1) -> list[float]:
        """Read up to 1024 P variables, all from one moment.

        Raises:
            RequestRefused: not all of these variables exist.
        """
        return await self._read_variables(1, "P", first, count)

    async def write_p(self, first: int, values: Sequence[float]) -> None:
        """Write up to 1024 P variables, all or none.

        Raises:
            RequestRefused: not all of these variables exist.
        """
        await self._write_variables(1, "P", first, values)

    async def p_changes(self, first: int, count: int = 1) -> AsyncIterator[list[float]]:
        """Follow P variables: their current values, then after each change by any writer.

        A machine publishes the variables listed in ``[[variables.published]]`` of its configuration, at most 10 times a
        second; if values change faster, only the latest. An NC program writes a variable when the block is interpreted,
        ahead of the motion.

        Raises:
            RequestRefused: the machine does not publish all these variables.
        """
        async for values in changes(self, "variables", "P", first, count):
            yield values

    async def tool_changes(self) -> AsyncIterator[tuple[ToolData, ...]]:
        """Follow the tool table, ascending by number: the current table, then each changed table."""
        async for table in self._connection.hub.follow("tools"):
            yield table.tools

    async def _read_variables(self, cs: int, kind: str, first: int, count: int) -> list[float]:
        reply = await self._ask(f"cs/{cs}/variable/get", {"kind": kind, "from": first, "count": count})
        values = () if reply.variables is None else reply.variables.values
        if len(values) != count:
            raise RequestRefused("unavailable", f"the machine did not answer with {count} values")
        return [float(value) for value in values]

    async def _write_variables(self, cs: int, kind: str, first: int, values: Sequence[float]) -> None:
        numbers = [value if math.isfinite(value) else _word(value) for value in values]
        await self._ask(f"cs/{cs}/variable/set", {"kind": kind, "from": first, "values": numbers})

    async def _ask(
        self,
        path: str,
        payload: dict[str, Any],
        *,
        command_id: str | None = None,
        timeout_s: float = ANSWER_TIMEOUT_S,
    ) -> CommandReply:
        client_id = self._connection.client_id
        command_id = command_id or f"{client_id}-{next(self._numbers)}"
        payload = {**payload, "command_id": command_id, "client_id": client_id}
        reply: CommandReply = await self._connection.request(path, payload, command_id=command_id, timeout_s=timeout_s)
        return reply


class Connecting:
    """A pending connection: ``async with`` it, or ``await`` it and close it yourself."""

    def __init__(self, plc: Plc, timeout_s: float) -> None:
        self._plc = plc
        self._timeout_s = timeout_s

    async def _open(self) -> Plc:
        await self._plc._connection.start(self._timeout_s)
        return self._plc

    def __await__(self) -> Any:
        return self._open().__await__()

    async def __aenter__(self) -> Plc:
        return await self._open()

    async def __aexit__(self, *_: object) -> None:
        await self._plc.close()


def _word(value: float) -> str:
    return "NaN" if math.isnan(value) else "inf" if value > 0 else "-inf"
