"""A simulated machine for tests: the command ``tandem`` as a process, on free ports, in a folder of its own."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from ..errors import RequestRefused
from ..program import SequenceProgram, Serving

DEFAULT_CONFIG = """
[machine]
name = "mill-1"

[[motor]]
number = 1
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0

[[motor]]
number = 2
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0

[[motor]]
number = 3
kind = "linear"
max_velocity = 500.0
max_acceleration = 5000.0

[[coordinate_system]]
number = 1
axes = { X = 1, Y = 2, Z = 3 }
max_feedrate = 30000.0
"""
"""X, Y and Z in one coordinate system, without a spindle."""

_FREE_PORTS = '\n[http]\nlisten = "127.0.0.1:0"\n\n[mqtt]\nlisten = "127.0.0.1:0"\n'
_START_TIMEOUT_S = 20.0
_POLL_S = 0.01
_JOURNAL_TIMEOUT_S = 5.0
_PROGRAM = 9_000
"""Number under which :meth:`Machine.run` stores its text."""


@dataclass(frozen=True)
class Run:
    """A run that has ended."""

    run_id: str
    execution: str
    """``PROGRAM_COMPLETED`` or ``STOPPED``."""
    reason: str | None
    alarms: list[str] = field(default_factory=list)
    """Texts of the alarms that are active at its end."""
    journal: list[dict[str, Any]] = field(default_factory=list)
    """Lines of the machine's journal since the start of the run."""

    @property
    def completed(self) -> bool:
        """True if the program has reached its end."""
        return self.execution == "PROGRAM_COMPLETED"

    def events(self, *events: str) -> list[dict[str, Any]]:
        """Return the lines of the journal with one of these events, such as ``output`` or ``reset``."""
        return [line for line in self.journal if line.get("event") in events]


def find_tandem() -> str:
    """Find the command: ``TANDEM_BIN``, or ``tandem`` in ``PATH``.

    Raises:
        FileNotFoundError: the command does not exist; the text has the remedy.
    """
    named = os.environ.get("TANDEM_BIN")
    found = named if named and os.access(named, os.X_OK) else None if named else shutil.which("tandem")
    if found is None:
        where = f"TANDEM_BIN names {named}, which is not a program" if named else "`tandem` is not in PATH"
        raise FileNotFoundError(f"{where}; install it, or set TANDEM_BIN to the built command")
    return os.path.abspath(found)


