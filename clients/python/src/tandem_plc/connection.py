"""The connection to a machine. It is restored after each loss, and unanswered requests are sent again."""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import random
import re
import secrets
import ssl
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from .address import Address
from .decode import DecodeError, decode
from .errors import ConnectError, NoAnswer, NotConnected, RequestRefused
from .hub import Hub
from .link import Link, Options
from .messages import CommandReply, HandshakeResult, Pending, Presence
from .topics import FILTERS, form_of, number_at
from .within import within

log = logging.getLogger("tandem_plc")

ANSWER_TIMEOUT_S = 5.0
PRESENT_TIMEOUT_S = 10.0
PRESENCE_EXPIRES_S = 15.0
"""The machine treats handlers as lost after this time without a presence. A presence is published three times in it."""
LOOK_AT_AGE_S = 1.0
"""Interval of the checks of the machine's presence."""
OUTBOX_MAX = 1_024
"""Maximum number of unfinished requests; further ones are refused."""

USER_MAX = 46
"""Characters of the user name at the start of the client id, because a client id has at most 64 characters."""
_SET_BY_HANDLERS = re.compile(r"cs/\d+/(tool|spindle|variable)/(get|set)|alarm/raise")
"""Topics that handlers publish to without their name in the payload."""
_BACKOFF_FIRST_S = 0.1
_BACKOFF_MAX_S = 5.0


@dataclass(eq=False)
class Request:
    """A message whose arrival is not confirmed; it is sent again on each new connection."""

    path: str
    topic: str
    payload: str
    done: asyncio.Future[Any]
    retain: bool = False
    command_id: str | None = None
    """The request ends with the reply to this command."""
    result_of: tuple[str, int, str, str] | None = None
    """The request ends with this result: its path, ``seq``, ``handler_id``, and ``claim`` or ``reset``."""
    boot_id: str | None = None
    """For a command: the boot to which it was first sent. The command is never sent to another boot."""
    was_sent: bool = False
    is_sent: bool = False
    """True if the request was sent on the current connection."""


@dataclass
class Credentials:
    """Credentials of the client; the address supplies missing ones."""

    user: str | None = None
    password: str | None = field(default=None, repr=False)
    tls: ssl.SSLContext | None = None


