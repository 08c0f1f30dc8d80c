"""Handlers against a real machine."""

from __future__ import annotations

import asyncio
import os
import re
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tandem_plc import (
    AlarmWords,
    Output,
    Param,
    Params,
    Plc,
    ProgramError,
    RequestRefused,
    SequenceProgram,
    UserAlarm,
    stop_signal,
)
from tandem_plc.testing import DEFAULT_CONFIG, Machine, find_tandem


def pocket(params: Params) -> int:
    return params.whole("A", 1, 24, "the pocket")


def gone(machine: Machine) -> dict[str, Any]:
    """Wait until the machine knows that the program is offline (the broker knows earlier), and return its record."""
    while (cell := machine.rest("GET", "/handlers")["handlers"].get("cell", {})).get("online"):
        time.sleep(0.01)
    said: dict[str, Any] = cell
    return said


def test_the_program_goes_on_when_the_handler_has_returned(tandem_machine: Machine) -> None:
    program, seen = SequenceProgram("changer"), []

    @program.on(6, validate=pocket)
    async def change_tool(output: Output, plc: Plc) -> None:
        seen.append((pocket(output.params), plc.cs(output.cs).state.execution.value, output.line, output.a, output.b))
        await plc.cs(output.cs).select_tool(pocket(output.params))

    with tandem_machine.serve(program):
        run = tandem_machine.run("M06 VA5\nG01 X1 F3000\nM06 VA6 VB-0.5\nM30")
    assert run.completed
    assert seen == [(5, "WAIT", 1, 5.0, None), (6, "WAIT", 3, 6.0, -0.5)]
    assert [line["m"] for line in run.events("reset")] == [6, 6]
    assert tandem_machine.rest("GET", "/cs/1/tool")["id"] == 6


def test_a_program_with_parameters_that_are_not_declared_is_not_loaded(tandem_machine: Machine) -> None:
    program, seen = SequenceProgram("clamp"), []
    force = Param(name="force", unit="kN", min=1, max=20)

    @program.on(12, name="clamp", params={"A": force, "B": Param(whole=True, min=1, max=2, optional=True)})
    async def clamp(output: Output) -> None:
        seen.append((output.a, output.b))

    with tandem_machine.serve(program):
        for text, message in [
            ("M12 VA50", r"line 1: E0191 M12 clamp: VA \(force\) is 50 kN; write 1 to 20 kN"),
            ("M12", r"E0191 M12 clamp needs VA \(force, 1 to 20 kN\)"),
            ("M12 VA5 VC1", r"E0191 M12 clamp takes no VC"),
        ]:
            with pytest.raises(RequestRefused, match=message):
                tandem_machine.run(f"{text}\nM30")
        assert tandem_machine.run("M12 VA5\nM12 VA20 VB2\nM30").completed
        # the value of a variable is known only when the block runs
        run = tandem_machine.run("P3 = 50\nM12 VA[P3]\nM30")
        serves = tandem_machine.rest("GET", "/machine")["serves"]
    late = "A word's value is out of its range: M12 clamp: VA (force) is 50 kN; write 1 to 20 kN"
    assert run.alarms == [f"{late} (declared by handler clamp)"]
    assert seen == [(5.0, None), (20.0, 2.0)]
    told = {
        "A": {"name": "force", "unit": "kN", "min": 1.0, "max": 20.0},
        "B": {"min": 1.0, "max": 2.0, "whole": True, "optional": True},
    }
    expected = {"m": 12, "cs": [1], "handler_id": "clamp", "name": "clamp", "params": told}
    assert [one for one in serves if one["handler_id"] == "clamp"] == [expected]


def test_what_a_program_serves_is_known_without_it_by_its_file(tmp_path: Path) -> None:
    program = SequenceProgram("clamp")
    program.on(12, name="clamp", params={"A": Param(name="force", unit="kN", min=1, max=20)})(_nothing)
    program.on(13, cs=1)(_nothing)
    (tmp_path / "served.json").write_text(program.served())
    (tmp_path / "tandem.toml").write_text(DEFAULT_CONFIG.replace("[machine]", '[machine]\nserved = "served.json"', 1))
    (tmp_path / "1.nc").write_text("M12 VA50\nM13\nM14\nM30\n")
    command = [find_tandem(), "check", "--config", "tandem.toml", "1.nc"]
    said = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=30)
    text = said.stdout + said.stderr
    assert "M12 clamp: VA (force) is 50 kN; write 1 to 20 kN" in text
    assert re.findall("no handler serves (M[0-9]+)", text) == ["M14"]


def test_a_declaration_of_what_cannot_be_is_a_mistake() -> None:
    program = SequenceProgram("clamp")
    for params, message in [
        ({"VA": Param()}, "is not a parameter; write 'A' to 'H'"),
        ({"A": Param(min=2, max=1)}, "VA: min 2 is above max 1"),
        ({"A": Param(unit="")}, "VA: unit '': write 1 to 16 characters"),
    ]:
        with pytest.raises(ProgramError, match=message):
            program.on(12, params=params)(_nothing)


async def _nothing(_output: Output) -> None: ...


def test_a_check_that_fails_refuses_the_program_and_the_program_goes_on_serving(tandem_machine: Machine) -> None:
    program = SequenceProgram("changer")

    @program.on(6, 7)
    async def change_tool(_output: Output) -> None: ...

    @program.validate(6)
    def check(_params: Params) -> None:
        raise ZeroDivisionError("a mistake")

    with tandem_machine.serve(program):
        with pytest.raises(RequestRefused, match="the check of M6 has failed: ZeroDivisionError"):
            tandem_machine.run("M06\nM30")
        assert tandem_machine.run("M07\nM30").completed


