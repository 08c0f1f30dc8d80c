"""A machine that goes and comes back."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import pytest
from asyncua import Client, ua
from machine import OWN, Machine, in_loop, served


async def until(client: Client, path: str, status: str) -> Any:
    """Wait until a value has a status: the value."""
    own = await client.get_namespace_index(OWN)
    end = time.monotonic() + 20
    while True:
        said = await client.get_node(ua.NodeId(path, own)).read_data_value(raise_on_bad_status=False)
        if said.StatusCode.name == status:
            return said.Value.Value if said.Value else None
        assert time.monotonic() < end, (path, said)
        await asyncio.sleep(0.1)


@pytest.mark.parametrize("transport", ["http", "mqtt"])
def test_no_value_stays_good_while_the_machine_is_away_and_all_are_good_after_its_restart(
    machine: Machine, transport: str
) -> None:
    async def watch(address: str) -> None:
        async with Client(address, timeout=20, watchdog_intervall=60) as client:
            boot = await until(client, "Tandem/BootId", "Good")
            paths = [
                "CNC/CncChannelList/cs1/ActProgramStatus",
                "CNC/CncChannelList/cs2/PosTcpBcsX/ActPos",
                "CNC/CncSpindleList/S/ActSpeed",
                "Tandem/cs1/State",
                "Tandem/AlarmIds",
            ]
            for path in paths:
                await until(client, path, "Good")
            machine.end()
            for path in paths:
                assert await until(client, path, "BadNoCommunication") is None
            machine.start()
            for path in paths:
                await until(client, path, "Good")
            assert await until(client, "Tandem/BootId", "Good") != boot
            assert await until(client, "Tandem/cs1/State", "Good") == machine.get("/cs/1/state")["execution"]

    with served(machine, transport) as address:
        in_loop(watch(address))


def test_a_machine_that_comes_back_as_another_one_has_its_own_nodes(machine: Machine) -> None:
    async def watch(address: str) -> None:
        async with Client(address, timeout=20, watchdog_intervall=60) as client:
            own = await client.get_namespace_index(OWN)
            await until(client, "CNC/CncChannelList/cs2/ToolId", "Good")
            machine.end()
            text = machine.config.read_text()
            machine.config.write_text(text.replace("axes = { X = 5, Z = 6 }", "axes = { X = 5, Y = 6 }"))
            machine.start()
            await until(client, "CNC/CncChannelList/cs2/PosTcpBcsY/ActPos", "Good")
            await until(client, "CNC/CncAxisList/Y2/PosDirect/ActPos", "Good")
            with pytest.raises(ua.UaStatusCodeError):
                await client.get_node(ua.NodeId("CNC/CncAxisList/Z2", own)).read_browse_name()

    with served(machine) as address:
        in_loop(watch(address))
