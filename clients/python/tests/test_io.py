"""Inputs and outputs of the plant against a real machine."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from tandem_plc import Alarm, IoForced, IoState, Output, Plc, RequestRefused, SequenceProgram
from tandem_plc.decode import DecodeError, decode
from tandem_plc.testing import DEFAULT_CONFIG, Machine

InLoop = Callable[[Awaitable[Any]], Any]

PLANT = """
[io.in.flows]

[io.in.level]
kind = "number"
unit = "l"
min = 0
max = 60

[io.out.valve]
"""


@pytest.fixture
def tandem_config() -> str:
    """Give the machine a plant."""
    return DEFAULT_CONFIG + PLANT


def program() -> SequenceProgram:
    """M8 opens the valve, and waits until coolant flows."""
    cell = SequenceProgram("cell")

    @cell.on(8)
    async def coolant_on(_output: Output, plc: Plc) -> None:
        await plc.io_out("valve").set(True)
        try:
            await asyncio.wait_for(plc.io_in("flows").wait_until(), 10)
        except asyncio.TimeoutError:
            raise Alarm(8, "no coolant flows") from None

    return cell


def test_what_is_written_is_read_by_value_by_waiting_and_by_following(tandem_machine: Machine, in_loop: InLoop) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc, Plc.connect(tandem_machine.mqtt) as other:
            level = plc.io_in("level")
            follows = level.values()
            assert await anext(follows) == 0.0
            await other.io_in("level").set(12.5)
            assert await anext(follows) == 12.5
            assert await level.wait_until(lambda litres: litres > 10) == 12.5
            assert (level.state.owner, level.state.lost, level.state.forced) == (None, False, None)
            birth = plc.birth
            assert birth is not None
            declared = birth.io["in"]["level"]
            assert (declared.kind, declared.unit, declared.on_loss, declared.max) == ("number", "l", 0.0, 60.0)

    in_loop(work())


def test_a_handler_commands_an_output_and_waits_for_an_input(tandem_machine: Machine) -> None:
    with tandem_machine.serve(program()):
        tandem_machine.load("M08\nM30")
        started = tandem_machine.started()
        tandem_machine.wait_for(lambda _: tandem_machine.rest("GET", "/io/out/valve")["value"] is True)
        assert tandem_machine.rest("GET", "/io/out/valve")["owner"] == "cell"
        assert tandem_machine.state()["execution"] == "WAIT"
        tandem_machine.rest("PUT", "/io/in/flows", {"value": True})
        assert started.end().completed
    # safe without its program, as soon as the machine knows that it is offline
    tandem_machine.wait_for(lambda _: tandem_machine.rest("GET", "/io/out/valve")["lost"])
    assert tandem_machine.rest("GET", "/io/out/valve")["value"] is False


def test_nobody_writes_what_is_another_handlers(tandem_machine: Machine, in_loop: InLoop) -> None:
    async def work() -> None:
        cell = SequenceProgram("cell")
        async with cell.serving(tandem_machine.mqtt) as serving, Plc.connect(tandem_machine.mqtt) as plc:
            await serving.plc.io_out("valve").set(True)
            await plc.until(lambda: plc.io_out("valve").value is True)
            with pytest.raises(RequestRefused, match="handler cell owns it") as refused:
                await plc.io_out("valve").set(False)
            assert refused.value.code == "not_allowed"

    in_loop(work())


def test_a_forced_value_counts_until_its_release(tandem_machine: Machine, in_loop: InLoop) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            valve = plc.io_out("valve")
            await valve.set(True)
            await valve.wait_until()
            await valve.force(False)
            await plc.until(lambda: valve.state.forced is not None)
            assert (valve.value, valve.state.written) == (False, True)
            await valve.release()
            await plc.until(lambda: valve.state.forced is None)
            assert valve.value is True

    in_loop(work())


def test_what_cannot_be_is_refused_in_words(tandem_machine: Machine, in_loop: InLoop) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            with pytest.raises(RequestRefused, match=r"no \[io.out.vent\]; there are valve"):
                await plc.io_out("vent").set(True)
            with pytest.raises(RequestRefused, match=r"no \[io.in.vent\]"):
                _ = plc.io_in("vent").value
            for wrong in (61, -1, float("nan"), True):
                with pytest.raises(RequestRefused, match="write"):
                    await plc.io_in("level").set(wrong)
            with pytest.raises(RequestRefused, match="True or False"):
                await plc.io_out("valve").force(1.0)

    in_loop(work())


def test_a_value_is_a_bool_or_a_number_and_nothing_else() -> None:
    forced = {"value": 2.5, "by": "anna"}
    said = {"boot_id": "b", "ts": "t", "value": True, "written": 1, "owner": None, "lost": False, "forced": forced}
    state = decode(IoState, said)
    assert state.value is True
    assert isinstance(state.written, float)
    assert state.forced == IoForced(value=2.5, by="anna")
    with pytest.raises(DecodeError):
        decode(IoState, {**said, "value": "on"})
