"""A machine and its OPC UA server, as processes, for the tests."""

from __future__ import annotations

import asyncio
import json
import os
import re
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[3]
TANDEM = os.environ.get("TANDEM_BIN", str(ROOT / "target/debug/tandem"))
SERVER = os.environ["TANDEM_OPCUA_BIN"]
OWN = "https://github.com/tandem-nc/tandem/opcua"
CNC = "http://opcfoundation.org/UA/CNC"
MACHINE_TOOL = "http://opcfoundation.org/UA/MachineTool/"
MACHINERY = "http://opcfoundation.org/UA/Machinery/"
PATIENCE_S = 20.0
PROGRAM = """N10 G17 G90 G54
N20 G00 X5
N30 M20 VA3
N40 G01 X20 Y10 F1200
N50 M03 S3000
N60 M21
N70 G02 X30 Y20 R10 F900
N80 M22
N90 G01 X0 F600
N99 M30
"""
"""Number 7: it waits three times."""
IDENTIFICATION = """
[identification]
manufacturer = "Example Works"
serial_number = "4711"
product_instance_uri = "urn:example.com:mill:4711"
location = "hall 2"
"""


def free_port() -> int:
    """Return a free port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def wait_for_line(log: Path, pattern: str, process: subprocess.Popen[bytes]) -> str:
    """Wait for a pattern in the output of a process: its group."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        found = re.search(pattern, log.read_text())
        if found:
            return found.group(1)
        assert process.poll() is None, log.read_text() + log.with_suffix(".log").read_text()
        time.sleep(0.05)
    raise AssertionError(f"{pattern} is not in {log.read_text()}")


class Process:
    """A program that runs until it is ended."""

    def __init__(self, folder: Path, name: str, command: list[str]) -> None:
        self.out = folder / f"{name}.out"
        with self.out.open("wb") as out, self.out.with_suffix(".log").open("ab") as log:
            self.process = subprocess.Popen(command, stdout=out, stderr=log, cwd=folder)

    def line(self, pattern: str) -> str:
        """Wait for a line of its output."""
        return wait_for_line(self.out, pattern, self.process)

    def end(self) -> None:
        """End it in order."""
        self.process.terminate()
        try:
            self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise


class Machine:
    """The demo machine without its handlers: an M code is pending until an operator resets it."""

    def __init__(self, folder: Path, more: str = "") -> None:
        self.folder = folder
        self.http = free_port()
        self.mqtt = free_port()
        shutil.copytree(ROOT / "examples", folder / "examples", dirs_exist_ok=True)
        self.config = folder / "examples/config/demo.toml"
        with self.config.open("a") as config:
            config.write(IDENTIFICATION)
            config.write(f'\n[mqtt]\nlisten = "127.0.0.1:{self.mqtt}"\n\n[http]\nlisten = "127.0.0.1:{self.http}"\n{more}\n')
            config.writelines(f'[m_code.{m}]\nunhandled = "wait"\n' for m in (20, 21, 22))
        self.token: str | None = None
        self.process: Process | None = None

    def start(self) -> None:
        """Start it, or start it again."""
        command = [TANDEM, "serve", "--config", str(self.config)]
        self.process = Process(self.folder, "machine", command)
        self.process.line(r"(REST)")
        self.ask("PUT", "/programs/7", PROGRAM)

    def end(self) -> None:
        """End it."""
        if self.process:
            self.process.end()
            self.process = None

    def ask(self, method: str, path: str, body: Any = None, token: str | None = None) -> Any:
        """Send a request to the REST interface, and read its answer; a refusal is an HTTPError."""
        is_text = isinstance(body, str)
        data = None if body is None else (body if is_text else json.dumps(body)).encode()
        headers = {"Content-Type": "text/plain" if is_text else "application/json"}
        if token or self.token:
            headers["Authorization"] = f"Bearer {token or self.token}"
        url = f"http://127.0.0.1:{self.http}/api/v1{path}"
        request = urllib.request.Request(url, data, headers, method=method)
        try:
            with urllib.request.urlopen(request, timeout=10) as answer:
                said = answer.read()
        except urllib.error.HTTPError as error:
            error.add_note(error.read().decode())
            raise
        return json.loads(said) if said else None

    def get(self, path: str) -> Any:
        """Read something."""
        return self.ask("GET", path)

    def user(self, name: str, role: str) -> str:
        """Make a user: its token."""
        command = [TANDEM, "token", name, "--role", role, "--file", str(self.folder / "examples/config/tokens.toml")]
        said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        return said.split("token: ")[1].split()[0]

    def command(self, cs: int, verb: str, **arguments: Any) -> Any:
        """Command a coordinate system, and wait for the effect."""
        return self.ask("POST", f"/cs/{cs}/{verb}?wait=1", arguments)

    def until(self, execution: str, cs: int = 1) -> dict[str, Any]:
        """Wait for a state word."""
        return self.until_true(lambda: self.get(f"/cs/{cs}/state"), lambda state: state["execution"] == execution)

    @staticmethod
    def until_true(read: Callable[[], Any], holds: Callable[[Any], bool]) -> Any:
        """Read again until it holds."""
        end = time.monotonic() + PATIENCE_S
        while True:
            said = read()
            if holds(said):
                return said
            assert time.monotonic() < end, said
            time.sleep(0.05)

    def open_m_code(self, cs: int = 1) -> dict[str, Any]:
        """Wait for an open M code."""
        outputs = self.until_true(lambda: self.get(f"/cs/{cs}/m_codes")["outputs"], bool)
        first: dict[str, Any] = outputs[0]
        return first

    def claim_m_code(self, cs: int = 1) -> tuple[str, dict[str, str]]:
        """Claim the first open M code as the registered handler `clamp`: the path of the M code, and the identity of the claim."""
        presence = {"online": True, "handles": [{"cs": 1, "m": 20}], "instance": "1", "expires_ms": 60_000}
        self.ask("PUT", "/handlers/clamp", presence)
        path = f"/cs/{cs}/m_codes/{self.open_m_code(cs)['seq']}"
        said = {"boot_id": self.get(f"/cs/{cs}/m_codes")["boot_id"], "handler_id": "clamp", "instance": "1"}
        self.ask("POST", f"{path}/claim", said)
        return path, said

    def reset_m_code(self, cs: int = 1) -> int:
        """Reset the first open M code by hand."""
        output = self.open_m_code(cs)
        boot_id = self.get(f"/cs/{cs}/m_codes")["boot_id"]
        body = {"boot_id": boot_id, "handler_id": "test", "result": "ok", "force": True}
        self.ask("POST", f"/cs/{cs}/m_codes/{output['seq']}/reset", body)
        m: int = output["m"]
        return m


@contextmanager
def served(machine: Machine, transport: str = "http", options: tuple[str, ...] = (), user: str = "") -> Iterator[str]:
    """The OPC UA server of a machine: its address."""
    port = free_port()
    user = f"{user}@" if user else ""
    address = {
        "http": f"http://{user}127.0.0.1:{machine.http}",
        "mqtt": f"mqtt://{user}127.0.0.1:{machine.mqtt}/mill-1",
    }[transport]
    command = [SERVER, "--connect", address, "--listen", f"127.0.0.1:{port}", "--pki", str(machine.folder.parent / "pki"), *options]
    process = Process(machine.folder, "opcua", command)
    try:
        yield process.line(r"(opc\.tcp://\S+)")
    finally:
        process.end()


def in_loop(work: Any) -> Any:
    """Run a coroutine to its end; 60 s are the limit."""

    async def limited() -> Any:
        return await asyncio.wait_for(work, 60)

    return asyncio.run(limited())
