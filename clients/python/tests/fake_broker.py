"""A scripted broker with an online machine; the test decides whether messages are acknowledged."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[3]
MACHINE = "tandem/v1/mill-1/"
CONNACK, PUBLISH, PUBACK, SUBSCRIBE, SUBACK, PINGREQ, PINGRESP = 0x20, 3, 0x40, 8, 0x90, 12, 0xD0
CONNECT, DISCONNECT = 1, 14


def example(address: str) -> dict[str, Any]:
    """Return the contract's example of a message."""
    document = json.loads((ROOT / "runtime/gateway/api/asyncapi.json").read_text())
    for channel in document["channels"].values():
        if channel["address"] == f"tandem/v1/{{machine}}/{address}":
            (message,) = channel["messages"].values()
            payload: dict[str, Any] = message["examples"][0]["payload"]
            return payload
    raise AssertionError(address)


class FakeBroker:
    """Accepts connections, and publishes to each that the machine is online."""

    def __init__(self, *, acknowledges: bool, accepts: bool, expires_ms: int = 30_000) -> None:
        self.acknowledges = acknowledges
        self.accepts = accepts
        """The machine accepts a handler as soon as it registers."""
        self.expires_ms = expires_ms
        """Validity of the machine's presence, which is not repeated automatically."""
        self.is_connected = asyncio.Event()
        """A client has connected."""
        self.goodbyes = 0
        self.heard: list[str] = []
        """Topics of received messages, below the machine."""
        self._has_heard = asyncio.Event()
        self.has_come = asyncio.Event()
        """A handler has published its presence."""
        self.port = 0
        self._instance: str | None = None
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
            for line in self._lines:
                line.close()

    def accept(self) -> None:
        """Publish that the machine has accepted the registered handler."""
        result = {**example("handler/{id}/result"), "instance": self._instance}
        for line in self._lines:
            self._publish(line, "handler/cell/result", result)

    def say_presence(self) -> None:
        """Publish that the machine is online."""
        for line in self._lines:
            self._publish(line, "presence", {**example("presence"), "expires_ms": self.expires_ms})

    def issue_output(self, m: int) -> None:
        """Publish a pending M code that no handler has claimed."""
        pending = example("cs/{cs}/m_code/pending")
        nobody = dict.fromkeys(("handler_id", "instance", "progress", "question"))
        output = {**pending["outputs"][0], "m": m, "state": "OUTPUT", **nobody}
        for line in self._lines:
            self._publish(line, "cs/1/m_code/pending", {**pending, "outputs": [output]})

    async def until_heard(self, topic: str) -> None:
        """Wait until a message has arrived on a topic."""
        while topic not in self.heard:
            self._has_heard.clear()
            await self._has_heard.wait()

    def cut(self) -> None:
        """Break all connections."""
        for line in self._lines:
            line.close()

    async def _serve(self, reader: asyncio.StreamReader, line: asyncio.StreamWriter) -> None:
        self._lines.add(line)
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
            line.write(bytes([CONNACK, 2, 0, 0]))
        elif kind == DISCONNECT:
            self.goodbyes += 1
        elif kind == PINGREQ:
            line.write(bytes([PINGRESP, 0]))
        elif kind == SUBSCRIBE:
            count = sum(1 for _ in _filters(body[2:]))
            line.write(bytes([SUBACK, 2 + count]) + body[:2] + bytes([1] * count))
            self._publish(line, "birth", example("birth"))
            self.say_presence()
        elif kind == PUBLISH:
            end = 2 + int.from_bytes(body[:2], "big")
            topic = body[2:end].decode().removeprefix(MACHINE)
            self.heard.append(topic)
            self._has_heard.set()
            if self.acknowledges:
                line.write(bytes([PUBACK, 2]) + body[end : end + 2])
            if topic == "handler/cell/presence":
                self._on_presence(json.loads(body[end + 2 :]))

    def _on_presence(self, presence: dict[str, Any]) -> None:
        if presence["online"]:
            self._instance = presence["instance"]
            self.has_come.set()
            if self.accepts:
                self.accept()

    def _publish(self, line: asyncio.StreamWriter, topic: str, message: dict[str, Any]) -> None:
        path, payload = f"{MACHINE}{topic}".encode(), json.dumps(message).encode()
        body = len(path).to_bytes(2, "big") + path + payload
        line.write(bytes([PUBLISH << 4]) + bytes([len(body) % 128 | 128, len(body) // 128]) + body)


async def _length(reader: asyncio.StreamReader) -> int:
    length, shift = 0, 0
    while True:
        (byte,) = await reader.readexactly(1)
        length |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            return length


def _filters(body: bytes) -> Iterator[bytes]:
    at = 0
    while at < len(body):
        end = at + 2 + int.from_bytes(body[at : at + 2], "big")
        yield body[at + 2 : end]
        at = end + 1