class Machine:
    """A running machine. Its methods block, so that a test is a plain function."""

    def __init__(self, config: str = DEFAULT_CONFIG) -> None:
        """Start ``tandem serve`` with a configuration, to which free ports are added if it names no ports.

        Raises:
            FileNotFoundError: the command ``tandem`` does not exist.
            RuntimeError: the command does not start; the text contains its output.
        """
        self._folder = Path(tempfile.mkdtemp(prefix="tandem-"))
        self._config = self._folder / "tandem.toml"
        self._config.write_text(config if "[mqtt]" in config or "[http]" in config else config + _FREE_PORTS)
        self.http = ""
        """``http://host:port``"""
        self.mqtt = ""
        """``mqtt://host:port/machine``, as :meth:`tandem_plc.SequenceProgram.run` takes it."""
        self._process: subprocess.Popen[str] | None = None
        self._reader: threading.Thread | None = None
        try:
            self.start()
        except BaseException:
            self.close()
            raise

    # --- life

    def start(self) -> None:
        """Start the process (again, after :meth:`kill`; free ports may differ then)."""
        with (self._folder / "log").open("w") as log:
            process = subprocess.Popen(
                [find_tandem(), "serve", "--config", str(self._config)],
                cwd=self._folder,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
            )
        self._process = process
        watchdog = threading.Timer(_START_TIMEOUT_S, process.kill)
        watchdog.start()
        try:
            self._read_addresses(process)
        finally:
            watchdog.cancel()

    def _read_addresses(self, process: subprocess.Popen[str]) -> None:
        if process.stdout is None:
            raise RuntimeError("tandem serve has no output")
        http, broker, machine = "", "", ""
        for line in process.stdout:
            words = line.split()
            if line.lstrip().startswith("REST"):
                http = next(word for word in words if word.startswith("http")).split("/api/")[0]
            elif line.lstrip().startswith("MQTT"):
                broker = next(word for word in words if word.startswith("mqtt"))
                topics = next(word for word in words if word.endswith("/#"))
                machine = topics.removesuffix("/#").replace("tandem/v1/", "")
            if http and broker:
                self.http, self.mqtt = http, f"{broker}/{machine}"
                self._reader = threading.Thread(target=_read_to_end, args=(process.stdout,), daemon=True)
                self._reader.start()
                return
        process.stdout.close()
        said = (self._folder / "log").read_text()
        raise RuntimeError(f"tandem serve has not started:\n{said}")

    def kill(self) -> None:
        """End the process at once, as a power cut does; its data stays."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
        if self._reader is not None:
            self._reader.join(5)

    def close(self) -> None:
        """End the machine, and delete its data."""
        if self._process is not None:
            self._process.send_signal(signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(5)
        self.kill()
        shutil.rmtree(self._folder, ignore_errors=True)

    # --- programs

    @contextlib.contextmanager
    def serve(self, program: SequenceProgram) -> Iterator[Serving]:
        """Serve a program in a thread within the block, which begins when the machine has accepted its handlers.

        Raises:
            Exception: the error that ended the program before the end of the block.
        """
        ready: list[Serving] = []
        failed: list[BaseException] = []
        news, loop = threading.Event(), asyncio.new_event_loop()

        async def until_cancelled() -> None:
            async with program.serving(self.mqtt) as serving:
                ready.append(serving)
                news.set()
                await serving.ended

        async def guarded() -> None:
            try:
                await until_cancelled()
            except asyncio.CancelledError:
                pass
            except BaseException as error:
                failed.append(error)
            finally:
                news.set()

        task = loop.create_task(guarded())
        thread = threading.Thread(target=loop.run_until_complete, args=(task,), daemon=True)
        thread.start()
        news.wait()
        try:
            if failed:
                raise failed[0]
            yield ready[0]
        finally:
            loop.call_soon_threadsafe(task.cancel)
            thread.join(timeout=15)
            if not thread.is_alive():
                loop.close()
        if failed:
            raise failed[0]

    def run(self, text: str, *, cs: int = 1, timeout_s: float = 60.0) -> Run:
        """Store NC text, load it, start it, and wait until it has ended.

        Raises:
            RequestRefused: the text has errors, or a handler refuses its parameters; the error contains the line.
            TimeoutError: it has not ended within the time limit; the text has the reason of the wait.
        """
        self.load(text, cs=cs)
        return self.started(cs=cs).end(timeout_s)

    def load(self, text: str, *, cs: int = 1) -> None:
        """Store NC text, and load it.

        Raises:
            RequestRefused: the text has errors, or a handler refuses its parameters; the error contains the line.
        """
        self.rest("PUT", f"/programs/{_PROGRAM + cs}", text)
        self.rest("POST", f"/cs/{cs}/load?wait=1", {"program": _PROGRAM + cs})

    def started(self, *, cs: int = 1) -> StartedRun:
        """Start the loaded program, and return while it runs.

        Raises:
            RequestRefused: the program may not start now.
        """
        before = max((line["n"] for line in self.journal()), default=0)
        reply = self.rest("POST", f"/cs/{cs}/start?wait=1")
        state = self.wait_for(lambda state: state["last_command_id"] == reply["command_id"], cs=cs)
        return StartedRun(self, cs, str(state["run_id"]), before)

    # --- actions and views of an operator

    def state(self, cs: int = 1) -> dict[str, Any]:
        """State of a coordinate system."""
        state: dict[str, Any] = self.rest("GET", f"/cs/{cs}/state")
        return state

    def wait_for(
        self, fits: Callable[[dict[str, Any]], bool], *, cs: int = 1, timeout_s: float = 20.0
    ) -> dict[str, Any]:
        """Wait for a state for which ``fits`` is true, and return it.

        Raises:
            TimeoutError: no such state arrived within the time limit; the text contains the last state.
        """
        end = time.monotonic() + timeout_s
        while True:
            state = self.state(cs)
            if fits(state):
                return state
            if time.monotonic() > end:
                raise TimeoutError(f"not within {timeout_s:g} s; the last state is {state}")
            time.sleep(_POLL_S)

    def answer(self, choice: str, *, cs: int = 1, timeout_s: float = 20.0) -> str:
        """Wait for a question, answer it, and return its text.

        Raises:
            TimeoutError: no question was asked within the time limit.
            RequestRefused: the answer is not among the choices.
        """
        state = self.wait_for(
            lambda state: bool((state["waiting_on"] or {}).get("question")), cs=cs, timeout_s=timeout_s
        )
        waiting = state["waiting_on"]
        question = waiting["question"]
        body = {"boot_id": state["boot_id"], "question_id": question["id"], "choice": choice}
        self.rest("POST", f"/cs/{cs}/m_codes/{waiting['seq']}/answer", body)
        return str(question["text"])

    def journal(self) -> list[dict[str, Any]]:
        """Return the machine's journal, up to its last 1000 lines."""
        lines: list[dict[str, Any]] = self.rest("GET", "/journal?count=1000")["lines"]
        return lines

    def rest(self, method: str, path: str, body: Any = None) -> Any:
        """Send a request below ``/api/v1``: a text unchanged, anything else as JSON; returns the JSON of the answer.

        Raises:
            RequestRefused: the machine refuses the request.
        """
        data, kind = None, "application/json"
        if isinstance(body, str):
            data, kind = body.encode(), "text/plain"
        elif body is not None:
            data = json.dumps(body).encode()
        request = urllib.request.Request(
            f"{self.http}/api/v1{path}", data=data, method=method, headers={"Content-Type": kind}
        )
        try:
            with urllib.request.urlopen(request, timeout=30) as answer:
                said = answer.read()
        except urllib.error.HTTPError as error:
            raise _refused(error.code, error.read()) from None
        return json.loads(said) if said else None