class Connection:
    """Keeps a connection to one machine, and transfers requests and messages."""

    def __init__(self, address: str, credentials: Credentials | None = None, handler_id: str | None = None) -> None:
        self.address = Address.parse(address)
        user = (credentials.user if credentials is not None else None) or self.address.user
        is_named = bool(user) and len(user or "") <= USER_MAX and not set(user or "") & set("/+#\0")
        name = f"py-{secrets.token_hex(6)}"
        self.client_id = f"{user}-{name}" if is_named else name
        """It begins with the user, because access rules of a broker bind the topics of a client to its user."""
        self._topic_id = str(user) if is_named else self.client_id
        self.hub = Hub()
        self.handler_id = handler_id
        self.instance = secrets.token_hex(16)
        """Distinguishes this process from others with the same handler id; unchanged over all connections."""
        self.will: str | None = None
        """Payload of the handler's last will, published if the connection is lost."""
        self.on_message: Callable[[str, Any], None] = lambda _path, _message: None
        """Receives each message of the machine before the followers of its topic do."""
        self.on_connected: Callable[[], None] = lambda: None
        """Called on each new connection and at each boot, before requests are sent again."""
        self._credentials = credentials or Credentials()
        self._link: Link | None = None
        self._is_present = False
        self._told_boot: str | None = None
        self._requests: list[Request] = []
        self._by_packet: dict[int, Request] = {}
        self._task: asyncio.Task[None] | None = None
        self._trouble = "no broker has answered"
        self._refused: asyncio.Future[ConnectError] | None = None
        self._news = asyncio.Event()
        self.connections = 0
        """Number of connections so far."""
        self._heard_at = 0.0
        """Time of the last presence message; restarted with each connection."""
        self._is_missed = False
        """True if no presence arrived within ``expires_ms``."""
        self._must_reconnect = False

    @property
    def boot_id(self) -> str | None:
        """The boot of the runtime that is online; ``None`` while it is offline."""
        presence: Presence | None = self.hub.last("presence")
        return presence.boot_id if presence is not None and presence.online else None

    @property
    def is_connected(self) -> bool:
        """True while the machine can be reached."""
        return self._is_present and self.boot_id is not None

    # --- life

    async def start(self, timeout_s: float = PRESENT_TIMEOUT_S) -> None:
        """Connect, and wait for the machine.

        Raises:
            ConnectError: the machine is not online within the time, or the broker refuses this client.
        """
        self._refused = asyncio.get_running_loop().create_future()
        self._task = asyncio.create_task(self._keep_connected(), name=f"tandem {self.address.shown}")
        present: asyncio.Future[Any] = asyncio.ensure_future(self._until_present())
        ends: set[asyncio.Future[Any]] = {present, self._refused}
        done, _ = await asyncio.wait(ends, timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
        present.cancel()
        if present in done:
            return
        await self.stop()
        if self._refused.done():
            raise self._refused.result()
        raise ConnectError(f"no connection to {self.address.shown}: {self._trouble}")

    async def until(self, holds: Callable[[], bool]) -> None:
        """Wait until a condition holds; checked after each message and each loss of the connection."""
        while not holds():
            self._news.clear()
            await self._news.wait()

    async def _until_present(self) -> None:
        await self.until(lambda: self.is_connected and self.hub.last("birth") is not None)

    async def stop(self) -> None:
        """Close the connection; pending requests get no answer."""
        task, self._task = self._task, None
        if task is not None:
            task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await task
        if self._link is not None:
            await self._link.close()
            self._link = None
        self._is_present = False
        for request in self._requests:
            request.done.cancel()
        self._requests.clear()
        self.hub.close()

    async def _keep_connected(self) -> None:
        wait_s, nodes, failures = _BACKOFF_FIRST_S, self.address.nodes, 0
        at = 0
        while True:
            was_connected = await self._one_connection(*nodes[at])
            if was_connected:
                wait_s, failures = _BACKOFF_FIRST_S, 0
            # tries one node after the other, with a wait after each round and each connection
            failures += 1
            at = (at + 1) % len(nodes)
            if was_connected or failures % len(nodes) == 0:
                await asyncio.sleep(wait_s * random.uniform(0.5, 1.0))
                wait_s = min(wait_s * 2, _BACKOFF_MAX_S)

    async def _one_connection(self, host: str, port: int) -> bool:
        link = Link(self._options(), self._received, self._acknowledged)
        self._by_packet.clear()
        for request in list(self._requests):
            request.is_sent = False
            if request.result_of is not None and request.result_of[-1] == "claim":
                # the handler's registration was lost with the connection, so the machine would refuse the claim
                self._end(request, error=NotConnected("the connection was lost; register, then claim again"))
        is_open = False
        try:
            await link.open(host, port)
            is_open = True
            self._link = link
            self.connections += 1
            self._heard_at = asyncio.get_running_loop().time()
            self._is_missed = self._must_reconnect = False
            link.subscribe([f"{self.address.root}/{path}" for path in self._filters()])
            log.info("connected to %s:%d", host, port)
            while not link.lost.done():
                await asyncio.wait({link.lost}, timeout=LOOK_AT_AGE_S)
                if self._must_reconnect:
                    await link.close("the presence of the machine had expired, and is received again")
                link.keep_alive()
                self._look_at_age()
            self._trouble = link.lost.result()
            log.warning("%s:%d: %s", host, port, self._trouble)
        except ConnectError as error:
            self._trouble = str(error)
            if self._refused is not None and not self._refused.done():
                self._refused.set_result(error)
        except (OSError, asyncio.TimeoutError) as error:
            self._trouble = f"{host}:{port}: {error or 'no answer'}"
        except asyncio.CancelledError:
            if not is_open:
                link.abandon()
            raise
        finally:
            self._is_present = False
            self._news.set()
        link.abandon()
        self._link = None
        return is_open

    def _options(self) -> Options:
        given, address = self._credentials, self.address
        tls = given.tls or (ssl.create_default_context() if address.tls else None)
        will = None
        if self.will is not None and self.handler_id is not None:
            will = (f"{address.root}/handler/{self.handler_id}/presence", self.will)
        return Options(
            client_id=self.client_id,
            user=given.user if given.user is not None else address.user,
            password=given.password if given.password is not None else address.password,
            tls=tls,
            will=will,
        )

    def _filters(self) -> list[str]:
        own = [] if self.handler_id is None else ["presence", "result"]
        return [*FILTERS, f"reply/{self.client_id}", *(f"handler/{self.handler_id}/{level}" for level in own)]

    # --- incoming messages

    def _look_at_age(self) -> None:
        """Set the machine offline if its presence has expired: a last will may not arrive."""
        presence: Presence | None = self.hub.last("presence")
        if presence is None or not presence.online or presence.expires_ms is None:
            return
        if asyncio.get_running_loop().time() - self._heard_at >= presence.expires_ms / 1000:
            log.warning("the machine has not renewed its presence in time: it is treated as offline")
            self._is_missed = True
            self._take("presence", replace(presence, online=False))

    def _received(self, topic: str, payload: bytes, retained: bool) -> None:
        path = topic.removeprefix(f"{self.address.root}/")
        form = form_of(path)
        if form is None:
            return
        if not payload:
            self.hub.forget(path)
            return
        try:
            message: Any = decode(form, json.loads(payload))
        except (ValueError, RecursionError) as error:  # DecodeError is a ValueError
            log.warning("a message on %s does not have the form of its topic: %s", topic, error)
            return
        if isinstance(message, Presence) and not retained:
            self._heard_at = asyncio.get_running_loop().time()
            # a separated part of a cluster may have missed messages: connect, read and publish everything again
            self._must_reconnect = self._is_missed
        self._take(path, message)

    def _take(self, path: str, message: Any) -> None:
        self.hub.publish(path, message)
        if isinstance(message, HandshakeResult):
            self._on_result(path, message)
        elif isinstance(message, CommandReply):
            self._on_reply(message)
        elif isinstance(message, Presence):
            self._on_presence()
        self.on_message(path, message)
        self._news.set()

    def _on_presence(self) -> None:
        if self.boot_id is None:
            self._is_present = False
            return
        if not self._is_present or self.boot_id != self._told_boot:
            self._is_present, self._told_boot = True, self.boot_id
            self.on_connected()
        self._send_all()

    def _on_result(self, path: str, result: HandshakeResult) -> None:
        for request in list(self._requests):
            if request.result_of is None:
                continue
            its_path, seq, handler_id, kind = request.result_of
            if (its_path, seq, handler_id) != (path, result.seq, result.handler_id):
                continue
            if result.of not in (None, kind) or result.instance not in (None, self.instance):
                continue
            if (
                result.of is None
                and kind == "reset"
                and result.status == "accepted"
                and self._is_open(path, result.seq)
            ):
                continue  # a late answer to its claim: an output that is reset has left ``pending`` before
            if result.status == "refused":
                self._end(request, error=RequestRefused("invalid", result.text or "invalid message"))
            else:
                self._end(request, result)

    def _is_open(self, path: str, seq: int) -> bool:
        pending: Pending | None = self.hub.last(f"cs/{number_at(path, 1)}/m_code/pending")
        return pending is not None and any(output.seq == seq for output in pending.outputs)

    def _on_reply(self, reply: CommandReply) -> None:
        if reply.status == "accepted":
            return
        for request in list(self._requests):
            if request.command_id == reply.command_id:
                if reply.status == "rejected":
                    self._end(request, error=RequestRefused(reply.code, reply.text))
                else:
                    self._end(request, reply)

    def _acknowledged(self, packet: int) -> None:
        request = self._by_packet.pop(packet, None)
        if request is not None and request.command_id is None and request.result_of is None:
            self._end(request, None)

    def _end(self, request: Request, value: Any = None, error: Exception | None = None) -> None:
        if request in self._requests:
            self._requests.remove(request)
        if request.done.done():
            return
        if error is None:
            request.done.set_result(value)
        else:
            request.done.set_exception(error)

    # --- outgoing messages

    async def request(
        self,
        path: str,
        payload: dict[str, Any],
        *,
        retain: bool = False,
        command_id: str | None = None,
        result_of: tuple[str, int, str, str] | None = None,
        timeout_s: float = ANSWER_TIMEOUT_S,
    ) -> Any:
        """Send a message, and wait for its answer, or for the broker's acknowledgement if it has none.

        Raises:
            RequestRefused: the machine refuses the request.
            NotConnected: there was no connection within the time limit, and the request was not sent.
            NoAnswer: the request was sent, but not answered.
        """
        if len(self._requests) >= OUTBOX_MAX:
            raise NotConnected(f"{OUTBOX_MAX} requests wait for an answer already; nothing was sent")
        done: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        text = json.dumps(payload, separators=(",", ":"), allow_nan=False)
        topic = self._topic_of(path, payload)
        request = Request(path, topic, text, done, retain=retain, command_id=command_id, result_of=result_of)
        self._requests.append(request)
        self._send(request)
        try:
            return await within(done, timeout_s)
        except asyncio.TimeoutError:
            if request.was_sent:
                raise NoAnswer(path, timeout_s, command_id) from None
            text = f"{path}: no connection to {self.address.shown} within {timeout_s:g} s; nothing was sent"
            raise NotConnected(text) from None
        finally:
            if request in self._requests:
                self._requests.remove(request)

    def post(self, path: str, payload: dict[str, Any], *, retain: bool = False) -> None:
        """Send a message without waiting for its arrival; drop it if there is no connection."""
        if self._link is not None and self._is_present:
            text = json.dumps(payload, separators=(",", ":"), allow_nan=False)
            self._link.publish(self._topic_of(path, payload), text, retain=retain)

    def _topic_of(self, path: str, payload: dict[str, Any]) -> str:
        """Return the topic of a request, which names its sender."""
        root = self.address.root
        if path.startswith(("handler/", "client/")):
            return f"{root}/{path}"
        named = payload.get("handler_id")
        if named is None:
            is_own = _SET_BY_HANDLERS.fullmatch(path) is not None
        else:
            is_own = named == self.handler_id and payload.get("force") is not True
        if self.handler_id is not None and is_own:
            return f"{root}/handler/{self.handler_id}/{path}"
        return f"{root}/client/{self._topic_id}/{path}"

    def _send_all(self) -> None:
        for request in list(self._requests):
            if not request.is_sent:
                self._send(request)

    def _send(self, request: Request) -> None:
        link, boot_id = self._link, self.boot_id
        if link is None or not self._is_present or boot_id is None:
            return
        if request.command_id is not None:
            if request.boot_id is not None and request.boot_id != boot_id:
                return  # another boot would not know the id, and would execute the command a second time
            request.boot_id = boot_id
        packet = link.publish(request.topic, request.payload, retain=request.retain)
        if packet is not None:
            request.is_sent = request.was_sent = True
            self._by_packet[packet] = request


__all__ = ["Connection", "Credentials", "DecodeError"]
