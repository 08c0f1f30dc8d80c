"""Each method once by a user who may, with its effect, and once by a user who may not, without any."""

from __future__ import annotations

import asyncio
import json
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest
from asyncua import Client, ua
from machine import OWN, Machine, in_loop, served
from test_methods import call, client_of, guarded, uint, value

__all__ = ["guarded"]

U16, U32, U64 = ua.VariantType.UInt16, ua.VariantType.UInt32, ua.VariantType.UInt64
NO_STRINGS = ua.Variant([], ua.VariantType.String, is_array=True)


def packet(kind: int, body: bytes) -> bytes:
    """An MQTT packet of less than 16 KiB."""
    low, high = len(body) % 128, len(body) // 128
    return bytes([kind]) + (bytes([low | 128, high]) if high else bytes([low])) + body


def text(said: str) -> bytes:
    """A text with its length."""
    return struct.pack(">H", len(said)) + said.encode()


@contextmanager
def handler(machine: Machine, token: str) -> Iterator[None]:
    """A handler of M20 with a presence over MQTT; its connection ends like that of a process that dies."""
    with socket.create_connection(("127.0.0.1", machine.mqtt), timeout=10) as link:
        topic = "tandem/v1/mill-1/handler/handler/presence"
        # MQTT 3.1.1 with user, password and a retained will
        head = text("MQTT") + bytes([4, 0b1110_0110]) + struct.pack(">H", 0)
        will = text(topic) + text(json.dumps({"online": False, "handles": []}))
        link.sendall(packet(0x10, head + text("handler") + will + text("handler") + text(token)))
        assert link.recv(4) == b"\x20\x02\x00\x00", "the broker takes the handler"
        presence = {"online": True, "handles": [{"cs": 1, "m": 20}]}
        link.sendall(packet(0x31, text(topic) + json.dumps(presence).encode()))
        yield
        # without a DISCONNECT packet, the broker publishes the will
        link.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))


async def until(read: Callable[[], Any], holds: Callable[[Any], bool]) -> Any:
    """Read in another thread until it holds."""
    return await asyncio.to_thread(Machine.until_true, read, holds)


async def names(client: Client) -> set[str]:
    """Methods of a coordinate system."""
    own = await client.get_namespace_index(OWN)
    node = client.get_node(ua.NodeId("Tandem/cs1", own))
    return {(await method.read_browse_name()).Name for method in await node.get_children(nodeclassmask=ua.NodeClass.Method)}


