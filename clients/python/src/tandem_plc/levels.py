"""Locks, and inputs and outputs of the plant, that a program has set: written again on each connection and boot."""

from __future__ import annotations

import asyncio
import logging
from typing import Any

from .connection import Connection
from .errors import NoAnswer, NotConnected, RequestRefused

log = logging.getLogger("tandem_plc")

_RETRY_S = 0.5
_TIMEOUT_S = 2.0
LEVELS_MAX = 1024
"""Maximum number of sources, inputs and outputs that one program sets; a plant has up to 256 of each."""

LevelTarget = tuple[str, str]
"""Key of a level: the topic that sets the level, and the source of an interlock or start lock."""


def lock_target(cs: int, kind: str, source: str) -> LevelTarget:
    """Return the key of a source; ``kind`` is ``interlock`` or ``start_lock``."""
    return f"cs/{cs}/input/{kind}/set", source


def lock_level(value: bool, text: str, source: str) -> dict[str, Any]:
    """Return the payload that sets a source."""
    return {"value": value, "text": text, "source": source}


class Levels:
    """Values that the program has set, and their owner."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._wanted: dict[LevelTarget, dict[str, Any]] = {}
        self._dirty: set[LevelTarget] = set()
        self._is_announced = asyncio.Event()
        self._work = asyncio.Event()
        self.owner: str | None = None
        """The handler that owns them; it must be registered before they are written."""

    async def set(self, target: LevelTarget, level: dict[str, Any]) -> None:
        """Set a level.

        Raises:
            RequestRefused: the machine refuses the level, for example because another handler owns the source.
            NotConnected: there is no connection; a program that serves the machine waits for a connection instead.
            NoAnswer: the level was sent, but its arrival is unknown.
        """
        if target not in self._wanted and len(self._wanted) >= LEVELS_MAX:
            raise RequestRefused("invalid", f"one program sets at most {LEVELS_MAX} levels")
        before = self._wanted.get(target)
        self._wanted[target] = level
        if self.owner is None:
            await self._write(target)
            return
        while True:
            try:
                await self._is_announced.wait()
                await self._write(target)
            except (NotConnected, NoAnswer) as error:
                log.warning("%s %s is not written yet: %s", *target, error)
                await asyncio.sleep(_RETRY_S)
            except RequestRefused:
                if before is None:
                    self._wanted.pop(target, None)
                else:
                    self._wanted[target] = before
                raise
            else:
                return

    def want(self, target: LevelTarget, level: dict[str, Any]) -> None:
        """Set a level without waiting; :meth:`keep_written` writes it."""
        self._wanted[target] = level
        self._dirty.add(target)
        self._work.set()

    def on_announced(self, owner: str) -> None:
        """Write all values again after a new registration."""
        self.owner = owner
        self._is_announced.set()
        self._dirty.update(self._wanted)
        self._work.set()

    def on_offline(self) -> None:
        """Pause writing: the machine no longer knows the owner."""
        self._is_announced.clear()

    async def keep_written(self) -> None:
        """Write changed values until the task is cancelled."""
        while True:
            await self._work.wait()
            await self._is_announced.wait()
            if not self._dirty:
                self._work.clear()
                continue
            target = self._dirty.pop()
            try:
                await self._write(target)
            except RequestRefused as error:
                log.error("%s %s: %s", *target, error)  # noqa: TRY400 -- what the machine says is enough
            except (NotConnected, NoAnswer) as error:
                log.warning("%s %s is not written yet: %s", *target, error)
                self._dirty.add(target)
                await asyncio.sleep(_RETRY_S)

    async def _write(self, target: LevelTarget) -> None:
        payload = dict(self._wanted[target])
        if self.owner is not None:
            payload.update(handler_id=self.owner, instance=self._connection.instance)
        await self._connection.request(target[0], payload, timeout_s=_TIMEOUT_S)
