"""Requests of a person carry the age limit of their press."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any, cast

import pytest

from tandem_plc import NotConnected, Plc
from tandem_plc.connection import Connection
from tandem_plc.messages import CommandReply, Heartbeat

InLoop = Callable[[Awaitable[Any]], Any]


class _Hub:
    def __init__(self, heartbeat: Heartbeat | None) -> None:
        self.heartbeat = heartbeat

    def last(self, path: str) -> Any:
        return self.heartbeat if path == "heartbeat" else None


class _Noting:
    """A connection that records the messages sent."""

    client_id = "py-1"
    handler_id = None
    is_connected = True

    def __init__(self, heartbeat: Heartbeat | None) -> None:
        self.hub = _Hub(heartbeat)
        self.sent: list[tuple[str, dict[str, Any]]] = []

    async def request(self, path: str, payload: dict[str, Any], **_options: Any) -> CommandReply:
        self.sent.append((path, payload))
        named = payload.get("command_id", "")
        return CommandReply(boot_id="b", ts="", command_id=named, status="done", code="ok", text="", state_rev=1)


def _plc(connection: _Noting) -> Plc:
    return Plc(cast(Connection, connection))


def test_each_request_of_a_persons_handle_carries_the_heartbeat_of_the_press(in_loop: InLoop) -> None:
    noting = _Noting(Heartbeat(boot_id="b", ts="", cycle=7))

    async def work() -> None:
        person = _plc(noting).for_person(within_s=0.5)
        noting.hub.heartbeat = Heartbeat(boot_id="b", ts="", cycle=99)
        await person.cs(1).start()
        await person.cs(1).set_overrides(feed=50)
        await person.cs(1).set_interlock(False)
        await person.write_p(0, [1.0])
        await person.io_out("lamp").force(True)

    in_loop(work())
    limit = {"boot_id": "b", "heartbeat": 7, "within_ms": 500}
    assert len(noting.sent) == 5
    assert all(payload["not_after"] == limit for _path, payload in noting.sent), noting.sent


def test_a_programs_own_requests_carry_no_age_limit(in_loop: InLoop) -> None:
    noting = _Noting(Heartbeat(boot_id="b", ts="", cycle=7))
    plc = _plc(noting)

    async def work() -> None:
        await plc.cs(1).start()
        await plc.for_person().cs(1).start()

    in_loop(work())
    (_, own), (_, of_person) = noting.sent
    assert "not_after" not in own
    assert "not_after" in of_person
    assert own["command_id"] != of_person["command_id"]


def test_a_persons_request_without_any_heartbeat_is_not_sent() -> None:
    with pytest.raises(NotConnected):
        _plc(_Noting(None)).for_person()
