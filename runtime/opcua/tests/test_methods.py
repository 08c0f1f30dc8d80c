"""Commands and M codes, with the rights of the logged-in user."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from machine import OWN, Machine, in_loop, served


@asynccontextmanager
async def client_of(address: str, user: str | None = None, token: str | None = None) -> AsyncIterator[Client]:
    """A session."""
    client = Client(address, timeout=20, watchdog_intervall=60)
    if user:
        client.set_user(user)
        client.set_password(token)
    async with client:
        yield client


async def call(client: Client, method: str, *inputs: Any, cs: int = 1) -> list[str]:
    """Call a method of a coordinate system: its code and text."""
    own = await client.get_namespace_index(OWN)
    node = client.get_node(ua.NodeId(f"Tandem/cs{cs}", own))
    said: list[str] = await node.call_method(ua.NodeId(f"Tandem/cs{cs}/{method}", own), *inputs)
    return said


async def value(client: Client, path: str) -> Any:
    """The value of a variable."""
    own = await client.get_namespace_index(OWN)
    return await client.get_node(ua.NodeId(path, own)).read_value()


def uint(value: int, kind: ua.VariantType) -> ua.Variant:
    """A number of a type."""
    return ua.Variant(value, kind)


@pytest.fixture
def guarded(tmp_path: Path) -> Any:
    """A machine with users; the test's own is its administrator."""
    machine = Machine(tmp_path, 'token_file = "tokens.toml"')
    machine.token = machine.user("boss", "admin")
    tokens = {role: machine.user(role, role) for role in ("view", "operate", "handler")}
    machine.start()
    yield machine, tokens
    machine.end()


@pytest.mark.parametrize("transport", ["http", "mqtt"])
def test_an_operator_runs_a_program_by_methods(guarded: tuple[Machine, dict[str, str]], transport: str) -> None:
    machine, tokens = guarded

    async def run(address: str) -> None:
        async with client_of(address, "operate", tokens["operate"]) as client:
            assert (await call(client, "Load", uint(7, ua.VariantType.UInt16)))[0] == "ok"
            assert (await call(client, "SetOverrides", 100.0, 100.0, 50.0))[0] == "ok"
            assert machine.get("/cs/1/overrides")["spindle"] == 50
            assert (await call(client, "Start"))[0] == "ok"
            for m in (20, 21, 22):
                machine.until("WAIT")
                machine.until_true(lambda m=m: machine.get("/cs/1/m_codes")["outputs"], lambda all, m=m: all and all[0]["m"] == m)
                open_code = machine.open_m_code()
                while await value(client, "Tandem/cs1/MCodes") != [m]:
                    await asyncio.sleep(0.05)
                seqs = await value(client, "Tandem/cs1/MCodeSeqs")
                assert seqs == [open_code["seq"]]
                boot = await value(client, "Tandem/BootId")
                answer = await call(client, "ResetMCode", boot, uint(seqs[0], ua.VariantType.UInt64))
                assert answer[0] == "accepted"
            machine.until("PROGRAM_COMPLETED")
            lines = machine.get("/journal?count=1000")["lines"]
            assert any(line.get("user") == "operate" for line in lines), "the journal names the user"

    with served(machine, transport, user=f"view:{tokens['view']}") as address:
        in_loop(run(address))


def test_a_wrong_role_is_refused_by_the_machine_and_nothing_changes(guarded: tuple[Machine, dict[str, str]]) -> None:
    machine, tokens = guarded

    async def attempt(address: str) -> None:
        machine.command(1, "load", program=7)
        for role in ("view", "handler"):
            async with client_of(address, role, tokens[role]) as client:
                for method in ("Start", "Hold", "Reset"):
                    with pytest.raises(ua.UaStatusCodeError) as refused:
                        await call(client, method)
                    assert refused.value.code == ua.StatusCodes.BadUserAccessDenied, (role, method)
        assert machine.get("/cs/1/state")["execution"] == "READY"
        async with client_of(address, "operate", tokens["operate"]) as client:
            with pytest.raises(ua.UaStatusCodeError) as refused:
                await call(client, "Resume")
            assert refused.value.code == ua.StatusCodes.BadInvalidState
            with pytest.raises(ua.UaStatusCodeError) as refused:
                await call(client, "Load", uint(4711, ua.VariantType.UInt16))
            assert refused.value.code == ua.StatusCodes.BadNotFound

    with served(machine, user=f"view:{tokens['view']}") as address:
        in_loop(attempt(address))


@pytest.mark.parametrize("transport", ["http", "mqtt"])
def test_a_wrong_token_and_no_user_are_refused_at_the_login(guarded: tuple[Machine, dict[str, str]], transport: str) -> None:
    machine, tokens = guarded

    async def attempt(address: str) -> None:
        wrong: list[tuple[str | None, str | None]] = [("operate", "wrong"), (None, None)]
        if transport == "mqtt":
            # over REST the token alone says who it is
            wrong.append(("nobody", tokens["operate"]))
        for user, token in wrong:
            with pytest.raises(ua.UaStatusCodeError):
                async with client_of(address, user, token):
                    pass

    with served(machine, transport, user=f"view:{tokens['view']}") as address:
        in_loop(attempt(address))


def test_clients_without_a_user_read_and_command_nothing(guarded: tuple[Machine, dict[str, str]]) -> None:
    machine, tokens = guarded

    async def attempt(address: str) -> None:
        async with client_of(address) as client:
            assert await value(client, "Tandem/cs1/State") == machine.get("/cs/1/state")["execution"]
            for method in ("Start", "Hold", "Stop", "Abort"):
                with pytest.raises(ua.UaStatusCodeError) as refused:
                    await call(client, method)
                assert refused.value.code == ua.StatusCodes.BadUserAccessDenied
            own = await client.get_namespace_index(OWN)
            with pytest.raises(ua.UaStatusCodeError):
                await client.get_node(ua.NodeId("Tandem/cs1/State", own)).write_value("READY")

    with served(machine, options=("--anonymous", "read"), user=f"view:{tokens['view']}") as address:
        in_loop(attempt(address))
