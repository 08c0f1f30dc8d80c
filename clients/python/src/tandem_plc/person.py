"""Requests of a person: each carries an age limit, after which the machine rejects it."""

from __future__ import annotations

from typing import Any

from .connection import Connection
from .errors import NotConnected
from .messages import Heartbeat

NOT_AFTER_S = 1.0
"""Time after the newest heartbeat within which a request of a person takes effect."""

_WITHOUT = ("variable/get", "lease/take", "lease/release", "alarm/raise")
"""Suffixes of topics whose messages cannot cause motion, or that carry their own time limit."""


class PersonConnection:
    """A connection whose requests carry the age limit of one press."""

    def __init__(self, connection: Connection, within_s: float) -> None:
        heartbeat: Heartbeat | None = connection.hub.last("heartbeat")
        if heartbeat is None:
            raise NotConnected("no heartbeat of the machine has been received; nothing was sent")
        self._connection = connection
        self._not_after = {
            "boot_id": heartbeat.boot_id,
            "heartbeat": heartbeat.cycle,
            "within_ms": max(1, round(within_s * 1000)),
        }

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    async def request(self, path: str, payload: dict[str, Any], **options: Any) -> Any:
        """Send a message with the age limit, as :meth:`Connection.request` does without."""
        if not path.endswith(_WITHOUT):
            payload = {**payload, "not_after": self._not_after}
        return await self._connection.request(path, payload, **options)


class PersonLevels:
    """Sets locks, inputs and outputs of the plant once, as a person does: nothing is written again."""

    owner = None

    def __init__(self, connection: PersonConnection) -> None:
        self._connection = connection

    async def set(self, target: tuple[str, str], level: dict[str, Any]) -> None:
        """Set a level."""
        await self._connection.request(target[0], dict(level))
