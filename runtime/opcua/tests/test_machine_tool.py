"""The machine tool of OPC 40501: its nodes have the values of REST, through a run, pauses, an alarm and a restart."""

from __future__ import annotations

import subprocess
from typing import Any

import pytest
from asyncua import Client, Node, ua
from machine import MACHINE_TOOL, MACHINERY, OWN, TANDEM, Machine, in_loop, served
from test_lost import until
from test_nodes import PAUSED, differences, unmapped, variables

PROGRAM = "N10 G17 G90 G54\nN20 M00\nN30 M20\nN40 G01 X20 F600\nN50 M77\nN60 M30\n"
"""Program 8: it pauses, waits, moves, and reaches an M code without a handler."""

MODES = {None: 0, "program": 0, "mdi": 1, "jog": 2, "home": 6}
"""ChannelMode of a run."""

STATES = {"Initializing": (0, 5039), "Running": (1, 5041), "Ended": (2, 5038), "Interrupted": (3, 5040), "Aborted": (4, 5037)}
"""Number and node of the states of a program."""


def program_state(state: dict[str, Any]) -> str:
    """The state of the active program, by the words of OPC 40501."""
    word = state["execution"]
    if state["run_kind"] in ("jog", "home", "mdi") or state["program"] is None or word == "READY":
        return "Initializing"
    if word in PAUSED:
        return "Interrupted"
    return {"ACTIVE": "Running", "WAIT": "Running", "PROGRAM_COMPLETED": "Ended", "STOPPED": "Aborted"}[word]


def channel(machine: Machine, cs: int) -> dict[str, Any]:
    """Expected values of a monitored channel and its spindle, from REST."""
    state, overrides = machine.get(f"/cs/{cs}/state"), machine.get(f"/cs/{cs}/overrides")
    word = state["execution"]
    path = f"MachineTool/Monitoring/cs{cs}"
    expected = {
        f"{path}/Name": f"cs{cs}",
        f"{path}/ChannelState": 0 if word in ("ACTIVE", "WAIT") else 1 if word in PAUSED else 2,
        f"{path}/ChannelMode": MODES[state["run_kind"]],
        f"{path}/FeedOverride": overrides["feed"],
        f"{path}/RapidOverride": overrides["rapid"],
        f"{path}/ChannelModifiers/BlockSkip": bool(state["optional_skip"]),
        f"{path}/ChannelModifiers/DryRun": state["dry_run"],
        f"{path}/ChannelModifiers/OptionalStop": state["optional_stop"],
        f"{path}/ChannelModifiers/SingleStep": state["single_block"],
    }
    if cs == 1:
        spindle = "MachineTool/Monitoring/S"
        expected |= {
            f"{spindle}/Name": "S",
            f"{spindle}/IsRotating": machine.get("/cs/1/position")["spindle_rpm"] != 0,
            f"{spindle}/Override": overrides["spindle"],
        }
    return expected


def whole(machine: Machine, last: tuple[str, int, int] | None) -> dict[str, Any]:
    """Expected values of all nodes, from REST, with the name, number and node of the last transition."""
    version = subprocess.run([TANDEM, "--version"], capture_output=True, text=True, check=True).stdout.split()[1]
    states = [machine.get(f"/cs/{cs}/state") for cs in (1, 2)]
    plate = machine.get("/machine")["identification"]
    is_by_hand = any(state["run_kind"] in ("jog", "home", "mdi") for state in states)
    is_alarm = any(alarm["severity"] == "alarm" for alarm in machine.get("/alarms")["alarms"])
    is_active = any(state["execution"] in ("ACTIVE", "WAIT") for state in states)
    item = ("OutOfService", 5004) if is_alarm else ("Executing", 5006) if is_active else ("NotExecuting", 5007)
    mode = ("Setup", 5061) if is_by_hand else ("Processing", 5060)
    program = program_state(states[0])
    about = "MachineTool/Identification"
    software = f"{about}/SoftwareIdentification/Tandem"
    monitoring = "MachineTool/Monitoring/MachineTool"
    active = "MachineTool/Production/ActiveProgram"
    expected = {
        f"{about}/ComponentName": "mill-1",
        f"{about}/Manufacturer": plate["manufacturer"],
        f"{about}/SerialNumber": plate["serial_number"],
        f"{about}/ProductInstanceUri": plate["product_instance_uri"],
        f"{about}/Location": plate["location"],
        f"{about}/SoftwareRevision": version,
        f"{software}/Identifier": "Tandem",
        f"{software}/Manufacturer": "Tandem",
        f"{software}/SoftwareRevision": version,
        f"{monitoring}/OperationMode": 0 if is_by_hand else 1,
        f"{monitoring}/MachineryItemState/CurrentState": item[0],
        f"{monitoring}/MachineryItemState/CurrentState/Id": str(item[1]),
        f"{monitoring}/MachineryOperationMode/CurrentState": mode[0],
        f"{monitoring}/MachineryOperationMode/CurrentState/Id": str(mode[1]),
        f"{active}/Name": "" if states[0]["program"] is None else str(states[0]["program"]),
        f"{active}/NumberInList": 0,
        f"{active}/JobIdentifier": states[0]["run_id"] or "",
        f"{active}/State/CurrentState": program,
        f"{active}/State/CurrentState/Number": STATES[program][0],
        f"{active}/State/CurrentState/Id": str(STATES[program][1]),
    }
    if last:
        transition = f"{active}/State/LastTransition"
        expected |= {transition: last[0], f"{transition}/Number": last[1], f"{transition}/Id": str(last[2])}
    return expected | channel(machine, 1) | channel(machine, 2)


