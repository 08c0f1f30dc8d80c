"""One connection to a broker: paho's client driven by the event loop of asyncio, without a thread."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import ssl
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode, MQTTProtocolVersion

from .errors import ConnectError
from .within import within

log = logging.getLogger("tandem_plc")

CONNECT_TIMEOUT_S = 5.0
KEEP_ALIVE_S = 5
SILENCE_MAX_S = 10.0
"""Time limit for acknowledgements: if messages wait and the broker acknowledges none, the client connects to the next
node. A node that has lost its cluster may accept messages and never acknowledge them, even after it has rejoined."""
PAYLOAD_MAX = 1 << 20
"""Maximum bytes of one message; longer messages are not read."""
QUEUE_MAX = 2_048
"""Maximum number of messages that wait in the library; further messages are refused."""

_REFUSED_FOR_GOOD = frozenset({"Bad user name or password", "Not authorized", "Client identifier not valid"})


@dataclass(frozen=True, kw_only=True)
class Options:
    """Settings of a connection."""

    client_id: str
    user: str | None = None
    password: str | None = None
    tls: ssl.SSLContext | None = None
    will: tuple[str, str] | None = None
    """Topic and payload of the last will, retained."""


class Link:
    """One connection, from :meth:`open` to its loss, which :attr:`lost` reports. A link is not reused."""

    def __init__(
        self,
        options: Options,
        on_message: Callable[[str, bytes, bool], None],
        on_acknowledged: Callable[[int], None],
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._on_message = on_message
        self._on_acknowledged = on_acknowledged
        self._ready: asyncio.Future[None] = self._loop.create_future()
        self.lost: asyncio.Future[str] = self._loop.create_future()
        """Reason for the end of the connection, once it has ended."""
        self._unacknowledged: set[int] = set()
        self._silent_since: float | None = None
        """Time since when unacknowledged messages wait without any acknowledgement."""
        client = mqtt.Client(
            CallbackAPIVersion.VERSION2,
            client_id=options.client_id,
            clean_session=True,
            protocol=MQTTProtocolVersion.MQTTv311,
            reconnect_on_failure=False,
        )
        client.connect_timeout = CONNECT_TIMEOUT_S
        client.max_queued_messages_set(QUEUE_MAX)
        client.max_inflight_messages_set(QUEUE_MAX)
        if options.user is not None:
            client.username_pw_set(options.user, options.password)
        if options.tls is not None:
            client.tls_set_context(options.tls)
        if options.will is not None:
            client.will_set(*options.will, qos=1, retain=True)
        client.on_connect = self._connected
        client.on_disconnect = self._disconnected
        client.on_message = self._received
        client.on_publish = self._published
        client.on_subscribe = self._subscribed
        client.on_socket_open = self._socket_open
        client.on_socket_register_write = self._wants_write
        client.on_socket_unregister_write = self._has_written
        self._client = client
        self._socket: Any = None

    async def open(self, host: str, port: int) -> None:
        """Connect, and wait until the broker has accepted.

        Raises:
            OSError: the broker does not answer.
            ConnectError: the broker refuses this client.
        """
        await asyncio.to_thread(self._client.connect, host, port, KEEP_ALIVE_S)
        self._socket = self._client.socket()
        if self._socket is None:
            raise ConnectionError("the connection was closed at once")
        self._loop.add_reader(self._socket, self._read)
        self._write()
        await within(self._ready, CONNECT_TIMEOUT_S)

    def subscribe(self, filters: list[str]) -> None:
        """Subscribe with quality of service 1."""
        _, packet = self._client.subscribe([(path, 1) for path in filters])
        if packet is not None:
            self._awaits(packet)

    def publish(self, topic: str, payload: str, *, retain: bool = False) -> int | None:
        """Send a message with quality of service 1; returns its packet id, ``None`` if it cannot be accepted."""
        info = self._client.publish(topic, payload, qos=1, retain=retain)
        if info.rc not in (MQTTErrorCode.MQTT_ERR_SUCCESS, MQTTErrorCode.MQTT_ERR_AGAIN):
            return None
        self._awaits(info.mid)
        return info.mid

    def keep_alive(self) -> None:
        """Send and watch pings, and leave a broker that acknowledges nothing; called about once a second."""
        if self.lost.done():
            return
        self._client.loop_misc()
        if self._silent_since is not None and self._loop.time() - self._silent_since >= SILENCE_MAX_S:
            self._end(f"the broker has acknowledged nothing for {SILENCE_MAX_S:g} s")

    async def close(self, reason: str = "closed here") -> None:
        """Send waiting messages, disconnect, and close."""
        if not self.lost.done():
            for _ in range(20):
                if not self._client.want_write():
                    break
                self._write()
                await asyncio.sleep(0.01)
            self._client.disconnect()
            self._write()
        self._end(reason)

    def abandon(self) -> None:
        """Close without a disconnect message: the broker publishes the will."""
        self._end("closed here")

    def _end(self, reason: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(ValueError, OSError):
                self._loop.remove_reader(self._socket)
                self._loop.remove_writer(self._socket)
            with contextlib.suppress(OSError):
                self._socket.close()
            self._socket = None
        if not self.lost.done():
            self.lost.set_result(reason)
        if not self._ready.done():
            self._ready.set_exception(ConnectionError(reason))
            self._ready.exception()  # marks the exception as retrieved, because no task may be waiting for it

    def _socket_open(self, _client: mqtt.Client, _data: Any, opened: Any) -> None:
        # in the thread that connects: small messages must not wait for each other
        with contextlib.suppress(OSError, AttributeError):
            opened.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def _wants_write(self, _client: mqtt.Client, _data: Any, _socket: Any) -> None:
        if self._socket is None:
            self._loop.call_soon_threadsafe(self._write)  # still in the thread that connects
        else:
            self._loop.call_soon(self._write)

    def _has_written(self, _client: mqtt.Client, _data: Any, _socket: Any) -> None:
        if self._socket is not None:
            with contextlib.suppress(ValueError, OSError):
                self._loop.remove_writer(self._socket)

    def _write(self) -> None:
        if self._socket is None:
            return
        status = self._client.loop_write()
        if status not in (MQTTErrorCode.MQTT_ERR_SUCCESS, MQTTErrorCode.MQTT_ERR_AGAIN):
            self._end(mqtt.error_string(status))
        elif self._socket is not None and self._client.want_write():
            self._loop.add_writer(self._socket, self._write)

    def _read(self) -> None:
        while self._socket is not None:
            status = self._client.loop_read()
            if status not in (MQTTErrorCode.MQTT_ERR_SUCCESS, MQTTErrorCode.MQTT_ERR_AGAIN):
                self._end(mqtt.error_string(status))
                return
            # the socket does not report data that TLS has already decoded
            if not (isinstance(self._socket, ssl.SSLSocket) and self._socket.pending()):
                return

    def _connected(self, _client: mqtt.Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if self._ready.done():
            return
        if reason.is_failure:
            text = str(reason)
            error = ConnectError(f"the broker refuses this client: {text}")
            self._ready.set_exception(error if text in _REFUSED_FOR_GOOD else ConnectionError(text))
        else:
            self._ready.set_result(None)

    def _disconnected(self, _client: mqtt.Client, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        self._loop.call_soon(self._end, f"the connection was lost ({reason})")

    def _received(self, _client: mqtt.Client, _data: Any, message: mqtt.MQTTMessage) -> None:
        if len(message.payload) > PAYLOAD_MAX:
            log.warning("a message of %d bytes on %s is ignored", len(message.payload), message.topic)
            return
        try:
            self._on_message(message.topic, bytes(message.payload), message.retain)
        except Exception:
            log.exception("a message on %s could not be used", message.topic)

    def _published(self, _client: mqtt.Client, _data: Any, packet: int, _reason: Any, _properties: Any) -> None:
        self._has_come(packet)
        self._on_acknowledged(packet)

    def _subscribed(self, _client: mqtt.Client, _data: Any, packet: int, _reasons: Any, _properties: Any) -> None:
        self._has_come(packet)

    def _awaits(self, packet: int) -> None:
        self._unacknowledged.add(packet)
        if self._silent_since is None:
            self._silent_since = self._loop.time()

    def _has_come(self, packet: int) -> None:
        self._unacknowledged.discard(packet)
        self._silent_since = self._loop.time() if self._unacknowledged else None
