"""A sequence program: handlers by M code, and its alarms, locks and tasks."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import json
import signal
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from .alarms import ALARMS_MAX, UserAlarm
from .connection import PRESENT_TIMEOUT_S, Connection, Credentials
from .errors import ProgramError
from .levels import lock_level, lock_target
from .m_code_declaration import MCodeDeclaration, Param
from .messages import Params, Redelivery
from .output import Output
from .plc import Plc
from .runner import RETURNS_WITHIN_S, Runner, check_returns_within

M_CODE_MAX = 191
RUNTIME_M_CODES = frozenset({0, 1, 2, 30, 98, 99})
"""M codes that the runtime handles itself; they never reach a handler."""

Handler = Callable[[Output], Awaitable[None]] | Callable[[Output, Plc], Awaitable[None]]
"""``async def handler(output)`` or ``async def handler(output, plc)``."""

Check = Callable[[Params], object]
"""Raises :class:`~tandem_plc.Alarm` for invalid parameters; its return value is ignored."""

H = TypeVar("H", bound=Handler)
C = TypeVar("C", bound=Check)
Task = Callable[[Plc], Awaitable[None]]
T = TypeVar("T", bound=Task)


@dataclass(frozen=True)
class RegisteredHandler:
    """A handler of the table."""

    call: Callable[[Output, Plc], Awaitable[None]]
    redelivery: Redelivery | None
    declared: MCodeDeclaration


class Level:
    """A source of an interlock or start lock that belongs to the program."""

    def __init__(self, place: tuple[int, str, str], text: str, value: bool) -> None:
        self.place = place
        self.text = text
        self.value = value
        self._changed: Callable[[Level], None] = lambda _level: None

    def set(self, value: bool, text: str | None = None) -> None:
        """Set the level. It is sent once the machine is connected, and again on each connection and at each boot."""
        self.value = value
        if text is not None:
            self.text = text
        self._changed(self)

    def follow(self, changed: Callable[[Level], None]) -> None:
        """Call ``changed`` with the current level and each later level."""
        self._changed = changed
        changed(self)


class SequenceProgram:
    """A sequence program: serves M codes of a machine under one name.

    ::

        program = SequenceProgram("changer")

        @program.on(6)
        async def change_tool(output: Output, plc: Plc) -> None:
            ...

        asyncio.run(program.run("mqtt://127.0.0.1:1883/mill-1"))

    If a handler returns, its output is reset and the NC program continues. If it raises :class:`~tandem_plc.Alarm`, the
    NC program stops with the text of the alarm; any other exception also stops it with an alarm.
    """

    def __init__(self, handler_id: str, *, redelivery: Redelivery | None = None) -> None:
        """Create a program under a name: 1 to 64 characters without ``/ + #``.

        Args:
            handler_id: the name, always the same, so that the machine recognizes the program.
            redelivery: treatment of outputs on which this program may have worked before it was lost, unless :meth:`on`
            sets it. The stricter of this and the machine's configuration applies; without both, an operator decides.
        """
        if not 1 <= len(handler_id) <= 64 or any(char in handler_id for char in "/+#\0"):
            raise ProgramError(f"handler_id {handler_id!r}: write 1 to 64 characters without / + #")
        self.handler_id = handler_id
        self.redelivery = redelivery
        self.handlers: dict[tuple[int | None, int], RegisteredHandler] = {}
        self.checks: dict[tuple[int | None, int], Check] = {}
        self._alarms: dict[int, UserAlarm] = {}
        self._levels: list[Level] = []
        self._tasks: list[Task] = []

    # --- declarations

    def on(
        self,
        *codes: int | Iterable[int],
        cs: int | None = None,
        validate: Check | None = None,
        redelivery: Redelivery | None = None,
        name: str | None = None,
        params: Mapping[str, Param] | None = None,
    ) -> Callable[[H], H]:
        """Register a handler, as a decorator.

        Args:
            codes: M numbers, and ranges such as ``range(20, 30)``.
            cs: the coordinate system; ``None``: all that have no separate handler for the M code.
            validate: checks parameters when an NC program is loaded; if it raises ``Alarm``, the program is not loaded.
            redelivery: treatment of outputs on which this program may have worked before it was lost, instead of the
            setting of the program.
            name: function of the M codes, such as ``"clamp"``, for alarms and panels.
            params: their parameters, by letter: ``{"A": Param(name="force", unit="kN", min=1, max=20)}``. A program
            with other parameters is not loaded, and the handler is not started with them. ``{}``: no parameters.

        Raises:
            ProgramError: two handlers for one M code, an invalid declaration, or a handler that is not an async
                function of ``(output)`` or ``(output, plc)``.
        """

        def register(handler: H) -> H:
            entry = RegisteredHandler(
                _two_arguments(handler), redelivery or self.redelivery, MCodeDeclaration(name, params)
            )
            for m in _numbers(codes):
                if (cs, m) in self.handlers:
                    raise ProgramError(f"M{m}{_of(cs)} has two handlers")
                self.handlers[cs, m] = entry
                if validate is not None:
                    self._add_check(cs, m, validate)
            return handler

        return register

    def validate(self, *codes: int | Iterable[int], cs: int | None = None) -> Callable[[C], C]:
        """Register a check of parameters, as a decorator; it runs when a program is loaded.

        Raises:
            ProgramError: two checks for one M code.
        """

        def register(check: C) -> C:
            for m in _numbers(codes):
                self._add_check(cs, m, check)
            return check

        return register

    def _add_check(self, cs: int | None, m: int, check: Check) -> None:
        if (cs, m) in self.checks:
            raise ProgramError(f"M{m}{_of(cs)} is validated twice")
        self.checks[cs, m] = check

    def alarms(self, *alarms: UserAlarm) -> None:
        """Declare remedies and translations of alarms; the machine shows them when an alarm is raised.

        ``[alarm.N]`` of the machine's configuration takes precedence.

        Raises:
            ProgramError: two different alarms have one code, or there are more than 256.
        """
        for alarm in alarms:
            other = self._alarms.setdefault(alarm.code, alarm)
            if other != alarm:
                raise ProgramError(f"alarm {alarm.code} has two texts: {other.text!r} and {alarm.text!r}")
        if len(self._alarms) > ALARMS_MAX:
            raise ProgramError(f"{len(self._alarms)} alarms: write up to {ALARMS_MAX}")

    def interlock(self, cs: int, source: str, text: str, *, value: bool = True) -> Level:
        """Own a source of the interlock, which holds motion, such as a door or the air pressure.

        Args:
            cs: coordinate system.
            source: name of the source, such as one that ``[input.interlock.source.NAME]`` declares.
            text: the reason for the operator.
            value: the level until the program sets it; on by default.
        """
        return self._add_level(Level((cs, "interlock", source), text, value))

    def start_lock(self, cs: int, source: str, text: str, *, value: bool = True) -> Level:
        """Own a source of the start lock, which refuses starts; as :meth:`interlock`."""
        return self._add_level(Level((cs, "start_lock", source), text, value))

    def _add_level(self, level: Level) -> Level:
        if any(other.place == level.place for other in self._levels):
            cs, kind, source = level.place
            raise ProgramError(f"{kind} {source} of coordinate system {cs} is declared twice")
        self._levels.append(level)
        return level

    def task(self, task: T) -> T:
        """Register a task that runs in parallel to the handlers, as a decorator.

        The task begins after the machine has accepted the handlers, so that the task may start a program. It continues
        after losses of the connection. If it raises, the program ends with that exception.
        """
        _check_async(task, 1, "(plc)")
        self._tasks.append(task)
        return task

    def served(self) -> str:
        """Return the declarations of the program as a file for ``[machine] served`` of a configuration.

        With this file ``tandem check``, ``tandem explain`` and editors know the M codes while the program does not run:
        ``Path("served.json").write_text(program.served())``
        """
        serves = []
        for (cs, m), entry in sorted(self.handlers.items(), key=lambda item: (item[0][1], item[0][0] or 0)):
            said = {**entry.declared.to_json(m, None), "cs": [] if cs is None else [cs], "handler_id": self.handler_id}
            serves.append(said)
        return json.dumps({"serves": serves}, indent=2) + "\n"

    # --- running

    async def run(self, address: str, *, credentials: Credentials | None = None, take_over: bool = False) -> None:
        """Serve the machine at an address, across all losses of the connection, until this is cancelled.

        Args:
            address: as :meth:`tandem_plc.Plc.connect` takes it.
            credentials: user, password and TLS, which an address should not contain.
            take_over: replace another process of the same name, which ends; otherwise this process is refused.

        Raises:
            TakenOver: another process of the same name is online, or has replaced this process.
            AddressError: the address is invalid.
            ConnectError: no machine is online within 10 s, or the broker refuses this client.
            ProgramError: the program has a mistake.
            ExceptionGroup: a task has ended with an exception; on Python 3.10 the exception itself.
        """
        async with self.serving(address, credentials=credentials, take_over=take_over) as serving:
            await serving.ended

    async def run_until(
        self,
        address: str,
        stop: Awaitable[object],
        *,
        credentials: Credentials | None = None,
        take_over: bool = False,
        returns_within_s: float = RETURNS_WITHIN_S,
        ends_within_s: float | None = None,
    ) -> None:
        """Serve like :meth:`run` until ``stop`` completes, without losing work: see :meth:`Serving.leave`.

        ``asyncio.run(program.run_until("mqtt://127.0.0.1:1883/mill-1", stop_signal()))``

        Args:
            address: as :meth:`tandem_plc.Plc.connect` takes it.
            stop: an awaitable, such as :func:`tandem_plc.stop_signal`.
            credentials: user, password and TLS.
            take_over: as of :meth:`run`.
            returns_within_s: as of :meth:`Serving.leave`.
            ends_within_s: as of :meth:`Serving.leave`.

        Raises:
            Exception: any exception of ``stop`` or :meth:`run`.
        """
        stopped: asyncio.Future[Any] = asyncio.ensure_future(stop)
        try:
            check_returns_within(returns_within_s)
            async with self.serving(address, credentials=credentials, take_over=take_over) as serving:
                await asyncio.wait({stopped, serving.ended}, return_when=asyncio.FIRST_COMPLETED)
                if stopped.done():
                    stopped.result()
                await serving.leave(returns_within_s=returns_within_s, ends_within_s=ends_within_s)
        finally:
            stopped.cancel()

    @contextlib.asynccontextmanager
    async def serving(
        self,
        address: str,
        *,
        credentials: Credentials | None = None,
        take_over: bool = False,
        timeout_s: float = PRESENT_TIMEOUT_S,
    ) -> AsyncIterator[Serving]:
        """Serve the machine within the block, which begins when the handlers are accepted. Raises like :meth:`run`.

        If the machine refuses the handlers, the block begins as well, and :attr:`Serving.ended` contains the reason.
        """
        self._check()
        connection = Connection(address, credentials, self.handler_id)
        plc = Plc(connection)
        runner = Runner(
            self.handler_id,
            self.handlers,
            self.checks,
            list(self._alarms.values()),
            connection,
            plc,
            take_over=take_over,
        )
        jobs: list[asyncio.Future[Any]] = []
        try:
            for level in self._levels:
                level.follow(
                    lambda level: plc._levels.want(
                        lock_target(*level.place), lock_level(level.value, level.text, level.place[2])
                    )
                )
            await connection.start(timeout_s)
            jobs.append(asyncio.ensure_future(runner.run()))
            jobs.append(asyncio.ensure_future(plc._levels.keep_written()))
            announced = asyncio.ensure_future(runner.announced.wait())
            await asyncio.wait({announced, *jobs}, return_when=asyncio.FIRST_COMPLETED)
            announced.cancel()
            if runner.announced.is_set():
                jobs.extend(asyncio.ensure_future(_forever(task, plc)) for task in self._tasks)
            yield Serving(plc, asyncio.ensure_future(_first_failure(jobs)), runner)
        finally:
            for job in jobs:
                job.cancel()
            await asyncio.gather(*jobs, return_exceptions=True)
            await runner.leave()
            await connection.stop()

    def _check(self) -> None:
        for cs, m in self.checks:
            is_served = any(number == m and (cs is None or other in (None, cs)) for other, number in self.handlers)
            if not is_served:
                raise ProgramError(f"M{m}{_of(cs)} is validated and has no handler")


@dataclass(frozen=True)
class Serving:
    """A program that serves a machine."""

    plc: Plc
    """The machine."""
    ended: asyncio.Future[None]
    """Ends when a task of the program fails, or the machine refuses the program."""
    _runner: Runner = field(repr=False)

    async def leave(self, *, returns_within_s: float = RETURNS_WITHIN_S, ends_within_s: float | None = None) -> None:
        """Accept no further output, and return when all running handlers have ended; then end the block.

        Tasks run until then. At the end of the block the machine is notified that the program will return. Until the
        return its M codes are treated as served, and NC programs wait at them.

        Args:
            returns_within_s: time within which the program returns, up to 1 h. 0: it does not return.
            ends_within_s: time limit for running handlers, none with ``None``. After it, running handlers are cancelled
            and their outputs are lost: ``redelivery`` decides how they are treated.

        Raises:
            ProgramError: ``returns_within_s`` is not a valid time.
            Exception: the error that ended the program in the meantime.
        """
        self._runner.returns_within_ms = check_returns_within(returns_within_s)
        finishing = asyncio.ensure_future(self._runner.finish(ends_within_s))
        try:
            await asyncio.wait({finishing, self.ended}, return_when=asyncio.FIRST_COMPLETED)
            if self.ended.done():
                self.ended.result()
        finally:
            finishing.cancel()


async def stop_signal() -> None:
    """Wait for Ctrl-C, or for SIGTERM, by which systemd ends a program. The next signal ends it at once."""
    loop, told = asyncio.get_running_loop(), asyncio.Event()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    for number in before:
        signal.signal(number, lambda _number, _frame: loop.call_soon_threadsafe(told.set))
    try:
        await told.wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


async def _first_failure(jobs: list[asyncio.Future[Any]]) -> None:
    done, _ = await asyncio.wait(jobs, return_when=asyncio.FIRST_EXCEPTION)
    for job in done:
        job.result()


async def _forever(task: Task, plc: Plc) -> None:
    await task(plc)
    await asyncio.get_running_loop().create_future()


def _of(cs: int | None) -> str:
    return "" if cs is None else f" in coordinate system {cs}"


def _numbers(codes: tuple[int | Iterable[int], ...]) -> list[int]:
    numbers: list[int] = []
    for code in codes:
        for m in [code] if isinstance(code, int) else code:
            if isinstance(m, bool) or not isinstance(m, int) or not 0 <= m <= M_CODE_MAX:
                raise ProgramError(f"M{m}: M codes are 0 to {M_CODE_MAX}")
            if m in RUNTIME_M_CODES:
                raise ProgramError(f"M{m}: the runtime handles this M code itself; remove it")
            numbers.append(m)
    if not numbers:
        raise ProgramError("no M code is named")
    return numbers


def _check_async(function: Any, most: int, arguments: str) -> int:
    name = getattr(function, "__name__", repr(function))
    is_async = inspect.iscoroutinefunction(function) or inspect.iscoroutinefunction(
        getattr(function, "__call__", None)  # noqa: B004
    )
    if not is_async:
        raise ProgramError(f"{name} is not async: write `async def {name}{arguments}`")
    places = [
        parameter
        for parameter in inspect.signature(function).parameters.values()
        if parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD)
        and parameter.default is parameter.empty
    ]
    if not 1 <= len(places) <= most:
        raise ProgramError(f"{name} takes {len(places)} arguments: write `async def {name}{arguments}`")
    return len(places)


def _two_arguments(handler: Any) -> Callable[[Output, Plc], Awaitable[None]]:
    count = _check_async(handler, 2, "(output) or (output, plc)")
    if count == 2:
        both: Callable[[Output, Plc], Awaitable[None]] = handler
        return both
    return lambda output, _plc: handler(output)
