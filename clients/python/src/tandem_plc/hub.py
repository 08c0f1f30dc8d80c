"""Last message of each topic, and the followers of each topic."""

from __future__ import annotations

import asyncio
from collections import OrderedDict, deque
from collections.abc import AsyncGenerator, Callable
from typing import Any

TOPICS_MAX = 4_096
"""Maximum number of stored topics; the topic without messages for the longest time is evicted."""

BACKLOG_MAX = 256
"""Maximum number of messages that wait for one follower; the oldest are dropped."""


class Follower:
    """Messages of one topic, in their order."""

    def __init__(self, fits: Callable[[str], bool]) -> None:
        self.fits = fits
        self._backlog: deque[Any] = deque(maxlen=BACKLOG_MAX)
        self._news = asyncio.Event()
        self.is_closed = False

    def push(self, message: Any) -> None:
        """Add a message."""
        self._backlog.append(message)
        self._news.set()

    def close(self) -> None:
        """End the sequence: no further message follows."""
        self.is_closed = True
        self._news.set()

    async def next(self) -> Any:
        """Wait for the next message; ``None`` after the last one."""
        while not self._backlog:
            if self.is_closed:
                return None
            self._news.clear()
            await self._news.wait()
        return self._backlog.popleft()


class Hub:
    """Messages of the machine, by path below its root."""

    def __init__(self) -> None:
        self._last: OrderedDict[str, Any] = OrderedDict()
        self._followers: set[Follower] = set()

    def publish(self, path: str, message: Any) -> None:
        """Store a message as the last one of its topic, and pass it to the followers."""
        self._last[path] = message
        self._last.move_to_end(path)
        if len(self._last) > TOPICS_MAX:
            self._last.popitem(last=False)
        for follower in self._followers:
            if follower.fits(path):
                follower.push(message)

    def forget(self, path: str) -> None:
        """Drop the last message of a topic, because its retained message was cleared."""
        self._last.pop(path, None)

    def last(self, path: str) -> Any:
        """Return the last message of a topic; ``None`` before the first."""
        return self._last.get(path)

    def close(self) -> None:
        """End all followers."""
        for follower in self._followers:
            follower.close()

    async def follow(self, path: str) -> AsyncGenerator[Any, None]:
        """Yield the last message of a topic, then each later message.

        If messages arrive faster than they are read, the oldest are dropped. The sequence ends with the connection.
        """
        follower = Follower(lambda other: other == path)
        if path in self._last:
            follower.push(self._last[path])
        self._followers.add(follower)
        try:
            while (message := await follower.next()) is not None:
                yield message
        finally:
            self._followers.discard(follower)
