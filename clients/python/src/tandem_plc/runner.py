"""The loop of a sequence program: it receives messages of the machine, and starts handlers."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol

from .alarms import UserAlarm
from .connection import PRESENCE_EXPIRES_S, Connection
from .errors import (
    CODE_OF_ERROR,
    CODE_OF_EXCEPTION,
    Alarm,
    NoAnswer,
    NotConnected,
    ProgramError,
    RequestRefused,
    TakenOver,
    TandemError,
)
from .m_code_declaration import MCodeDeclaration
from .messages import (
    Birth,
    Cancel,
    CancelReason,
    HandlerPresence,
    HandlerResult,
    HandshakeResult,
    OutputState,
    Params,
    Pending,
    PendingOutput,
    Presence,
    Redelivery,
    Validate,
)
from .output import Output
from .topics import number_at
from .within import within

if TYPE_CHECKING:
    from .plc import Plc

log = logging.getLogger("tandem_plc")

_RETRY_S = 0.5
# largest number of remembered outputs; a stale `pending` is older by far fewer outputs
_BEGUN_MAX = 4096
_CLEAN_UP_S = 5.0
_REFUSALS_MAX = 10
"""Tries of 1 s, because a broker reports a dead process after one and a half times its keep-alive of 5 s."""
_INSTANCE_TRIES = 4
_LEAVE_MAX_S = 2.0
"""Time limit for the machine's confirmation that a stopping program accepts no further output."""
RETURNS_WITHIN_S = 60.0
_RETURNS_WITHIN_MAX_S = 3_600.0
_REFRESHES = 3
"""Number of presences within the validity of one, so that two may be lost."""

OutputId = tuple[str, int, int]
"""Boot, coordinate system and sequence number."""


class HandlerEntry(Protocol):
    """A handler of the table."""

    @property
    def call(self) -> Callable[[Output, Plc], Awaitable[None]]:
        """Do the work."""

    @property
    def redelivery(self) -> Redelivery | None:
        """Treatment of work that may already have begun; ``None``: the machine's configuration applies."""

    @property
    def declared(self) -> MCodeDeclaration:
        """Declaration of the M codes."""


def check_returns_within(seconds: float) -> int:
    """Return the time within which a program returns, in ms; 0: it does not return.

    Raises:
        ProgramError: the time is not valid.
    """
    if not 0 <= seconds <= _RETURNS_WITHIN_MAX_S:
        raise ProgramError(f"returns_within_s {seconds:g}: write 0 to {_RETURNS_WITHIN_MAX_S:g}")
    return round(seconds * 1000)


class _RunningHandler:
    def __init__(self, output: Output) -> None:
        self.output = output
        self.is_answering = False
        self.is_reclaiming = False
        self.task: asyncio.Task[None] | None = None

    def cancel(self, reason: CancelReason | None) -> None:
        if self.is_answering or self.output.cancelled:
            return
        self.output.cancelled = True
        self.output.cancel_reason = reason
        if self.task is not None:
            self.task.cancel()


def _m_code(m: int, cs: int | None, entry: HandlerEntry) -> dict[str, Any]:
    said = entry.declared.to_json(m, cs)
    return said if entry.redelivery is None else {**said, "redelivery": entry.redelivery.value}


def _how(pending: PendingOutput, own: Redelivery | None) -> Redelivery:
    """Return how an output is begun, as the machine decides at the claim: a lost one gets the strictest setting."""
    if not pending.lost:
        return Redelivery.REDO
    if pending.how is not None:
        return pending.how
    said = {own, pending.redelivery}
    return next((how for how in (Redelivery.ASK, Redelivery.VERIFY, Redelivery.REDO) if how in said), Redelivery.ASK)


