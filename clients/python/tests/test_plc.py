"""Commands, inputs, variables and states against a real machine."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from tandem_plc import Alarm, CommandFailed, ConnectError, Execution, NoAnswer, NotConnected, Plc, RequestRefused
from tandem_plc.testing import Machine

InLoop = Callable[[Awaitable[Any]], Any]


def test_a_program_is_loaded_and_run(tandem_machine: Machine, in_loop: InLoop) -> None:
    tandem_machine.rest("PUT", "/programs/1", "G01 X10 F6000\nM30")

    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            mill = plc.cs(1)
            first = await mill.run(1)
            second = await mill.run()
            assert first.completed
            assert second.completed
            assert first.id != second.id
            assert mill.state.program == 1
            birth = plc.birth
            assert birth is not None
            assert birth.coordinate_systems[0].axes == {"X": 1, "Y": 2, "Z": 3}

    in_loop(work())


def test_a_refusal_says_why_and_nothing_has_changed(tandem_machine: Machine, in_loop: InLoop) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            with pytest.raises(RequestRefused) as refused:
                await plc.cs(1).load(999)
            assert refused.value.code == "not_found"
            with pytest.raises(RequestRefused) as refused:
                await plc.cs(1).resume()
            assert refused.value.code == "not_allowed"
            with pytest.raises(RequestRefused) as refused:
                await plc.cs(1).mdi("G01 X1 F")
            assert refused.value.code == "program_has_errors"
            with pytest.raises(RequestRefused):
                _ = plc.cs(7).state

    in_loop(work())


def test_a_command_that_cannot_have_its_effect_has_failed(tandem_machine: Machine, in_loop: InLoop) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            moves = asyncio.create_task(plc.cs(1).mdi("G01 X400 F600"))
            await plc.cs(1).wait_until(Execution.ACTIVE)
            await plc.cs(1).stop()
            with pytest.raises(CommandFailed, match="mdi failed") as failed:
                await moves
            assert failed.value.code == "stop"
            assert 0 < failed.value.moved["X"] < 400

    in_loop(work())


def test_a_step_is_whole_without_refresh_and_a_macro_leaves_nothing_behind(
    tandem_machine: Machine, in_loop: InLoop
) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            mill = plc.cs(1)
            await mill.home()
            reply = await mill.jog("X", 600.0, "step-1", distance=5.0)
            assert (reply.status, reply.moved) == ("done", {})
            with pytest.raises(CommandFailed) as failed:
                await mill.jog("X", 600.0, "step-2", distance=50.0)
            assert failed.value.code == "not_refreshed"
            covered = failed.value.moved["X"]
            assert 0 < covered < 50
            await mill.mdi("G90 G01 F6000")
            await mill.mdi("G91 G01 X1", macro=True)
            await mill.mdi("X10")
            assert tandem_machine.rest("GET", "/cs/1/position")["machine"]["X"] == pytest.approx(10.0)

    in_loop(work())


def test_a_command_is_carried_out_once_by_its_id(tandem_machine: Machine, in_loop: InLoop) -> None:
    tandem_machine.rest("PUT", "/programs/1", "G01 X10 F6000\nM30")

    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            mill = plc.cs(1)
            await mill.load(1)
            first = await mill.start(command_id="part-1")
            await mill.wait_until(Execution.PROGRAM_COMPLETED)
            again = await mill.start(command_id="part-1")
            assert (first.status, again.status) == ("done", "done")
            assert mill.state.execution is Execution.PROGRAM_COMPLETED, "it has not started again"

    in_loop(work())


def test_variables_are_what_was_written(tandem_machine: Machine, in_loop: InLoop) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            await plc.write_p(100, [1.5, math.nan, math.inf, -math.inf, 0.1])
            read = await plc.read_p(100, 5)
            assert math.isnan(read.pop(1))
            assert read == [1.5, math.inf, -math.inf, 0.1]
            await plc.cs(1).write_q(10, [7.0])
            assert await plc.cs(1).read_q(10) == [7.0]
            with pytest.raises(RequestRefused):
                await plc.read_p(32_767, 2)

    in_loop(work())


def test_inputs_are_set_and_seen(tandem_machine: Machine, in_loop: InLoop) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            mill = plc.cs(1)
            await mill.set_optional_skip(3, True)
            await mill.set_optional_stop(True)
            await mill.set_overrides(feed=50)
            state = await mill.wait_for(lambda state: state.optional_stop and state.optional_skip == (3,))
            assert state.reason == "NO_PROGRAM"
            await mill.set_start_lock(True, "the pallet moves")
            await plc.until(lambda: mill.start_lock.value and mill.overrides.feed == 50)
            assert mill.start_lock.text == "the pallet moves"
            await mill.set_start_lock(False)

    async def settle() -> None:
        await asyncio.wait_for(work(), 20)

    in_loop(settle())


def test_an_alarm_of_no_output_stops_the_machine(tandem_machine: Machine, in_loop: InLoop) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            await plc.raise_alarm(Alarm(20, "the air pressure is low"))
            await plc.cs(1).wait_until(Execution.STOPPED)
            await plc.until(lambda: bool(plc.alarms))
            assert [(alarm.number, alarm.text) for alarm in plc.alarms] == [(10_020, "the air pressure is low")]
            await plc.cs(1).acknowledge_alarm(plc.alarms[0].id)
            await plc.cs(1).reset()
            await plc.until(lambda: not plc.alarms)

    in_loop(work())


def test_a_lease_gives_starts_to_its_holder_alone(tandem_machine: Machine, in_loop: InLoop) -> None:
    tandem_machine.rest("PUT", "/programs/1", "G01 X10 F6000\nM30")

    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as line, Plc.connect(tandem_machine.mqtt) as panel:
            await line.cs(1).take_lease("line", 10_000)
            with pytest.raises(RequestRefused):
                await panel.cs(1).load(1)
            assert (await line.cs(1).run(1)).completed
            await line.cs(1).release_lease()
            assert (await panel.cs(1).run(1)).completed

    in_loop(work())


def test_without_a_machine_connecting_says_what_is_not_there(in_loop: InLoop) -> None:
    async def work() -> None:
        with pytest.raises(ConnectError, match=r"no connection to mqtt://127\.0\.0\.1:9/none"):
            await Plc.connect("mqtt://user:secret@127.0.0.1:9/none", timeout_s=0.5)

    in_loop(work())


def test_without_a_connection_nothing_is_sent_and_a_command_that_was_sent_is_not_known(
    tandem_machine: Machine, in_loop: InLoop
) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            tandem_machine.kill()
            await plc.until(lambda: not plc.is_connected)
            with pytest.raises(NotConnected, match="nothing was sent"):
                await plc.cs(1).command("start", timeout_s=0.2)
        with pytest.raises(NotConnected):
            await plc.cs(1).command("start", timeout_s=0.2)

    in_loop(work())


def test_a_command_without_an_answer_can_be_repeated_by_its_id(tandem_machine: Machine, in_loop: InLoop) -> None:
    async def work() -> None:
        async with Plc.connect(tandem_machine.mqtt) as plc:
            # ten seconds of motion: the answer to an MDI comes at its end
            with pytest.raises(NoAnswer) as unknown:
                await plc.cs(1).mdi("G01 X400 F24000", timeout_s=0.1)
            assert unknown.value.command_id is not None
            reply = await plc.cs(1).mdi("G01 X400 F24000", command_id=unknown.value.command_id)
            assert reply.status == "done"

    in_loop(work())
