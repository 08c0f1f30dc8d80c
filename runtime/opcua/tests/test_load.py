"""Many clients, one that reads nothing, and encrypted ones."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import Any

from asyncua import Client, ua
from asyncua.crypto.cert_gen import setup_self_signed_certificate
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography.x509.oid import ExtendedKeyUsageOID
from machine import OWN, Machine, in_loop, served

CLIENTS = 100


class Seen:
    """Values that a subscription has got."""

    def __init__(self) -> None:
        self.values: list[Any] = []

    def datachange_notification(self, _node: Any, value: Any, _data: Any) -> None:
        """Take a value."""
        self.values.append(value)


def test_a_hundred_clients_are_told_beside_one_that_reads_nothing(machine: Machine) -> None:
    async def watch(address: str) -> None:
        host, port = address.removeprefix("opc.tcp://").rstrip("/").split(":")
        # it says hello in half, and never reads
        _, idle = await asyncio.open_connection(host, int(port))
        idle.write(b"HELF")
        silent = Client(address, timeout=20, watchdog_intervall=60)
        await silent.connect()
        own = await silent.get_namespace_index(OWN)
        state = ua.NodeId("Tandem/cs1/State", own)
        silent_seen = Seen()
        subscription = await silent.create_subscription(100, silent_seen)
        await subscription.subscribe_data_change(silent.get_node(state))
        silent.uaclient.protocol.transport.pause_reading()
        clients = [Client(address, timeout=20, watchdog_intervall=60) for _ in range(CLIENTS)]
        seen = [Seen() for _ in clients]
        for client, one in zip(clients, seen, strict=True):
            await client.connect()
            subscription = await client.create_subscription(100, one)
            await subscription.subscribe_data_change(client.get_node(state))
        machine.command(1, "load", program=7)
        machine.ask("POST", "/cs/1/start", {})
        end = time.monotonic() + 10
        while not all("WAIT" in one.values for one in seen):
            assert time.monotonic() < end, sum("WAIT" in one.values for one in seen)
            await asyncio.sleep(0.1)
        for client in clients:
            await client.disconnect()
        silent.uaclient.protocol.transport.resume_reading()
        await silent.disconnect()
        idle.close()

    with served(machine) as address:
        in_loop(watch(address))


def test_a_client_reads_signed_and_encrypted_by_basic256sha256(machine: Machine, tmp_path: Path) -> None:
    async def read(address: str) -> None:
        key, certificate = tmp_path / "key.pem", tmp_path / "certificate.der"
        uri = "urn:tandem:test"
        await setup_self_signed_certificate(key, certificate, uri, "localhost", [ExtendedKeyUsageOID.CLIENT_AUTH], {})
        client = Client(address, timeout=20, watchdog_intervall=60)
        client.application_uri = uri
        await client.set_security(
            SecurityPolicyBasic256Sha256, str(certificate), str(key), mode=ua.MessageSecurityMode.SignAndEncrypt
        )
        async with client:
            own = await client.get_namespace_index(OWN)
            said = await client.get_node(ua.NodeId("Tandem/Machine", own)).read_value()
            assert said == "mill-1"

    with served(machine, options=("--trust-any-client",)) as address:
        in_loop(read(address))