def test_each_method_does_what_it_says_for_an_operator(guarded: tuple[Machine, dict[str, str]]) -> None:
    machine, tokens = guarded
    called = set()

    async def run(address: str) -> None:
        async with client_of(address, "operate", tokens["operate"]) as client:

            async def done(method: str, *inputs: Any) -> None:
                called.add(method)
                assert (await call(client, method, *inputs))[0] in ("ok", "accepted"), method

            async def waits() -> tuple[str, ua.Variant]:
                await asyncio.to_thread(machine.until, "WAIT")
                output = await asyncio.to_thread(machine.open_m_code)
                return await value(client, "Tandem/BootId"), uint(output["seq"], U64)

            def state() -> Any:
                return machine.get("/cs/1/state")

            def outputs() -> Any:
                return machine.get("/cs/1/m_codes")["outputs"]

            await done("SetOverrides", 90.0, 80.0, 70.0)
            assert machine.get("/cs/1/overrides") | {"feed": 90, "rapid": 80, "spindle": 70} == machine.get("/cs/1/overrides")
            await done("SetInput", "optional_stop", True)
            assert state()["optional_stop"] is True
            await done("Home", NO_STRINGS)
            await until(state, lambda now: now["run_kind"] is None)
            await done("Load", uint(7, U16))
            assert (state()["program"], state()["execution"]) == (7, "READY")
            await done("Start")
            boot, first = await waits()
            await done("ResetMCode", boot, first)
            await until(outputs, lambda open_codes: open_codes and open_codes[0]["m"] == 21)
            boot, second = await waits()
            await done("FailMCode", boot, second, uint(5, U16), "the clamp is stuck")
            await asyncio.to_thread(machine.until, "STOPPED")
            alarm = machine.get("/alarms")["alarms"][0]
            assert (alarm["number"], alarm["text"]) == (10005, "the clamp is stuck")
            await done("AcknowledgeAlarm", uint(alarm["id"], U64))
            assert machine.get("/alarms")["alarms"][0]["acknowledged_by"] == "operate"
            await done("Reset")
            assert machine.get("/alarms")["alarms"] == []
            await done("Mdi", "G01 X30 F300")
            await asyncio.to_thread(machine.until, "ACTIVE")
            await done("Hold")
            await asyncio.to_thread(machine.until, "FEED_HOLD")
            await done("Resume")
            await asyncio.to_thread(machine.until, "ACTIVE")
            await done("Stop")
            assert (state()["execution"], state()["reason"]) == ("STOPPED", "STOP")
            await done("Reset")
            await done("Run", uint(7, U16), uint(2, U32))
            boot, seq = await waits()
            assert machine.get("/cs/1/run")["run"]["parts"] == 2
            of_handler = {"boot_id": boot, "handler_id": "handler"}
            path = f"/cs/1/m_codes/{seq.Value}"
            with handler(machine, tokens["handler"]):
                await until(lambda: machine.get("/handlers"), lambda all_of_them: "handler" in json.dumps(all_of_them))
                await asyncio.to_thread(machine.ask, "POST", f"{path}/claim", of_handler, tokens["handler"])
                question = of_handler | {"question_id": "q", "text": "Is the part clamped?", "choices": ["yes", "no"]}
                await asyncio.to_thread(machine.ask, "POST", f"{path}/ask", question, tokens["handler"])
                await done("Answer", boot, seq, "q", "yes")
                await until(outputs, lambda open_codes: open_codes[0]["question"]["answer"] == "yes")
            await until(state, lambda now: now["reason"] == "HANDLER_LOST")
            await done("RedeliverMCode", boot, seq, "verify")
            await until(outputs, lambda open_codes: open_codes[0].get("how") == "verify")
            await done("Abort")
            assert (state()["execution"], state()["reason"]) == ("STOPPED", "ABORTED")
            assert called == await names(client), "each was called"

    with served(machine, user=f"view:{tokens['view']}") as address:
        in_loop(run(address))


INPUTS: dict[str, tuple[Any, ...]] = {
    "Load": (uint(7, U16),),
    "Run": (uint(7, U16), uint(2, U32)),
    "Mdi": ("G00 X1",),
    "Home": (NO_STRINGS,),
    "AcknowledgeAlarm": (uint(1, U64),),
    "SetOverrides": (50.0, 50.0, 50.0),
    "SetInput": ("dry_run", True),
    "ResetMCode": ("boot", uint(1, U64)),
    "FailMCode": ("boot", uint(1, U64), uint(5, U16), "stuck"),
    "RedeliverMCode": ("boot", uint(1, U64), "redo"),
    "Answer": ("boot", uint(1, U64), "q", "yes"),
}
"""Inputs of those that have some."""


def test_each_method_is_refused_to_a_user_who_may_only_look_and_nothing_changes(guarded: tuple[Machine, dict[str, str]]) -> None:
    machine, tokens = guarded

    async def attempt(address: str) -> None:
        topics = ("state", "overrides", "m_codes", "run")
        before = [machine.get(f"/cs/1/{topic}") for topic in topics]
        async with client_of(address, "view", tokens["view"]) as client:
            for method in sorted(await names(client)):
                with pytest.raises(ua.UaStatusCodeError) as refused:
                    await call(client, method, *INPUTS.get(method, ()))
                assert refused.value.code == ua.StatusCodes.BadUserAccessDenied, method
        assert [machine.get(f"/cs/1/{topic}") for topic in topics] == before

    with served(machine, user=f"view:{tokens['view']}") as address:
        in_loop(attempt(address))
