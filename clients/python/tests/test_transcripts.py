"""Transcripts of sequence programs, which all languages share: tests/transcripts/README.md."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from fake_broker import PRESENCE, TABLE, FakeBroker

from tandem_plc import Alarm, Output, Params, Redelivery, SequenceProgram, TakenOver

InLoop = Callable[[Awaitable[Any]], Any]

STEP_S = 5.0
SETTINGS = {"handlers", "redelivery", "take_over", "accepts", "returns_within_ms", "ends_within_ms"}
HANDLER_SETTINGS = {"does", "redelivery", "refuses"}


class Stage:
    """A sequence program of a case, its broker, and the steps."""

    def __init__(self, case: dict[str, Any]) -> None:
        self.steps: list[list[Any]] = case["steps"]
        self.settings: dict[str, Any] = case["program"]
        self.broker = FakeBroker(accepts=self.settings.get("accepts", True))
        self.events: list[tuple[str, int, Any]] = []
        """Events of handlers: kind, M number, details."""
        self.waiting: list[tuple[int, asyncio.Event]] = []
        self.left = asyncio.Event()
        self.names: dict[str, Any] = {}
        self.ended: asyncio.Task[None] | None = None

    # --- the program

    def program(self) -> SequenceProgram:
        unknown = set(self.settings) - SETTINGS
        assert not unknown, unknown
        own = self.settings.get("redelivery")
        program = SequenceProgram("cell", redelivery=own and Redelivery(own))
        for m, handler in self.settings["handlers"].items():
            unknown = set(handler) - HANDLER_SETTINGS
            assert not unknown, unknown
            redelivery = handler.get("redelivery")
            register = program.on(int(m), redelivery=redelivery and Redelivery(redelivery))
            register(self.handler(handler["does"]))
            if "refuses" in handler:
                program.validate(int(m))(self.check(*handler["refuses"]))
        return program

    @staticmethod
    def check(code: int, text: str) -> Callable[[Params], None]:
        def check(_params: Params) -> None:
            raise Alarm(code, text)

        return check

    def handler(self, actions: list[list[Any]]) -> Callable[[Output], Awaitable[None]]:
        async def handler(output: Output) -> None:
            begun = {"redelivered": output.redelivered, "checkpoint": output.last_checkpoint}
            self.events.append(("begins", output.m, begun))
            try:
                for action, *args in actions:
                    await getattr(self, f"do_{action}")(output, *args)
            except asyncio.CancelledError:
                await asyncio.sleep(0.01)  # a clean-up is not cancelled
                reason = output.cancel_reason and output.cancel_reason.value
                self.events.append(("cancelled", output.m, reason))
                raise

        return handler

    async def do_wait(self, output: Output) -> None:
        resumed = asyncio.Event()
        self.waiting.append((output.m, resumed))
        try:
            await resumed.wait()
        finally:
            self.waiting = [entry for entry in self.waiting if entry[1] is not resumed]

    async def do_progress(self, output: Output, text: str, percent: float | None) -> None:
        output.progress(text, percent)

    async def do_checkpoint(self, output: Output, value: Any) -> None:
        output.checkpoint(value)

    async def do_ask(self, output: Output, text: str, choices: list[str]) -> None:
        self.events.append(("answered", output.m, await output.ask(text, choices)))

    async def do_fault(self, _output: Output, code: int, text: str) -> None:
        raise Alarm(code, text)

    # --- the steps

    async def play(self) -> None:
        async with self.broker.open():
            seconds = {name: ms / 1000 for name, ms in self.settings.items() if name.endswith("_ms")}
            times = {f"{name.removesuffix('_ms')}_s": value for name, value in seconds.items()}
            takes_over = self.settings.get("take_over", False)
            runs = self.program().run_until(self.broker.address, self.left.wait(), take_over=takes_over, **times)
            self.ended = asyncio.ensure_future(runs)
            try:
                for at, (step, *args) in enumerate(self.steps):
                    try:
                        await getattr(self, f"step_{step}")(*args)
                    except AssertionError as error:
                        raise AssertionError(f"step {at}, {[step, *args]}: {error}") from error
                self.skip_presences()
                assert (self.broker.heard, self.events) == ([], []), "nothing is left"
            finally:
                self.ended.cancel()
                await asyncio.gather(self.ended, return_exceptions=True)

    async def step_receives(self, topic: str, members: dict[str, Any]) -> None:
        self.broker.publish(topic, self.filled(members))

    async def step_publishes(self, topic: str, members: dict[str, Any]) -> None:
        while True:
            await self.until(lambda: self.broker.heard)
            said, payload = self.broker.heard.pop(0)
            if (said, self.fits(members, payload)) == (topic, True):
                return
            assert said == PRESENCE, f"published {said} {payload}"

    async def step_publishes_all(self, messages: list[list[Any]]) -> None:
        expected = list(messages)
        while expected:
            await self.until(self.has_message)
            said, payload = self.broker.heard.pop(0)
            fitting = [one for one in expected if one[0] == said and self.fits(one[1], payload)]
            assert fitting, f"published {said} {payload}"
            expected.remove(fitting[0])

    async def step_registers(self, members: dict[str, Any]) -> None:
        await self.step_publishes(PRESENCE, {"online": True, **members})

    async def step_nothing(self, ms: float) -> None:
        await asyncio.sleep(ms / 1000)
        self.skip_presences()
        assert (self.broker.heard, self.events) == ([], [])

    async def step_begins(self, m: int, members: dict[str, Any]) -> None:
        await self.expect_event("begins", m, members)

    async def step_answered(self, m: int, choice: str) -> None:
        await self.expect_event("answered", m, choice)

    async def step_cancelled(self, m: int, reason: str | None) -> None:
        await self.expect_event("cancelled", m, reason)

    async def expect_event(self, *expected: Any) -> None:
        await self.until(lambda: self.events)
        event = self.events.pop(0)
        assert self.fits(list(expected), list(event)), f"{event}"

    async def step_continues(self, m: int) -> None:
        await self.until(lambda: any(of == m and not resumed.is_set() for of, resumed in self.waiting))
        next(resumed for of, resumed in self.waiting if of == m and not resumed.is_set()).set()

    async def step_cuts(self, will: dict[str, Any]) -> None:
        assert self.fits(will, self.broker.will), f"last will {self.broker.will}"
        self.broker.is_down = True
        self.broker.cut()

    async def step_restores(self) -> None:
        self.skip_presences()
        self.broker.is_down = False

    async def step_leaves(self) -> None:
        self.left.set()

    async def step_ends(self, how: str) -> None:
        ended = self.ended
        assert ended is not None
        await self.until(ended.done)
        assert {"left": None, "taken_over": TakenOver}[how] in (type(ended.exception()), ended.exception())

    # --- comparison

    async def until(self, holds: Callable[[], object]) -> None:
        end = asyncio.get_running_loop().time() + STEP_S
        while not holds():
            assert asyncio.get_running_loop().time() < end, f"not within {STEP_S} s; events {self.events}"
            await asyncio.sleep(0.002)

    def has_message(self) -> bool:
        self.skip_presences()
        return bool(self.broker.heard)

    def skip_presences(self) -> None:
        self.broker.heard[:] = [entry for entry in self.broker.heard if entry[0] != PRESENCE]

    def filled(self, value: Any) -> Any:
        """Return a value with the names replaced."""
        if isinstance(value, dict):
            return {name: self.filled(member) for name, member in value.items()}
        if isinstance(value, list):
            return [self.filled(item) for item in value]
        if value == "$instance":
            return self.broker.instance
        return self.names[value] if isinstance(value, str) and value.startswith("$") else value

    def fits(self, expected: Any, value: Any) -> bool:
        if isinstance(expected, dict):
            return isinstance(value, dict) and all(self.fits(one, value.get(name)) for name, one in expected.items())
        if isinstance(expected, list):
            return isinstance(value, list) and len(value) == len(expected) and all(map(self.fits, expected, value))
        if expected == "$instance":
            return bool(value == self.broker.instance)
        if isinstance(expected, str) and expected.startswith("$"):
            return bool(self.names.setdefault(expected, value) == value)
        return bool(value == expected) or (expected is False and value is None)


@pytest.mark.parametrize("case", TABLE["cases"], ids=lambda case: case["name"])
def test_transcript(case: dict[str, Any], in_loop: InLoop) -> None:
    in_loop(Stage(case).play())
