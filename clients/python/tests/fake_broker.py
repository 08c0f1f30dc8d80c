"""A scripted broker with a machine; the test decides what it publishes, accepts and acknowledges."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[3]
TABLE: dict[str, Any] = json.loads((ROOT / "tests/transcripts/handshake.json").read_text())
"""The transcripts, with the members that messages of the machine have."""
MACHINE = "tandem/v1/mill-1/"
PRESENCE = "handler/cell/presence"
CONNACK, PUBLISH, PUBACK, SUBSCRIBE, SUBACK, PINGREQ, PINGRESP = 0x20, 3, 0x40, 8, 0x90, 12, 0xD0
CONNECT, DISCONNECT = 1, 14
HAS_WILL = 4


def message(topic: str, members: dict[str, Any]) -> dict[str, Any]:
    """Return a message of the machine with these members; the table has the other ones."""
    levels = ["+" if at in (1, 3) and level != "pending" else level for at, level in enumerate(topic.split("/"))]
    pattern = topic if topic in TABLE["messages"] else "/".join(levels)
    whole = {**TABLE["messages"][pattern], **members}
    if "outputs" in whole:
        whole["outputs"] = [{**TABLE["output"], **output} for output in whole["outputs"]]
    return whole


class FakeBroker:
    """Accepts connections, keeps retained messages, and answers for a machine that is online."""

    def __init__(self, *, acknowledges: bool = True, accepts: bool = True) -> None:
        self.acknowledges = acknowledges
        self.accepts = accepts
        """The machine accepts a handler as soon as it registers."""
        self.is_down = False
        """New connections are closed at once."""
        self.is_connected = asyncio.Event()
        """A client has connected."""
        self.goodbyes = 0
        self.heard: list[tuple[str, dict[str, Any]]] = []
        """Received messages: topic below the machine, payload."""
        self._has_heard = asyncio.Event()
        self.will: dict[str, Any] | None = None
        """Last will of the newest connection."""
        self.instance: str | None = None
        """Instance of the handler that has published a presence."""
        self.port = 0
        self._retained = {topic: message(topic, {}) for topic in ("birth", "presence")}
        self._lines: set[asyncio.StreamWriter] = set()

    @property
    def address(self) -> str:
        """Its machine."""
        return f"mqtt://127.0.0.1:{self.port}/mill-1"

    @contextlib.asynccontextmanager
    async def open(self) -> AsyncIterator[FakeBroker]:
        """Listen within the block."""
        server = await asyncio.start_server(self._serve, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        try:
            yield self
        finally:
            server.close()
            self.cut()

    def publish(self, topic: str, members: dict[str, Any]) -> None:
        """Publish a message of the machine; states stay for later connections."""
        whole = message(topic, members)
        if whole.get("instance") == "$instance":
            whole["instance"] = self.instance
        if topic in self._retained or topic.endswith("/pending"):
            self._retained[topic] = whole
        for line in self._lines:
            _publish(line, topic, whole)

    def accept(self) -> None:
        """Publish that the machine has accepted the registered handler."""
        self.publish("handler/cell/result", {})

    async def until_heard(self, topic: str, count: int) -> None:
        """Wait until as many messages have arrived on a topic."""
        while self.topics.count(topic) < count:
            self._has_heard.clear()
            await self._has_heard.wait()

    @property
    def topics(self) -> list[str]:
        """Topics of the received messages."""
        return [topic for topic, _ in self.heard]

    def cut(self) -> None:
        """Break all connections; the broker publishes the last will."""
        if self.will is not None:
            self._retained[PRESENCE] = self.will
        for line in self._lines:
            line.close()

    async def _serve(self, reader: asyncio.StreamReader, line: asyncio.StreamWriter) -> None:
        if not self.is_down:
            with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
                while True:
                    (head,) = await reader.readexactly(1)
                    self._answer(line, head, await reader.readexactly(await _length(reader)))
        self._lines.discard(line)
        line.close()

    def _answer(self, line: asyncio.StreamWriter, head: int, body: bytes) -> None:
        kind = head >> 4
        if kind == CONNECT:
            self.is_connected.set()
            _name, _client_id, *will = _texts(body, [0, 4, 0, 0] if body[7] & HAS_WILL else [0, 4])
            self.will = json.loads(will[1]) if will else None
            line.write(bytes([CONNACK, 2, 0, 0]))
        elif kind == DISCONNECT:
            self.goodbyes += 1
        elif kind == PINGREQ:
            line.write(bytes([PINGRESP, 0]))
        elif kind == SUBSCRIBE:
            count = sum(1 for _ in _filters(body[2:]))
            line.write(bytes([SUBACK, 2 + count]) + body[:2] + bytes([1] * count))
            self._lines.add(line)
            for topic, retained in self._retained.items():
                _publish(line, topic, retained, retain=True)
        elif kind == PUBLISH:
            end = 2 + int.from_bytes(body[:2], "big")
            topic = body[2:end].decode().removeprefix(MACHINE)
            payload = json.loads(body[end + 2 :])
            if self.acknowledges:
                line.write(bytes([PUBACK, 2]) + body[end : end + 2])
            if topic == PRESENCE:
                self._on_presence(payload)
            self.heard.append((topic, payload))
            self._has_heard.set()

    def _on_presence(self, presence: dict[str, Any]) -> None:
        self.instance = presence["instance"]
        self._retained[PRESENCE] = presence
        for line in self._lines:
            _publish(line, PRESENCE, presence)
        if presence["online"] and self.accepts:
            self.accept()


def _publish(line: asyncio.StreamWriter, topic: str, message: dict[str, Any], *, retain: bool = False) -> None:
    path, payload = f"{MACHINE}{topic}".encode(), json.dumps(message).encode()
    body = len(path).to_bytes(2, "big") + path + payload
    line.write(bytes([PUBLISH << 4 | retain, len(body) % 128 | 128, len(body) // 128]) + body)


async def _length(reader: asyncio.StreamReader) -> int:
    length, shift = 0, 0
    while True:
        (byte,) = await reader.readexactly(1)
        length |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return length


def _texts(body: bytes, gaps: list[int]) -> Iterator[str]:
    """Yield texts with their length in front, each after as many other bytes as its gap."""
    at = 0
    for gap in gaps:
        begin = at + gap + 2
        at = begin + int.from_bytes(body[begin - 2 : begin], "big")
        yield body[begin:at].decode()


def _filters(body: bytes) -> Iterator[bytes]:
    at = 0
    while at < len(body):
        end = at + 2 + int.from_bytes(body[at : at + 2], "big")
        yield body[at + 2 : end]
        at = end + 1
