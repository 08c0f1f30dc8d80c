"""Resident memory of a machine whose program runs, while sockets of HMIs connect, read, and end again and again.

``sockets.py SECONDS``, run by tests/soak/run: API is the REST interface of the machine, MACHINE its process id. In the last
quarter of the time, memory stays within 1 MiB. The first quarters fill histories and queues of fixed size.
"""

from __future__ import annotations

import asyncio
import base64
import dataclasses
import json
import os
import pathlib
import random
import sys
import time
import urllib.parse
import urllib.request

API = os.environ["API"]
MACHINE = int(os.environ["MACHINE"])
SEED = int(os.environ.get("SOAK_SEED", "46"))

# Sockets that are connected at the same time, as a shop with some panels and pages.
SOCKETS = 12
# Shortest and longest time for which a socket stays connected, s.
CONNECTED_S = (0.5, 5.0)
# Time between two readings of the memory, s.
READING_S = 1.0
# Largest difference between two readings in the last quarter, MiB.
RANGE_MAX_MIB = 1.0
# Time limit of each answer, s. Reason: the computer may be busy with other work.
PATIENCE_S = 120.0

# Pause after a lost connection, s.
RETRY_S = 1.0

# Topics of the HMI: of the machine, of its inputs and outputs, and of its coordinate system.
TOPICS = ["birth", "presence", "heartbeat", "alarm/active", "variables", "tools", "stored_data", "io/#", "cs/1/#"]

# A minute of motion without an M code.
PROGRAM = "G90 F6000\nL1 = 0\nwhile (L1 < 150) {\nL1 = L1 + 1\nG01 X20 Y10\nX0 Y0\n}\nM30\n"


def request(method: str, path: str, body: bytes | None = None, kind: str = "application/json") -> bytes:
    """Sends a request and returns the body of its answer; raises if the answer is no success."""
    headers = {"Content-Type": kind}
    with urllib.request.urlopen(urllib.request.Request(f"{API}/{path}", body, headers, method=method), timeout=PATIENCE_S) as answer:
        return bytes(answer.read())


def resident_mib() -> float:
    """Returns the resident memory of the machine."""
    pages = pathlib.Path(f"/proc/{MACHINE}/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE") / (1 << 20)


# Kinds of WebSocket frames (RFC 6455), each as a whole message.
TEXT, CLOSE, PING, PONG = 0x81, 0x88, 0x89, 0x8A


def frame(kind: int, data: bytes) -> bytes:
    """Returns a frame of a client, which has a mask."""
    mask = random.randbytes(4)
    size = bytes([0x80 | len(data)]) if len(data) < 126 else bytes([0x80 | 126]) + len(data).to_bytes(2, "big")
    return bytes([kind]) + size + mask + bytes(byte ^ mask[at % 4] for at, byte in enumerate(data))


