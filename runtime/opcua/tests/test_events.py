"""Alarms and messages as events."""

from __future__ import annotations

import asyncio
from typing import Any

from asyncua import Client, ua
from machine import CNC, OWN, Machine, in_loop, served
from test_methods import call, client_of, uint


ALARM, MESSAGE = 1006, 1011
"""CncAlarmType and CncMessageType."""

FIELDS = {
    ua.ObjectIds.BaseEventType: ("EventType", "SourceNode", "SourceName", "Message", "Severity", "Time"),
    ua.ObjectIds.ConditionType: ("ConditionName", "Retain"),
    ua.ObjectIds.AcknowledgeableConditionType: ("AckedState/Id",),
    ua.ObjectIds.AlarmConditionType: ("ActiveState/Id",),
}
"""Fields by the type that declares them."""


def field(type_id: ua.NodeId, path: list[ua.QualifiedName]) -> ua.SimpleAttributeOperand:
    """A field of an event."""
    return ua.SimpleAttributeOperand(TypeDefinitionId=type_id, BrowsePath=path, AttributeId=ua.AttributeIds.Value)


class Events:
    """What a subscription has got."""

    def __init__(self) -> None:
        self.got: asyncio.Queue[Any] = asyncio.Queue()

    def event_notification(self, event: Any) -> None:
        """Take an event."""
        self.got.put_nowait(event)

    async def next(self) -> Any:
        """The next event."""
        return await asyncio.wait_for(self.got.get(), 10)


async def subscribe(client: Client, source: Any, event_type: int) -> Events:
    """Subscribe to events of a type of OPC 40502."""
    cnc = await client.get_namespace_index(CNC)
    events = Events()
    subscription = await client.create_subscription(100, events)
    wanted = ua.EventFilter()
    for type_id, names in FIELDS.items():
        for name in names:
            wanted.SelectClauses.append(field(ua.NodeId(type_id), [ua.QualifiedName(part) for part in name.split("/")]))
    if event_type == ALARM:
        for name in ("AlarmIdentifier", "AuxParameters", "HelpSource"):
            wanted.SelectClauses.append(field(ua.NodeId(ALARM, cnc), [ua.QualifiedName(name, cnc)]))
    # a client's own clause is a list of types, which the library of the server does not compare
    type_node = ua.LiteralOperand(ua.Variant(ua.NodeId(event_type, cnc)))
    wanted.WhereClause = ua.ContentFilter([ua.ContentFilterElement(ua.FilterOperator.OfType, [type_node])])
    await subscription.subscribe_events(source, evfilter=wanted)
    return events


def test_an_alarm_is_an_event_when_it_comes_is_acknowledged_and_goes(machine: Machine) -> None:
    machine.ask("PUT", "/programs/8", "N10 G90 G54\nN20 M77\nN30 M30\n")

    async def watch(address: str) -> None:
        async with client_of(address, "anna", "any") as client:
            own = await client.get_namespace_index(OWN)
            cnc = await client.get_namespace_index(CNC)
            sources = client.get_node(ua.NodeId("CNC", own)), client.nodes.server
            both = [await subscribe(client, source, ALARM) for source in sources]
            machine.command(1, "load", program=8)
            machine.ask("POST", "/cs/1/start", {})
            machine.until("STOPPED")
            alarm = machine.get("/alarms")["alarms"][0]
            explained = machine.get("/explain/300")["text"]
            for events in both:
                event = await events.next()
                assert event.EventType == ua.NodeId(ALARM, cnc)
                assert event.SourceNode == ua.NodeId("CNC/CncChannelList/cs1", own)
                assert event.Message.Text == alarm["text"]
                assert event.AlarmIdentifier == "300"
                assert event.HelpSource == explained
                assert set(event.AuxParameters) >= {"program=8", "line=2"}
                assert event.Severity == 900
                assert getattr(event, "ActiveState/Id") is True
                assert getattr(event, "AckedState/Id") is False
                assert event.Retain is True
            assert (await call(client, "AcknowledgeAlarm", uint(alarm["id"], ua.VariantType.UInt64)))[0] == "ok"
            for events in both:
                event = await events.next()
                assert getattr(event, "AckedState/Id") is True
                assert getattr(event, "ActiveState/Id") is True
            assert (await call(client, "Reset"))[0] == "ok"
            for events in both:
                event = await events.next()
                assert getattr(event, "ActiveState/Id") is False
                assert event.Retain is False
            assert all(events.got.empty() for events in both), "no event comes twice"

    with served(machine) as address:
        in_loop(watch(address))


def test_what_a_handler_says_is_a_message(machine: Machine) -> None:
    async def watch(address: str) -> None:
        async with client_of(address) as client:
            own = await client.get_namespace_index(OWN)
            events = await subscribe(client, client.get_node(ua.NodeId("CNC", own)), MESSAGE)
            machine.command(1, "load", program=7)
            machine.ask("POST", "/cs/1/start", {})
            machine.until("WAIT")
            seq = machine.open_m_code()["seq"]
            boot_id = machine.get("/cs/1/m_codes")["boot_id"]
            said = {"boot_id": boot_id, "handler_id": "clamp"}
            machine.ask("POST", f"/cs/1/m_codes/{seq}/claim", said)
            machine.ask("POST", f"/cs/1/m_codes/{seq}/progress", said | {"text": "the clamp closes"})
            event = await events.next()
            assert event.Message.Text == "the clamp closes"
            assert event.SourceName == "cs1"

    with served(machine) as address:
        in_loop(watch(address))