NO_AIR = UserAlarm(
    12,
    "the air pressure is low",
    remedy="Open the main valve.",
    languages={"de": AlarmWords("der Luftdruck ist zu niedrig", "Hauptventil öffnen.")},
)


def test_an_alarm_is_shown_with_its_remedy_and_languages(tandem_machine: Machine) -> None:
    program = SequenceProgram("clamp")
    program.alarms(NO_AIR)

    @program.on(10)
    async def clamp(_output: Output) -> None:
        raise NO_AIR.alarm("2.1 bar")

    with tandem_machine.serve(program) as serving:
        assert tandem_machine.run("M10\nM30").alarms == ["the air pressure is low: 2.1 bar"]
        tandem_machine.wait_for(lambda _state: bool(serving.plc.alarms))
        shown = serving.plc.alarms[0]
    assert (shown.number, shown.remedy, shown.languages) == (10_012, NO_AIR.remedy, NO_AIR.languages)


def test_what_is_said_of_alarms_is_checked_where_it_is_written() -> None:
    wrong: list[tuple[Callable[[], object], str]] = [
        (lambda: UserAlarm(10_000, "x"), "alarm 10000: write 0 to 9999"),
        (lambda: UserAlarm(1, ""), "alarm 1: text and remedy: write 1 to 1000 characters"),
        (lambda: UserAlarm(1, "x", remedy=""), "alarm 1: text and remedy"),
        (lambda: UserAlarm(1, "x", languages={"d": AlarmWords("y")}), "language 'd': write a tag"),
        (
            lambda: UserAlarm(1, "x", languages={f"d{n}": AlarmWords("y") for n in range(9)}),
            "9 languages: write up to 8",
        ),
        (
            lambda: SequenceProgram("p").alarms(UserAlarm(1, "x"), UserAlarm(1, "y")),
            "alarm 1 has two texts: 'x' and 'y'",
        ),
        (lambda: SequenceProgram("p").alarms(*(UserAlarm(n, "x") for n in range(257))), "257 alarms: write up to 256"),
    ]
    for make, message in wrong:
        with pytest.raises(ProgramError, match=message):
            make()


def test_a_task_that_fails_while_the_program_is_stopped_ends_it(tandem_machine: Machine) -> None:
    program, stop = SequenceProgram("cell"), asyncio.Event()

    @program.on(20)
    async def rinse(_output: Output) -> None:
        stop.set()
        await asyncio.sleep(1_000)

    @program.task
    async def watch(_plc: Plc) -> None:
        await asyncio.to_thread(tandem_machine.load, "M20\nM30")
        await asyncio.to_thread(tandem_machine.started)
        await stop.wait()
        raise ZeroDivisionError("a mistake")

    async def run() -> None:
        await asyncio.wait_for(program.run_until(tandem_machine.mqtt, stop.wait()), 20)

    with pytest.raises(ZeroDivisionError):
        asyncio.run(run())


@pytest.mark.parametrize("wrong", [-1, 3_600.1, float("nan")])
def test_a_time_in_which_no_program_comes_back_is_a_mistake(wrong: float) -> None:
    async def run() -> None:
        await SequenceProgram("cell").run_until("mqtt://127.0.0.1:9/none", asyncio.sleep(0), returns_within_s=wrong)

    with pytest.raises(ProgramError, match="write 0 to 3600"):
        asyncio.run(run())


def test_a_signal_of_the_system_stops_a_program_and_the_next_one_ends_it() -> None:
    async def run() -> None:
        before = signal.getsignal(signal.SIGTERM)
        stopped = asyncio.ensure_future(stop_signal())
        await asyncio.sleep(0)
        os.kill(os.getpid(), signal.SIGTERM)
        await asyncio.wait_for(stopped, 5)
        assert signal.getsignal(signal.SIGTERM) is before

    asyncio.run(run())


def test_an_exception_stops_the_program_and_no_other_handler(tandem_machine: Machine) -> None:
    program = SequenceProgram("coolant")

    @program.on(7)
    async def coolant(output: Output) -> None:
        if output.a is None:
            raise KeyError("no such valve")

    with tandem_machine.serve(program):
        run = tandem_machine.run("M07\nM30")
        assert run.alarms == ["the handler of M7 has failed: KeyError: 'no such valve'"]
        tandem_machine.rest("POST", "/cs/1/reset?wait=1")
        assert tandem_machine.run("M07 VA1\nM30").completed


def test_what_a_program_owns_is_set_from_its_first_moment_on_and_when_it_changes(tandem_machine: Machine) -> None:
    program = SequenceProgram("cell")
    door = program.interlock(1, "door", "the door is open")

    @program.task
    async def close_it(plc: Plc) -> None:
        await plc.until(lambda: plc.cs(1).interlock.value)
        door.set(False)

    with tandem_machine.serve(program) as serving:
        mill = serving.plc.cs(1)
        tandem_machine.wait_for(lambda _state: bool(mill.interlock.sources) and not mill.interlock.value)
        source = mill.interlock.sources[0]
        assert (source.source, source.handler_id, source.value) == ("door", "cell", False)


def test_a_task_that_fails_ends_the_program(tandem_machine: Machine) -> None:
    program = SequenceProgram("cell")

    @program.task
    async def watch(_plc: Plc) -> None:
        raise ZeroDivisionError("a mistake")

    async def run() -> None:
        await asyncio.wait_for(program.run(tandem_machine.mqtt), 20)

    with pytest.raises(ZeroDivisionError):
        asyncio.run(run())
    assert not gone(tandem_machine)["online"]
