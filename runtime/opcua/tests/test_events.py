"""Alarms and messages as events."""

from __future__ import annotations

import asyncio
from typing import Any

from asyncua import Client, ua
from machine import CNC, MACHINE_TOOL, OWN, Machine, in_loop, served
from test_methods import call, client_of, uint


ALARM, MESSAGE = (CNC, 1006), (CNC, 1011)
"""CncAlarmType and CncMessageType."""

ALERT, NOTIFICATION, TRANSITION = (MACHINE_TOOL, 39), (MACHINE_TOOL, 35), (MACHINE_TOOL, 17)
"""AlertType, NotificationEventType and ProductionProgramTransitionEventType."""

OF_TYPE = {
    ALARM: ("AlarmIdentifier", "AuxParameters", "HelpSource"),
    MESSAGE: (),
    ALERT: ("ErrorCode",),
    NOTIFICATION: ("Identifier",),
    TRANSITION: ("Name", "JobIdentifier"),
}
"""Fields that each type adds."""

FIELDS = {
    ua.ObjectIds.BaseEventType: ("EventType", "SourceNode", "SourceName", "Message", "Severity", "Time"),
    ua.ObjectIds.ConditionType: ("ConditionName", "Retain"),
    ua.ObjectIds.AcknowledgeableConditionType: ("AckedState/Id",),
    ua.ObjectIds.AlarmConditionType: ("ActiveState/Id",),
}
"""Fields by the type that declares them."""

TRANSITION_FIELDS = (ua.ObjectIds.TransitionEventType, ("Transition", "Transition/Id", "FromState", "ToState"))


def field(type_id: ua.NodeId, path: list[ua.QualifiedName]) -> ua.SimpleAttributeOperand:
    """A field of an event."""
    return ua.SimpleAttributeOperand(TypeDefinitionId=type_id, BrowsePath=path, AttributeId=ua.AttributeIds.Value)


class Events:
    """Events of a subscription."""

    def __init__(self) -> None:
        self.got: asyncio.Queue[Any] = asyncio.Queue()

    def event_notification(self, event: Any) -> None:
        """Take an event."""
        self.got.put_nowait(event)

    async def next(self) -> Any:
        """The next event."""
        return await asyncio.wait_for(self.got.get(), 10)


async def subscribe(client: Client, source: Any, event_type: tuple[str, int]) -> Events:
    """Subscribe to events of a type."""
    namespace = await client.get_namespace_index(event_type[0])
    type_id = ua.NodeId(event_type[1], namespace)
    events = Events()
    subscription = await client.create_subscription(100, events)
    wanted = ua.EventFilter()
    known = FIELDS | ({TRANSITION_FIELDS[0]: TRANSITION_FIELDS[1]} if event_type == TRANSITION else {})
    for declared_by, names in known.items():
        for name in names:
            wanted.SelectClauses.append(field(ua.NodeId(declared_by), [ua.QualifiedName(part) for part in name.split("/")]))
    for name in OF_TYPE[event_type]:
        wanted.SelectClauses.append(field(type_id, [ua.QualifiedName(name, namespace)]))
    # a client's own clause is a list of types, which the library of the server does not compare
    type_node = ua.LiteralOperand(ua.Variant(type_id))
    wanted.WhereClause = ua.ContentFilter([ua.ContentFilterElement(ua.FilterOperator.OfType, [type_node])])
    await subscription.subscribe_events(source, evfilter=wanted, queuesize=100)
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
                assert event.EventType == ua.NodeId(ALARM[1], cnc)
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
            path, said = machine.claim_m_code()
            machine.ask("POST", f"{path}/progress", said | {"text": "the clamp closes"})
            event = await events.next()
            assert event.Message.Text == "the clamp closes"
            assert event.SourceName == "cs1"

    with served(machine) as address:
        in_loop(watch(address))


def test_an_alarm_is_an_alert_of_the_machine_tool(machine: Machine) -> None:
    machine.ask("PUT", "/programs/8", "N10 G90 G54\nN20 M77\nN30 M30\n")

    async def watch(address: str) -> None:
        async with client_of(address, "anna", "any") as client:
            own = await client.get_namespace_index(OWN)
            messages = client.get_node(ua.NodeId("MachineTool/Notification/Messages", own))
            both = [await subscribe(client, source, ALERT) for source in (messages, client.nodes.server)]
            machine.command(1, "load", program=8)
            machine.ask("POST", "/cs/1/start", {})
            machine.until("STOPPED")
            alarm = machine.get("/alarms")["alarms"][0]
            # an alarm that is cleared before the server has read it is no event
            alerts = [await events.next() for events in both]
            machine.command(1, "reset")
            for events, raised in zip(both, alerts, strict=True):
                cleared = await events.next()
                assert raised.EventType == ua.NodeId(39, await client.get_namespace_index(MACHINE_TOOL))
                assert raised.ErrorCode == cleared.ErrorCode == "300"
                assert raised.Message.Text == alarm["text"]
                assert raised.SourceNode == ua.NodeId("MachineTool/Monitoring/cs1", own)
                assert (getattr(raised, "ActiveState/Id"), getattr(cleared, "ActiveState/Id")) == (True, False)
                assert (raised.Severity, raised.Retain, cleared.Retain) == (900, True, False)
                assert events.got.empty(), "no event comes twice"

    with served(machine) as address:
        in_loop(watch(address))


def test_a_program_tells_each_of_its_transitions_and_a_handler_its_messages(machine: Machine) -> None:
    async def watch(address: str) -> None:
        async with client_of(address) as client:
            own = await client.get_namespace_index(OWN)
            machine_tool = await client.get_namespace_index(MACHINE_TOOL)
            state = client.get_node(ua.NodeId("MachineTool/Production/ActiveProgram/State", own))
            transitions = await subscribe(client, state, TRANSITION)
            messages = client.get_node(ua.NodeId("MachineTool/Notification/Messages", own))
            notifications = await subscribe(client, messages, NOTIFICATION)
            machine.command(1, "load", program=7)
            machine.ask("POST", "/cs/1/start", {})
            machine.until("WAIT")
            run = machine.get("/cs/1/state")["run_id"]
            path, said = machine.claim_m_code()
            machine.ask("POST", f"{path}/progress", said | {"text": "the clamp closes"})
            message = await notifications.next()
            assert (message.Message.Text, message.Identifier) == ("the clamp closes", "M20")
            assert message.EventType == ua.NodeId("Types/MessageEventType", own)
            machine.ask("POST", "/cs/1/stop", {})
            machine.until("STOPPED")
            machine.command(1, "reset")
            for name, node, began, became, job in (
                ("InitializingToRunning", 91, "Initializing", "Running", run),
                ("RunningToAborted", 108, "Running", "Aborted", run),
                ("AbortedToInitializing", 102, "Aborted", "Initializing", None),
            ):
                event = await transitions.next()
                assert (event.Transition.Text, event.FromState.Text, event.ToState.Text) == (name, began, became)
                assert getattr(event, "Transition/Id") == ua.NodeId(node, machine_tool)
                assert event.Name == "7"
                assert job is None or event.JobIdentifier == job

    with served(machine) as address:
        in_loop(watch(address))
