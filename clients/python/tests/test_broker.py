"""A program at a broker that behaves wrongly."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from fake_broker import PRESENCE, FakeBroker

from tandem_plc import Output, Plc, SequenceProgram, connection, link
from tandem_plc.program import Serving

InLoop = Callable[[Awaitable[Any]], Any]

SILENCE_MAX_S = 0.5


@pytest.fixture
def program() -> SequenceProgram:
    program = SequenceProgram("cell")

    @program.on(20)
    async def rinse(_output: Output) -> None: ...

    return program


def test_a_broker_that_acknowledges_nothing_is_left_for_the_next_node(
    program: SequenceProgram, in_loop: InLoop, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(link, "SILENCE_MAX_S", SILENCE_MAX_S)

    async def work() -> None:
        silent, sound = FakeBroker(acknowledges=False, accepts=False), FakeBroker()
        async with silent.open(), sound.open():
            address = f"mqtt://127.0.0.1:{silent.port},127.0.0.1:{sound.port}/mill-1"
            async with program.serving(address) as serving:
                assert PRESENCE in sound.topics
                assert not serving.ended.done()
            assert PRESENCE in silent.topics

    in_loop(work())
    assert f"acknowledged nothing for {SILENCE_MAX_S:g} s" in caplog.text


def test_a_broker_is_not_left_while_nothing_waits_for_it(
    program: SequenceProgram, in_loop: InLoop, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(link, "SILENCE_MAX_S", SILENCE_MAX_S)

    async def work() -> None:
        sound = FakeBroker()
        async with sound.open(), program.serving(sound.address):
            await asyncio.sleep(3 * SILENCE_MAX_S)

    in_loop(work())
    assert "acknowledged nothing" not in caplog.text


def test_what_a_missed_machine_said_is_read_anew_when_it_is_heard_again(
    in_loop: InLoop, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "LOOK_AT_AGE_S", 0.05)

    async def work() -> None:
        broker = FakeBroker()
        broker.publish("presence", {"expires_ms": 300})
        async with broker.open(), Plc.connect(broker.address) as plc:
            async for presence in plc.presences():
                if not presence.online:
                    break
            broker.is_connected.clear()
            broker.publish("presence", {})
            await broker.is_connected.wait()
            assert broker.goodbyes == 1, "without one its last will would lose the outputs of a handler"

    in_loop(work())


def test_a_task_begins_when_the_machine_knows_the_handlers_and_not_when_the_broker_does(
    program: SequenceProgram, in_loop: InLoop
) -> None:
    begun = asyncio.Event()

    @program.task
    async def start(_plc: Plc) -> None:
        begun.set()

    async def serve(address: str, ready: asyncio.Future[Serving]) -> None:
        async with program.serving(address) as serving:
            ready.set_result(serving)
            await serving.ended

    async def work() -> None:
        broker = FakeBroker(accepts=False)
        async with broker.open():
            ready: asyncio.Future[Serving] = asyncio.get_running_loop().create_future()
            served = asyncio.create_task(serve(broker.address, ready))
            # goes offline first and online afterwards: the broker has received both
            await broker.until_heard(PRESENCE, 2)
            await asyncio.sleep(0.1)
            assert not begun.is_set()
            assert not ready.done()
            broker.accept()
            await ready
            await begun.wait()
            served.cancel()
            await asyncio.gather(served, return_exceptions=True)

    in_loop(work())
