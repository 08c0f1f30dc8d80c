"""One coordinate system of a machine: commands, inputs and readings."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from .changes import changes
from .errors import Alarm, CommandFailed, NotConnected, RequestRefused
from .levels import lock_level, lock_target
from .messages import (
    CapturedPositions,
    CommandReply,
    Execution,
    Lock,
    OptionalSkip,
    Overrides,
    Pending,
    PendingOutput,
    Position,
    Run,
    State,
    Tool,
)

if TYPE_CHECKING:
    from .plc import Plc

M = TypeVar("M")

COMMAND_TIMEOUT_S = 5.0
"""Time limit of a command that does not move axes."""


class CoordinateSystem:
    """One coordinate system of a machine. Commands return after their effect.

    Each command takes ``command_id``, which names it: a command repeated with the id of a :class:`~tandem_plc.NoAnswer`
    is not executed twice. All commands raise ``RequestRefused`` (nothing has changed), ``CommandFailed`` (the command
    was accepted, but could not take effect), ``NotConnected`` (nothing was sent) or ``NoAnswer`` (the effect is
    unknown).
    """

    def __init__(self, plc: Plc, number: int) -> None:
        self._plc = plc
        self.number = number

    # --- commands

    async def load(self, program: int, *, command_id: str | None = None) -> CommandReply:
        """Load a program of the store, 1 to 9999: READY."""
        return await self.command("load", {"program": program}, command_id=command_id)

    async def start(self, *, command_id: str | None = None) -> CommandReply:
        """Start the loaded program at line 1: ACTIVE."""
        return await self.command("start", command_id=command_id)

    async def hold(self, *, command_id: str | None = None) -> CommandReply:
        """Feed hold: FEED_HOLD once the axes are stationary."""
        return await self.command("hold", command_id=command_id)

    async def resume(self, *, command_id: str | None = None) -> CommandReply:
        """Resume after a pause."""
        return await self.command("resume", command_id=command_id)

    async def stop(self, *, command_id: str | None = None) -> CommandReply:
        """Decelerate on the path and end the run; pending outputs are cancelled."""
        return await self.command("stop", command_id=command_id)

    async def abort(self, *, command_id: str | None = None) -> CommandReply:
        """Brake each motor at once and end the run; pending outputs are cancelled."""
        return await self.command("abort", command_id=command_id)

    async def reset(self, *, command_id: str | None = None) -> CommandReply:
        """End the run, cancel pending outputs, and clear alarms."""
        return await self.command("reset", command_id=command_id)

    async def back_trace(self, on: bool, *, command_id: str | None = None) -> CommandReply:
        """Move back along the passed path in a feed hold with G500, or forward again."""
        return await self.command("back_trace", {"on": on}, command_id=command_id)

    async def mdi(
        self, text: str, *, macro: bool = False, timeout_s: float = 3600.0, command_id: str | None = None
    ) -> CommandReply:
        """Run lines of NC text to their end, then READY.

        Args:
            text: one or several lines.
            macro: for a text that a program generates. It starts with the configured unit and absolute positions (G90)
                in force. At its end, also after an alarm or a stop, the machine restores the modal state, the feedrate
                and the selected offsets that were in force before.
            timeout_s: how long it may take.
            command_id: names the command.
        """
        args: dict[str, Any] = {"text": text, "macro": True} if macro else {"text": text}
        return await self.command("mdi", args, command_id=command_id, timeout_s=timeout_s)

    async def home(
        self, axes: Sequence[str] = (), *, timeout_s: float = 600.0, command_id: str | None = None
    ) -> CommandReply:
        """Move axes to their first reference points, then READY; without names, all axes."""
        args = {"axes": list(axes)} if axes else {}
        return await self.command("home", args, command_id=command_id, timeout_s=timeout_s)

    async def jog(
        self,
        axis: str,
        velocity: float,
        refresh_id: str,
        *,
        distance: float | None = None,
        timeout_s: float = 600.0,
        command_id: str | None = None,
    ) -> CommandReply:
        """Jog one axis as long as this is called again with the same ``refresh_id`` at least every 200 ms.

        The first call returns when the jog has ended, the others at once. A distance up to ``jog_step_max`` of
        ``[hmi]`` (10 by default) needs one call only. ``CommandFailed`` contains the distance covered if the
        motion ended before the whole distance.

        Args:
            axis: letter of the axis.
            velocity: mm/min or deg/min; the sign is the direction.
            refresh_id: names the jog, 1 to 128 characters.
            distance: length of the motion, mm or degrees; ``None``: up to the soft limit.
            timeout_s: how long it may take.
            command_id: names the command.
        """
        args: dict[str, Any] = {"axis": axis, "velocity": velocity, "refresh_id": refresh_id}
        if distance is not None:
            args["distance"] = distance
        return await self.command("jog", args, command_id=command_id, timeout_s=timeout_s)

    async def jog_end(self, refresh_id: str, *, command_id: str | None = None) -> CommandReply:
        """End the jog of this ``refresh_id`` at once, and return when the axis rests."""
        return await self.command("jog", {"refresh_id": refresh_id, "end": True}, command_id=command_id)

    async def acknowledge_alarm(self, alarm_id: int, *, command_id: str | None = None) -> CommandReply:
        """Record that a user has seen an alarm, with the name of the user; the alarm stays active until a reset."""
        return await self.command("alarm_acknowledge", {"id": alarm_id}, command_id=command_id)

    async def command(
        self,
        verb: str,
        args: dict[str, Any] | None = None,
        *,
        command_id: str | None = None,
        timeout_s: float = COMMAND_TIMEOUT_S,
    ) -> CommandReply:
        """Execute a command by its verb and arguments, and return after its effect."""
        payload: dict[str, Any] = {"args": args} if args else {}
        fence = self._plc._fences.get(self.number)
        if fence is not None:
            payload["fence"] = fence
        path = f"cs/{self.number}/command/{verb}"
        reply = await self._plc._ask(path, payload, command_id=command_id, timeout_s=timeout_s)
        if reply.status == "failed":
            raise CommandFailed(verb, reply.code, reply.text, reply.moved)
        return reply

    async def run(self, program: int | None = None, *, parts: int = 1) -> Run:
        """Load a program if one is given, run it once for each part, and wait until the run has ended.

        Each further part begins only after PROGRAM_COMPLETED; the interlock and the start lock delay it.

        Raises:
            CommandFailed: a later run replaced this one before its end was received.
        """
        args: dict[str, Any] = {"parts": parts} if program is None else {"program": program, "parts": parts}
        async with self._following("run") as states:
            reply = await self.command("run", args)
            is_seen = False
            async for state in states:
                run: Run | None = state.run
                is_it = run is not None and run.id == reply.run_id
                if run is not None and is_it and run.end is not None:
                    return run
                if is_seen and not is_it:
                    raise CommandFailed("run", "lost", f"run {reply.run_id} is no longer the current run")
                is_seen |= is_it
        raise CommandFailed("run", "lost", "the connection was closed")

    # --- the control lease

    async def take_lease(self, holder: str, ttl_ms: int = 5_000) -> int:
        """Take the control lease, or renew it: until it ends, only commands of this connection start motion.

        Returns:
            Number of the lease, which this connection sends with each of its commands.

        Raises:
            RequestRefused: another client holds the lease.
        """
        payload: dict[str, Any] = {"holder": holder, "ttl_ms": ttl_ms}
        fence = self._plc._fences.get(self.number)
        if fence is not None:
            payload["fence"] = fence
        reply = await self._plc._ask(f"cs/{self.number}/lease/take", payload)
        lease = reply.lease
        if lease is None:
            raise RequestRefused("unavailable", "the answer of the machine does not contain the lease")
        self._plc._fences[self.number] = lease.fence
        return lease.fence

    async def release_lease(self) -> None:
        """Release the control lease; no effect if this connection has no lease."""
        fence = self._plc._fences.pop(self.number, None)
        if fence is not None:
            await self._plc._ask(f"cs/{self.number}/lease/release", {"fence": fence})

    # --- inputs

    async def set_optional_skip(self, number: int, value: bool) -> None:
        """Set one optional block skip input, 1 to 31."""
        await self._set("input/optional_skip", {"set": {str(number): value}})

    async def set_optional_stop(self, value: bool) -> None:
        """Set the optional stop input (M01)."""
        await self._set("input/optional_stop", {"value": value})

    async def set_single_block(self, value: bool) -> None:
        """Set single block: after each block the axes stop until a resume."""
        await self._set("input/single_block", {"value": value})

    async def set_dry_run(self, value: bool) -> None:
        """Set dry run: blocks move at the dry run feedrate instead of F."""
        await self._set("input/dry_run", {"value": value})

    async def set_interlock(self, value: bool, text: str = "", *, source: str = "default") -> None:
        """Set a source of the interlock: while any source is on, no motion runs or starts; ``text`` is the reason.

        A program that serves the machine owns its sources: they are written again on each connection and at each boot,
        and no other client can clear them. If the machine is offline, the program waits for it.

        Raises:
            RequestRefused: another handler owns the source.
        """
        await self._set_lock("interlock", value, text, source)

    async def set_start_lock(self, value: bool, text: str = "", *, source: str = "default") -> None:
        """Set a source of the start lock, as :meth:`set_interlock`: while any source is on, no program starts.

        Raises:
            RequestRefused: another handler owns the source.
        """
        await self._set_lock("start_lock", value, text, source)

    async def set_overrides(
        self, *, feed: float | None = None, rapid: float | None = None, spindle: float | None = None
    ) -> None:
        """Set overrides, percent: feed and spindle 0 to 200, rapid 0 to 100; omitted ones stay unchanged."""
        given = {"feed": feed, "rapid": rapid, "spindle": spindle}
        await self._set("override", {name: value for name, value in given.items() if value is not None})

    async def select_tool(self, number: int) -> None:
        """Set the number of the tool in the spindle; 0 means that the spindle is empty."""
        await self._set("tool", {"id": number})

    async def set_spindle(self, direction: str, rpm: float | None = None) -> None:
        """Command the spindle: ``cw``, ``ccw``, ``stop`` or ``orient``; r/min with the first two."""
        await self._set("spindle", {"direction": direction} if rpm is None else {"direction": direction, "rpm": rpm})

    async def raise_alarm(self, alarm: Alarm) -> None:
        """Raise an alarm that stops this coordinate system and cancels its pending outputs."""
        await self._plc.raise_alarm(alarm, cs=self.number)

    async def read_q(self, first: int, count: int = 1) -> list[float]:
        """Read up to 1024 Q variables, all from one moment."""
        return await self._plc._read_variables(self.number, "Q", first, count)

    async def write_q(self, first: int, values: Sequence[float]) -> None:
        """Write up to 1024 Q variables, all or none."""
        await self._plc._write_variables(self.number, "Q", first, values)

    async def answer(self, output: PendingOutput, choice: str) -> None:
        """Answer the question of a pending output, as an operator does.

        Raises:
            RequestRefused: the output has no question.
        """
        if output.question is None:
            raise RequestRefused("not_found", f"M{output.m} has no question")
        payload = {
            "boot_id": self._plc.boot_id,
            "seq": output.seq,
            "question_id": output.question.id,
            "choice": choice,
            "client_id": self._plc._connection.client_id,
        }
        await self._set_path(f"m_code/{output.m}/answer", payload)

    async def _set_lock(self, kind: str, value: bool, text: str, source: str) -> None:
        await self._plc._levels.set(lock_target(self.number, kind, source), lock_level(value, text, source))

    async def _set(self, path: str, payload: dict[str, Any]) -> None:
        await self._set_path(f"{path}/set", payload)

    async def _set_path(self, path: str, payload: dict[str, Any]) -> None:
        await self._plc._connection.request(f"cs/{self.number}/{path}", payload)

    # --- readings

    @property
    def state(self) -> State:
        """State word, reason, and the output for which the program waits."""
        return self._last("state", State)

    @property
    def position(self) -> Position:
        """Positions of the last servo cycle, at most 0.1 s old."""
        return self._last("position", Position)

    @property
    def captured(self) -> CapturedPositions:
        """Positions captured by the last G31."""
        return self._last("captured", CapturedPositions)

    @property
    def tool(self) -> Tool:
        """The tool in the spindle."""
        return self._last("tool/state", Tool)

    @property
    def overrides(self) -> Overrides:
        """Overrides, percent."""
        return self._last("override/state", Overrides)

    @property
    def interlock(self) -> Lock:
        """The interlock, and why it is on."""
        return self._last("input/interlock/state", Lock)

    @property
    def start_lock(self) -> Lock:
        """The start lock, and why it is on."""
        return self._last("input/start_lock/state", Lock)

    @property
    def optional_skip(self) -> OptionalSkip:
        """Optional block skip inputs."""
        return self._last("input/optional_skip/state", OptionalSkip)

    @property
    def pending(self) -> tuple[PendingOutput, ...]:
        """Pending outputs."""
        return self._last("m_code/pending", Pending).outputs

    async def states(self) -> AsyncIterator[State]:
        """Follow the state: the current state, then each new state."""
        async with self._following("state") as states:
            async for state in states:
                yield state

    async def q_changes(self, first: int, count: int = 1) -> AsyncIterator[list[float]]:
        """Follow Q variables, as :meth:`tandem_plc.Plc.p_changes`."""
        async for values in changes(self._plc, f"cs/{self.number}/variables", "Q", first, count):
            yield values

    async def work_offset_changes(self) -> AsyncIterator[dict[str, dict[str, float]]]:
        """Follow work offsets ``G54`` to ``G59``, each by axis letter, mm or degrees: now, and after each change."""
        async with self._following("work_offsets") as offsets:
            async for values in offsets:
                yield values.work_offsets

    async def pendings(self) -> AsyncIterator[tuple[PendingOutput, ...]]:
        """Follow the pending outputs: the current outputs, then all pending outputs after each change."""
        async with self._following("m_code/pending") as pendings:
            async for pending in pendings:
                yield pending.outputs

    async def wait_until(self, execution: Execution) -> State:
        """Wait until the state word is ``execution``, and return that state."""
        return await self.wait_for(lambda state: state.execution is execution)

    async def wait_for(self, fits: Callable[[State], bool]) -> State:
        """Wait for a state for which ``fits`` is true, and return it."""
        async with self._following("state") as states:
            async for state in states:
                if fits(state):
                    found: State = state
                    return found
        raise NotConnected("the connection was closed here")

    def _following(self, name: str) -> contextlib.aclosing[AsyncGenerator[Any, None]]:
        return contextlib.aclosing(self._plc._connection.hub.follow(f"cs/{self.number}/{name}"))

    def _last(self, name: str, kind: type[M]) -> M:
        message = self._plc._connection.hub.last(f"cs/{self.number}/{name}")
        if isinstance(message, kind):
            return message
        text = f"coordinate system {self.number} does not exist, or has not published its {name} yet"
        raise RequestRefused("not_found", text)
