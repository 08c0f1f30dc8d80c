"""Every mapped node has the value of REST, through a run."""

from __future__ import annotations

import asyncio
import subprocess
import time
from collections.abc import Callable
from typing import Any

import pytest
from asyncua import Client, Node, ua
from machine import CNC, OWN, TANDEM, Machine, in_loop, served

MODES = {None: 2, "program": 2, "mdi": 1, "jog": 0, "home": 0}
PAUSED = ("FEED_HOLD", "INTERRUPTED", "PROGRAM_STOPPED", "OPTIONAL_STOP")


def program_status(state: dict[str, Any]) -> int:
    """CncChannelProgramStatus of a state, by the words of OPC 40502."""
    if state["run_kind"] in ("jog", "home"):
        return 0
    word = state["execution"]
    if word == "STOPPED" and state["reason"] in ("STOP", "ABORTED", "ALARM", "RESTARTED"):
        return 4
    return 1 if word == "ACTIVE" else 2 if word == "WAIT" else 3 if word in PAUSED else 0


def channel(machine: Machine, cs: int) -> dict[str, Any]:
    """Expected values of the nodes of a channel, its axes and its spindle, from REST."""

    def get(what: str) -> Any:
        return machine.get(f"/cs/{cs}/{what}")

    state, place, position, modal = get("state"), get("program"), get("position"), get("modal")
    overrides, tool, open_codes = get("overrides"), get("tool"), get("m_codes")["outputs"]
    word = state["execution"]
    number = place["number"]
    name = "" if number is None else "MDI" if number == 0 else str(number)
    line = "" if number is None else str(place["line"])
    main_line = str(place["stack"][0]["line"]) if place["stack"] else line
    offset = modal["work_offset"]
    path = f"CNC/CncChannelList/cs{cs}"
    expected: dict[str, Any] = {
        f"{path}/ActProgramStatus": program_status(state),
        f"{path}/ActStatus": 0 if word in ("ACTIVE", "WAIT") else 1 if word in PAUSED else 2,
        f"{path}/ActOperationMode": MODES[state["run_kind"]],
        f"{path}/CmdOperationMode": MODES[state["run_kind"]],
        f"{path}/FeedHold": word == "FEED_HOLD",
        f"{path}/BlockMode": state["single_block"],
        f"{path}/ActMainProgramName": "" if state["program"] is None else str(state["program"]),
        f"{path}/ActProgramName": name,
        f"{path}/ActProgramLine": line,
        f"{path}/ActMainProgramLine": main_line,
        f"{path}/ActProgramBlock": [place["block"]],
        f"{path}/ActGFunctions": [int(code[1:]) for code in modal["g"].values() if code[1:].isdigit()],
        f"{path}/ActModalOffsetFunction": int(offset[1:]) if offset else 0,
        f"{path}/ActMFunctions": [output["m"] for output in open_codes],
        f"{path}/ActFeedrate": position["feedrate"],
        f"{path}/CmdFeedrate": modal["f"],
        f"{path}/ActOverride": overrides["feed"],
        f"{path}/CmdOverride": overrides["feed"],
        f"{path}/ToolId": tool["id"],
        f"{path}/Id": cs,
    }
    suffix = "" if cs == 1 else str(cs)
    for letter, machine_at in position["machine"].items():
        work, left = position["work"][letter], position["distance_to_go"][letter]
        actual = position["actual"][letter]
        axis = f"CNC/CncAxisList/{letter}{suffix}"
        for at, commanded, is_at in (
            (f"{path}/PosTcpBcs{letter}", machine_at, actual),
            (f"{path}/PosTcpWcs{letter}", work, work - position["following_error"][letter]),
            (f"{axis}/PosDirect", machine_at, actual),
        ):
            expected |= {f"{at}/CmdPos": commanded, f"{at}/ActPos": is_at, f"{at}/RemDist": left}
        expected |= {
            f"{axis}/ZeroOffset": machine_at - work,
            f"{axis}/IsReferenced": position["homed"][letter],
            f"{axis}/IsRotational": False,
            f"{axis}/IsVirtual": True,
            f"{axis}/IsInactive": False,
            f"{axis}/ActChannel": path,
        }
        expected[f"{axis}/ActStatus"] = 0
    if cs == 1:
        spindle = get("spindle")
        rpm = position["spindle_rpm"]
        wanted = spindle["rpm"] * overrides["spindle"] / 100 if spindle["direction"] in ("cw", "ccw") else 0
        expected |= {
            "CNC/CncSpindleList/S/ActSpeed": abs(rpm),
            "CNC/CncSpindleList/S/CmdSpeed": spindle["rpm"],
            "CNC/CncSpindleList/S/ActOverride": overrides["spindle"],
            "CNC/CncSpindleList/S/CmdOverride": overrides["spindle"],
            "CNC/CncSpindleList/S/ActTurnDirection": 0 if rpm == 0 else 1 if rpm > 0 else 2,
            "CNC/CncSpindleList/S/ActStatus": 1 if wanted else 0,
            "CNC/CncSpindleList/S/IsVirtual": True,
            "CNC/CncSpindleList/S/IsInactive": False,
            "CNC/CncSpindleList/S/ActChannel": path,
        }
    return expected