class Runner:
    """Presence, claims, handlers and resets of one handler id."""

    def __init__(
        self,
        handler_id: str,
        handlers: Mapping[tuple[int | None, int], HandlerEntry],
        checks: Mapping[tuple[int | None, int], Callable[[Params], object]],
        alarms: Sequence[UserAlarm],
        connection: Connection,
        plc: Plc,
        *,
        take_over: bool = False,
    ) -> None:
        self._identity: dict[str, Any] = {"handler_id": handler_id, "instance": connection.instance}
        self._take_over = take_over
        self._refusals = 0
        self._ended: asyncio.Future[TakenOver] = asyncio.get_running_loop().create_future()
        self._handler_id = handler_id
        self._handlers = handlers
        self._checks = checks
        self._alarms = alarms
        self.returns_within_ms = 0
        """Reported to the machine at the end; 0: the program does not return."""
        self._is_stopping = False
        self._has_left = False
        self._is_known_to_stop = asyncio.Event()
        self._connection = connection
        self._plc = plc
        self._running: dict[OutputId, _RunningHandler] = {}
        # outputs that this instance has begun, the oldest first
        self._begun: dict[OutputId, None] = {}
        self._jobs: set[asyncio.Task[None]] = set()
        self._must_announce = asyncio.Event()
        self._has_announced = False
        self._awaits_acceptance = False
        """True while the machine has not answered the last registration."""
        self._announced_systems: list[int] = []
        self.announced = asyncio.Event()
        """Set while the machine has accepted these handlers."""
        connection.will = json.dumps(self._offline())
        connection.on_message = self._on_message
        connection.on_connected = self._on_connected

    async def run(self) -> None:
        """Register the handlers whenever necessary, until cancelled.

        Raises:
            TakenOver: another process of this name serves the machine.
        """
        self._must_announce.set()
        while not self._ended.done():
            changed: asyncio.Future[Any] = asyncio.ensure_future(self._must_announce.wait())
            either: set[asyncio.Future[Any]] = {changed, self._ended}
            try:
                done, _ = await asyncio.wait(
                    either, timeout=PRESENCE_EXPIRES_S / _REFRESHES, return_when=asyncio.FIRST_COMPLETED
                )
            finally:
                changed.cancel()
            if self._ended.done():
                break
            if not done:
                if self._awaits_acceptance:
                    log.warning("the machine has not accepted the handlers yet")
                if self._has_announced:
                    self._connection.post(self._presence_path(), self._online(), retain=True)
                continue
            self._must_announce.clear()
            try:
                await self._announce()
            except (NotConnected, NoAnswer) as error:
                log.warning("the machine has not accepted the handlers yet: %s", error)
                await asyncio.sleep(_RETRY_S)
                self._must_announce.set()
        raise self._ended.result()

    async def finish(self, within_s: float | None) -> None:
        """Accept no further output, and wait until the running handlers have ended or the time is over."""
        self._is_stopping = True
        self._must_announce.set()
        try:
            await within(self._until_idle(), within_s)
        except asyncio.TimeoutError:
            log.warning("%d handlers had not ended within %g s", len(self._running), within_s)

    async def _until_idle(self) -> None:
        # outputs that the machine claimed for this program before it knew of the stop are still executed
        with contextlib.suppress(asyncio.TimeoutError):
            await within(self._is_known_to_stop.wait(), _LEAVE_MAX_S)
        while tasks := [running.task for running in self._running.values() if running.task is not None]:
            await asyncio.wait(tasks)
            await asyncio.sleep(0)  # each removes itself from the table

    async def leave(self) -> None:
        """End all handlers, and notify the machine that they are offline."""
        self._has_left = True
        self._cancel(lambda _id: True, CancelReason.SHUTDOWN)
        tasks = [running.task for running in self._running.values() if running.task is not None]
        if tasks:
            await asyncio.wait(tasks, timeout=_CLEAN_UP_S)
        for job in self._jobs:
            job.cancel()
        if self._connection.is_connected:
            try:
                gone = self._offline()
                if self.returns_within_ms > 0:
                    gone["returns_within_ms"] = self.returns_within_ms
                await self._connection.request(self._presence_path(), gone, retain=True, timeout_s=1.0)
            except TandemError as error:
                log.warning("the machine was not notified that the handlers are offline: %s", error)

    # --- presence

    def _presence_path(self) -> str:
        return f"handler/{self._handler_id}/presence"

    def _offline(self) -> dict[str, Any]:
        return {"online": False, "handles": [], "validates": False, "instance": self._connection.instance}

    def _systems(self) -> list[int]:
        birth = self._plc.birth
        return [cs.number for cs in birth.coordinate_systems] if birth is not None else []

    def _online(self) -> dict[str, Any]:
        served = {(cs, m) for of, m in self._handlers for cs in (self._announced_systems if of is None else [of])}
        return {
            "online": True,
            "handles": [{"cs": cs, "m": m} for cs, m in sorted(served)],
            "validates": bool(self._checks),
            "m_codes": [_m_code(m, cs, entry) for (cs, m), entry in self._handlers.items()],
            "alarms": [alarm.to_json() for alarm in self._alarms],
            "instance": self._connection.instance,
            "take_over": self._take_over,
            "exclusive": not self._is_stopping,
            "expires_ms": round(PRESENCE_EXPIRES_S * 1000),
            "connection": self._connection.connections,
        }

    async def _announce(self) -> None:
        if not self._has_announced:
            # releases claims of an earlier program of the same name that ended unnoticed
            await self._connection.request(self._presence_path(), self._offline(), retain=True)
        self._announced_systems = self._systems()
        self._awaits_acceptance = True
        await self._connection.request(self._presence_path(), self._online(), retain=True)
        self._has_announced = True

    def _on_accepted(self) -> None:
        self._refusals, self._take_over = 0, False
        if self._is_stopping:
            self._is_known_to_stop.set()
        if self._awaits_acceptance:
            self._awaits_acceptance = False
            self.announced.set()
            self._plc._levels.on_announced(self._handler_id)
            self._update_all_handlers()

    def _on_connected(self) -> None:
        self._plc._levels.on_offline()
        self._must_announce.set()

    # --- messages of the machine

    def _on_message(self, path: str, message: Any) -> None:
        if isinstance(message, Pending):
            self._update_handlers(number_at(path, 1), message)
        elif isinstance(message, Cancel):
            meant = (message.boot_id, number_at(path, 1), message.seq)
            self._cancel(lambda other: other == meant, message.reason)
        elif isinstance(message, Validate):
            self._validate(number_at(path, 1), number_at(path, 3), message)
        elif isinstance(message, Presence):
            if message.online:
                self._cancel(lambda other: other[0] != message.boot_id, CancelReason.SHUTDOWN)
                self._update_all_handlers()
        elif isinstance(message, Birth):
            if self._has_announced and self._systems() != self._announced_systems:
                self._must_announce.set()
        elif isinstance(message, HandlerResult) and message.instance == self._connection.instance:
            self._on_result(message)
        elif isinstance(message, HandlerPresence) and not message.online and self._has_announced:
            # the last will of an earlier connection, which arrived after the registration
            self._must_announce.set()

    def _on_result(self, result: HandlerResult) -> None:
        """Process the machine's answer to the presence."""
        if result.status == "accepted":
            self._on_accepted()
            return
        if result.status == "confirm":
            # another process requests the name, and the machine asks whether this process is still online
            self._must_announce.set()
            return
        self._refusals += 1
        if result.status == "refused" and self._refusals <= _REFUSALS_MAX:
            # the previous process may be about to end
            asyncio.get_running_loop().call_later(1.0, self._must_announce.set)
            return
        self._cancel(lambda _id: True, CancelReason.SHUTDOWN)
        if not self._ended.done():
            self._ended.set_result(TakenOver(result.text or f"another process serves as {self._handler_id}"))

    def _find(self, cs: int, m: int) -> HandlerEntry | None:
        return self._handlers.get((cs, m)) or self._handlers.get((None, m))

    def _validate(self, cs: int, m: int, asked: Validate) -> None:
        if not self._checks or self._find(cs, m) is None:
            return
        check = self._checks.get((cs, m))
        if check is None and (cs, m) not in self._handlers:
            check = self._checks.get((None, m))
        result: dict[str, Any] = {"request_id": asked.request_id, "handler_id": self._handler_id, "ok": True}
        try:
            if check is not None:
                check(asked.params)
        except Alarm as alarm:
            result.update(ok=False, text=alarm.text)
        except Exception as error:
            log.exception("the check of M%d has failed", m)
            result.update(ok=False, text=f"the check of M{m} has failed: {type(error).__name__}: {error}"[:1000])
        self._connection.post(f"cs/{cs}/m_code/{m}/validate_result", result)

    def _update_all_handlers(self) -> None:
        for cs in self._systems():
            pending = self._connection.hub.last(f"cs/{cs}/m_code/pending")
            if pending is not None:
                self._update_handlers(cs, pending)

    def _update_handlers(self, cs: int, pending: Pending) -> None:
        """End handlers whose output is over or belongs to another handler, and start handlers of pending ones."""
        if self._has_left or self._ended.done() or not self.announced.is_set():
            return
        if pending.boot_id != self._connection.boot_id:
            return
        ours = {output.seq for output in pending.outputs if output.handler_id in (None, self._handler_id)}
        self._cancel(lambda id_: id_[:2] == (pending.boot_id, cs) and id_[2] not in ours, None)
        for output in pending.outputs:
            id_ = (pending.boot_id, cs, output.seq)
            if output.state is OutputState.OUTPUT and output.handler_id is None:
                self._start_handler(id_, output, is_claimed=False)
            elif self._is_claimed_for_us(output) and self._is_new(id_):
                self._start_handler(id_, output, is_claimed=True)

    def _is_claimed_for_us(self, output: PendingOutput) -> bool:
        """Return whether the machine already claimed an output for this instance when it issued it."""
        return (
            output.state is OutputState.CLAIMED
            and output.attempt == 1
            and output.handler_id == self._handler_id
            and output.instance == self._connection.instance
        )

    def _is_new(self, id_: OutputId) -> bool:
        """Return whether an output was never begun here: a stale ``pending`` may arrive after its end."""
        return id_ not in self._running and id_ not in self._begun

    def _remember_output(self, id_: OutputId) -> None:
        self._begun[id_] = None
        if len(self._begun) > _BEGUN_MAX:
            del self._begun[next(iter(self._begun))]

    def _is_never_started(self, id_: OutputId, pending: PendingOutput) -> bool:
        """Return whether an output was claimed for this instance, but was lost in transit and never started (H20)."""
        return pending.lost_instance == self._connection.instance and self._is_new(id_)

    # --- outputs

    def _start_handler(self, id_: OutputId, pending: PendingOutput, *, is_claimed: bool) -> None:
        running = self._running.get(id_)
        if running is not None:
            # the handler still works; only its connection was lost
            if pending.lost and not running.is_answering and not running.output.cancelled:
                self._reclaim(running)
            return
        entry = self._find(id_[1], pending.m)
        if entry is None or (self._is_stopping and not is_claimed):
            return
        how = Redelivery.REDO if self._is_never_started(id_, pending) else _how(pending, entry.redelivery)
        if how is Redelivery.ASK:
            return
        self._remember_output(id_)
        output = Output(self._connection, self._identity, id_[0], id_[1], pending, redelivered=how is Redelivery.VERIFY)
        running = self._running[id_] = _RunningHandler(output)
        work = self._work(running, entry, is_claimed=is_claimed, is_lost=pending.lost)
        running.task = asyncio.create_task(work, name=repr(output))
        running.task.add_done_callback(lambda task: self._on_end(id_, task))

    def _on_end(self, id_: OutputId, task: asyncio.Task[None]) -> None:
        ended = self._running.pop(id_, None)
        if not task.cancelled() and task.exception() is not None:
            log.error("a handler could not be ended", exc_info=task.exception())
        if ended is not None and ended.output.cancelled:
            pending = self._connection.hub.last(f"cs/{id_[1]}/m_code/pending")
            if pending is not None:
                self._update_handlers(id_[1], pending)

    def _cancel(self, is_meant: Callable[[OutputId], bool], reason: CancelReason | None) -> None:
        for id_, running in list(self._running.items()):
            if is_meant(id_):
                running.cancel(reason)

    async def _work(self, running: _RunningHandler, entry: HandlerEntry, *, is_claimed: bool, is_lost: bool) -> None:
        output = running.output
        if not is_claimed:
            if is_lost:
                await self._register()
            claimed = await self._until_answered(output, "claim", {})
            if claimed is None or claimed.status != "accepted":
                log.debug("%r is not claimed by this handler: %s", output, claimed)
                return
            if claimed.how is not None:
                output.redelivered = claimed.how is Redelivery.VERIFY
        alarm = await self._call(output, entry)
        if output.cancelled:
            return
        running.is_answering = True
        if alarm is None:
            reset: dict[str, Any] = {"result": "ok"}
        else:
            reset = {"result": "fault", "code": alarm.code, "text": alarm.text}
        answer = await self._until_answered(output, "reset", reset)
        # `duplicate` means that this reset was sent twice, because its answer was late
        if answer is None or answer.status not in ("accepted", "duplicate"):
            log.warning("the machine did not accept the reset of %r: %s", output, answer)

    async def _call(self, output: Output, entry: HandlerEntry) -> Alarm | None:
        try:
            entry.declared.check(output.m, output.params)
            await entry.call(output, self._plc)
        except Alarm as alarm:
            return alarm
        except asyncio.CancelledError:
            if output.cancelled:
                raise
            # the handler cancelled itself, or something that it awaited was cancelled
            return Alarm(CODE_OF_EXCEPTION, f"the handler of M{output.m} was cancelled, but not by the machine")
        except TandemError as error:
            log.warning("the handler of M%d: %s", output.m, error)
            return Alarm(CODE_OF_ERROR, str(error) or type(error).__name__)
        except Exception as error:
            log.exception("the handler of M%d has failed", output.m)
            return Alarm(CODE_OF_EXCEPTION, f"the handler of M{output.m} has failed: {type(error).__name__}: {error}")
        return None

    async def _until_answered(self, output: Output, kind: str, more: dict[str, Any]) -> HandshakeResult | None:
        """Claim or reset until the machine answers; ``None`` if it refuses permanently."""
        tries = 0
        result_of = (output._path("result"), output.seq, self._handler_id, kind)
        while True:
            try:
                result: HandshakeResult = await self._connection.request(
                    output._path(kind), {**output._named(), **more}, result_of=result_of
                )
            except (NotConnected, NoAnswer) as error:
                log.warning("%s of %r: %s", kind, output, error)
                await asyncio.sleep(_RETRY_S)
                if kind == "claim":
                    await self._register()
            except RequestRefused as error:
                tries += 1
                if "unknown field `instance`" in error.text and tries < _INSTANCE_TRIES:
                    # a machine without support for instances; an answer to an earlier try may still arrive
                    self._identity.pop("instance", None)
                    continue
                log.warning("%s of %r is refused: %s", kind, output, error)
                return None
            else:
                return result

    async def _register(self) -> None:
        """Register the handlers again before a claim: a lost connection ends their registration."""
        with contextlib.suppress(NotConnected, NoAnswer):
            await self._connection.request(self._presence_path(), self._online(), retain=True)

    def _reclaim(self, running: _RunningHandler) -> None:
        """Repeat the claim of an output on which a handler still works."""
        if running.is_reclaiming:
            return
        running.is_reclaiming = True

        async def claim() -> None:
            await self._register()
            claimed = await self._until_answered(running.output, "claim", {})
            running.is_reclaiming = False
            if claimed is not None and claimed.status == "accepted":
                running.output._post_reports_again()
            else:
                running.cancel(None)

        job = asyncio.create_task(claim(), name=f"claims {running.output!r} again")
        self._jobs.add(job)
        job.add_done_callback(self._jobs.discard)