async def machine_tool(client: Client) -> Node:
    """The machine, by the way that clients look for it."""
    machinery = await client.get_namespace_index(MACHINERY)
    own = await client.get_namespace_index(OWN)
    found = await client.nodes.objects.get_child([f"{machinery}:Machines", f"{own}:mill-1"])
    kind = await found.read_type_definition()
    assert kind == ua.NodeId(13, await client.get_namespace_index(MACHINE_TOOL)), "MachineToolType"
    return found


@pytest.mark.parametrize("transport", ["http", "mqtt"])
def test_each_node_of_the_machine_tool_tells_what_rest_tells(machine: Machine, transport: str) -> None:
    machine.ask("PUT", "/programs/8", PROGRAM)

    async def compare(address: str) -> None:
        async with Client(address, timeout=20, watchdog_intervall=60) as client:
            nodes = await variables(await machine_tool(client), {})

            async def agree(last: tuple[str, int, int] | None) -> None:
                assert await differences(client, nodes, lambda: whole(machine, last)) == {}

            machine.command(1, "load", program=8)
            await agree(None)
            machine.ask("POST", "/cs/1/start", {})
            machine.until("PROGRAM_STOPPED")
            await agree(("RunningToInterrupted", 4, 109))
            machine.ask("PUT", "/cs/1/overrides", {"feed": 60, "rapid": 25, "spindle": 80})
            machine.ask("PUT", "/cs/1/inputs/single_block", {"value": True})
            machine.ask("PUT", "/cs/1/inputs/optional_stop", {"value": True})
            machine.ask("PUT", "/cs/1/inputs/optional_skip/3", {"value": True})
            await agree(("RunningToInterrupted", 4, 109))
            machine.ask("PUT", "/cs/1/inputs/single_block", {"value": False})
            machine.ask("POST", "/cs/1/resume", {})
            machine.until("WAIT")
            await agree(("InterruptedToRunning", 5, 107))
            assert machine.reset_m_code() == 20
            machine.until("ACTIVE")
            machine.command(1, "hold")
            machine.until("FEED_HOLD")
            await agree(("RunningToInterrupted", 4, 109))
            machine.ask("PUT", "/cs/1/overrides", {"feed": 200})
            machine.ask("POST", "/cs/1/resume", {})
            machine.until("STOPPED")
            await agree(("RunningToAborted", 6, 108))
            assert machine.get("/alarms")["alarms"], "an M code without a handler is an alarm"
            machine.command(1, "reset")
            await agree(("AbortedToInitializing", 8, 102))
            machine.ask("POST", "/cs/1/mdi", {"text": "M20"})
            machine.until("WAIT")
            await agree(("AbortedToInitializing", 8, 102))
            machine.end()
            state = "MachineTool/Production/ActiveProgram/State/CurrentState"
            await until(client, state, "BadNoCommunication")
            machine.start()
            await until(client, state, "Good")
            await agree(None)

    with served(machine, transport) as address:
        in_loop(compare(address))


def test_what_the_machine_does_not_know_of_the_machine_tool_says_so(machine: Machine) -> None:
    text = machine.config.read_text().replace('serial_number = "4711"\n', "").replace('location = "hall 2"\n', "")
    machine.end()
    machine.config.write_text(text)
    machine.start()

    async def look(address: str) -> None:
        async with Client(address, timeout=20, watchdog_intervall=60) as client:
            own = await client.get_namespace_index(OWN)
            nodes = await variables(await machine_tool(client), {})
            last = "MachineTool/Production/ActiveProgram/State/LastTransition"
            for path in (last, f"{last}/Id", f"{last}/Number"):
                await until(client, path, "BadWaitingForInitialData")
                del nodes[path]
            await until(client, "MachineTool/Identification/SerialNumber", "BadNotSupported")
            with pytest.raises(ua.UaStatusCodeError):
                await client.get_node(ua.NodeId("MachineTool/Identification/Location", own)).read_browse_name()
            del nodes["MachineTool/Identification/SerialNumber"]
            assert await unmapped(nodes, {path: True for path in nodes}) == [], "all others are known"

    with served(machine) as address:
        in_loop(look(address))