def whole(machine: Machine) -> dict[str, Any]:
    """Expected values of all nodes, from REST."""
    version = subprocess.run([TANDEM, "--version"], capture_output=True, text=True, check=True).stdout.split()[1]
    about = {
        "CNC/VendorName": "Tandem",
        "CNC/Version": "1.0.0",
        "CNC/CncTypeName": "mill-1",
        "CNC/VendorRevision": version,
    }
    return about | channel(machine, 1) | channel(machine, 2)


async def variables(node: Node, found: dict[str, Node]) -> dict[str, Node]:
    """All variables below a node, by path."""
    for child in await node.get_children():
        path = str(child.nodeid.Identifier)
        if await child.read_node_class() == ua.NodeClass.Variable:
            found[path] = child
        await variables(child, found)
    return found


def same(value: Any, expected: Any) -> bool:
    """Equal, numbers to a millionth."""
    if isinstance(expected, float):
        return abs(value - expected) <= 1e-6
    return bool(value == expected)


async def differences(client: Client, nodes: dict[str, Node], whole: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Differences between nodes and REST after a moment."""
    end = time.monotonic() + 5
    while True:
        expected = whole()
        missing = {path: "no such node" for path in expected if path not in nodes}
        paths = [path for path in expected if path in nodes]
        read = await client.uaclient.read_attributes([nodes[path].nodeid for path in paths], ua.AttributeIds.Value)
        wrong: dict[str, Any] = missing
        for path, said in zip(paths, read, strict=True):
            value = said.Value.Value if said.Value else None
            value = str(value.Identifier) if isinstance(value, ua.NodeId) else value
            value = value.Text if isinstance(value, ua.LocalizedText) else value
            if not said.StatusCode.is_good() or not same(value, expected[path]):
                wrong[path] = (value, said.StatusCode.name, expected[path])
        if not wrong or time.monotonic() > end:
            return wrong
        await asyncio.sleep(0.1)


@pytest.mark.parametrize("transport", ["http", "mqtt"])
def test_every_mapped_node_tells_what_rest_tells_through_a_run(machine: Machine, transport: str) -> None:
    async def compare(address: str) -> None:
        async with Client(address, timeout=20, watchdog_intervall=60) as client:
            index = await client.get_namespace_index(CNC)
            own = await client.get_namespace_index(OWN)
            interface = await client.nodes.objects.get_child(f"{index}:CncInterface")
            assert interface.nodeid == ua.NodeId("CNC", own)
            nodes = await variables(interface, {})
            assert await differences(client, nodes, lambda: whole(machine)) == {}
            machine.command(1, "load", program=7)
            assert await differences(client, nodes, lambda: whole(machine)) == {}
            machine.ask("POST", "/cs/1/start", {})
            for m in (20, 21):
                machine.until("WAIT")
                assert await differences(client, nodes, lambda: whole(machine)) == {}
                assert machine.reset_m_code() == m
            machine.until("WAIT")
            machine.ask("PUT", "/cs/1/overrides", {"feed": 60, "spindle": 80})
            machine.ask("PUT", "/cs/1/inputs/single_block", {"value": True})
            assert await differences(client, nodes, lambda: whole(machine)) == {}
            assert machine.reset_m_code() == 22
            machine.until("INTERRUPTED")
            assert await differences(client, nodes, lambda: whole(machine)) == {}
            machine.ask("POST", "/cs/1/stop", {})
            machine.until("STOPPED")
            assert await differences(client, nodes, lambda: whole(machine)) == {}

    with served(machine, transport) as address:
        in_loop(compare(address))


async def unmapped(nodes: dict[str, Node], expected: dict[str, Any]) -> list[str]:
    """Nodes with a wrong status: good without a mapping, mapped and not good, or unmapped and not BadNotSupported."""
    wrong = []
    for path, node in nodes.items():
        said = await node.read_data_value(raise_on_bad_status=False)
        is_property = path.endswith(("/EURange", "/EngineeringUnits"))
        is_right = said.StatusCode.is_good() if path in expected else is_property or said.StatusCode.name == "BadNotSupported"
        if not is_right:
            wrong.append(f"{path} {said}")
    return wrong


def test_what_is_not_mapped_says_so_and_nothing_else_is_good(machine: Machine) -> None:
    async def look(address: str) -> None:
        async with Client(address, timeout=20, watchdog_intervall=60) as client:
            index = await client.get_namespace_index(CNC)
            interface = await client.nodes.objects.get_child(f"{index}:CncInterface")
            nodes = await variables(interface, {})
            machine.until_true(lambda: whole(machine), bool)
            await asyncio.sleep(1)
            assert await unmapped(nodes, whole(machine)) == []

    with served(machine) as address:
        in_loop(look(address))