async def read_message(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> dict[str, object]:
    """Returns the next message, and answers the pings before it."""
    while True:
        kind, size = await reader.readexactly(2)
        if size > 125:
            size = int.from_bytes(await reader.readexactly(2 if size == 126 else 8), "big")
        data = await reader.readexactly(size)
        if kind == PING:
            writer.write(frame(PONG, data))
        else:
            assert kind == TEXT, (kind, data)
            return dict(json.loads(data))


async def connect() -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    """Opens a WebSocket and subscribes to the topics of the HMI."""
    address = urllib.parse.urlparse(API)
    reader, writer = await asyncio.open_connection(address.hostname, address.port)
    key = base64.b64encode(random.randbytes(16)).decode()
    lines = [f"GET {address.path}/ws HTTP/1.1", f"Host: {address.netloc}", "Upgrade: websocket", "Connection: Upgrade"]
    lines += [f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13"]
    writer.write(("\r\n".join(lines) + "\r\n\r\n").encode())
    header = await reader.readuntil(b"\r\n\r\n")
    assert header.startswith(b"HTTP/1.1 101 "), header
    writer.write(frame(TEXT, json.dumps({"subscribe": TOPICS}).encode()))
    await writer.drain()
    return reader, writer


async def use_socket(until_s: float) -> int:
    """Connects a socket, reads for a random time, and ends it with or without a goodbye. Returns the number of messages."""
    reader, writer = await asyncio.wait_for(connect(), PATIENCE_S)
    end_s = min(time.monotonic() + random.uniform(*CONNECTED_S), until_s)
    received = 0
    try:
        while received == 0 or time.monotonic() < end_s:
            message = await asyncio.wait_for(read_message(reader, writer), PATIENCE_S)
            assert "error" not in message, message
            received += 1
        if random.random() < 0.5:
            writer.write(frame(CLOSE, b""))
            await writer.drain()
    finally:
        writer.transport.abort()
    return received


@dataclasses.dataclass
class Counts:
    """Number of sockets that have received messages, of these messages, and of sockets that the machine or its load ended."""

    sockets: int = 0
    messages: int = 0
    lost: int = 0


async def reconnect(until_s: float, counts: Counts) -> None:
    """Replaces a socket by the next one until the time is over. After a lost connection it waits, as the HMI does."""
    while time.monotonic() < until_s:
        try:
            counts.messages += await use_socket(until_s)
            counts.sockets += 1
        except (OSError, EOFError, TimeoutError):
            counts.lost += 1
            await asyncio.sleep(RETRY_S)


async def keep_running(until_s: float) -> None:
    """Starts the program again whenever it has ended."""
    while time.monotonic() < until_s:
        state = json.loads(await asyncio.to_thread(request, "GET", "cs/1/state"))
        if state["execution"] in ("READY", "PROGRAM_COMPLETED"):
            await asyncio.to_thread(request, "POST", "cs/1/start?wait=1", b"{}")
        elif state["reason"] == "SERVO_LATE":
            # another load of the computer has held the motion
            await asyncio.to_thread(request, "POST", "cs/1/resume?wait=1", b"{}")
        else:
            assert state["execution"] == "ACTIVE", state
        await asyncio.sleep(1)


async def measure(until_s: float, readings: list[tuple[float, float]]) -> None:
    """Reads the memory until the time is over."""
    begun_s = time.monotonic()
    while time.monotonic() < until_s:
        readings.append((time.monotonic() - begun_s, resident_mib()))
        await asyncio.sleep(READING_S)


def mean(readings: list[tuple[float, float]]) -> float:
    """Returns the mean of the memory, MiB."""
    return sum(mib for _, mib in readings) / len(readings)


def report(seconds: float, readings: list[tuple[float, float]], counts: Counts) -> None:
    """Prints the memory by quarters; fails if that of the last quarter differs by more than the limit."""
    print(f"{counts.sockets} sockets, {counts.messages} messages, {counts.lost} lost in {seconds:.0f} s, seed {SEED}")
    assert counts.sockets > SOCKETS and counts.lost < counts.sockets, counts
    for quarter in range(4):
        low_s, high_s = seconds * quarter / 4, seconds * (quarter + 1) / 4
        part = [reading for reading in readings if low_s <= reading[0] < high_s]
        sizes = [mib for _, mib in part]
        print(f"quarter {quarter + 1}: {min(sizes):.2f} to {max(sizes):.2f} MiB, mean {mean(part):.2f} MiB")
    differs = max(sizes) - min(sizes)
    assert differs <= RANGE_MAX_MIB, f"memory differs by {differs:.2f} MiB in the last quarter, at most {RANGE_MAX_MIB} MiB"


async def main(seconds: float) -> None:
    random.seed(SEED)
    request("PUT", "programs/4600", PROGRAM.encode(), "text/plain")
    request("POST", "cs/1/load?wait=1", b'{"program": 4600}')
    until_s = time.monotonic() + seconds
    readings: list[tuple[float, float]] = []
    counts = Counts()
    async with asyncio.TaskGroup() as tasks:
        tasks.create_task(keep_running(until_s))
        tasks.create_task(measure(until_s, readings))
        for _ in range(SOCKETS):
            tasks.create_task(reconnect(until_s, counts))
    report(seconds, readings, counts)


asyncio.run(main(float(sys.argv[1])))