@dataclass(frozen=True)
class StartedRun:
    """A run that has started."""

    machine: Machine
    cs: int
    run_id: str
    after: int
    """Number of the journal's last line before its start."""

    def end(self, timeout_s: float = 60.0) -> Run:
        """Wait until the run has ended.

        Raises:
            TimeoutError: it has not ended within the time limit; the text has the last state.
        """
        state = self.machine.wait_for(
            lambda state: state["execution"] in ("PROGRAM_COMPLETED", "STOPPED") or state["run_id"] != self.run_id,
            cs=self.cs,
            timeout_s=timeout_s,
        )
        alarms = self.machine.rest("GET", "/alarms")["alarms"]
        texts = [alarm["text"] for alarm in alarms if alarm["severity"] == "alarm"]
        return Run(self.run_id, state["execution"], state["reason"], texts, self._journal())

    def _journal(self) -> list[dict[str, Any]]:
        """Lines of the run, to its end: the journal is written a little later than the state is published."""
        give_up = time.monotonic() + _JOURNAL_TIMEOUT_S
        while True:
            lines = [line for line in self.machine.journal() if line["n"] > self.after]
            has_end = any(line["event"] == "end" and line["cs"] == self.cs for line in lines)
            if has_end or time.monotonic() > give_up:
                return lines
            time.sleep(_POLL_S)


def _read_to_end(output: IO[str]) -> None:
    with output:
        while output.read(4_096):
            pass


def _refused(status: int, body: bytes) -> RequestRefused:
    try:
        problem = json.loads(body)
        code, text = str(problem["code"]), str(problem["detail"])
        found = [f"line {item['line']}: {item['code']} {item['message']}" for item in problem.get("diagnostics") or ()]
    except (ValueError, KeyError, TypeError):
        return RequestRefused(str(status), body.decode(errors="replace"))
    return RequestRefused(code, "; ".join([text, *found]))
