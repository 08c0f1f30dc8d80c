"""Addresses of machines on a broker."""

from __future__ import annotations

from dataclasses import dataclass, field
from urllib.parse import unquote

from .errors import AddressError

NODES_MAX = 16


@dataclass(frozen=True)
class Address:
    """``mqtt://[user[:password]@]host[:port][,host[:port]..]/[prefix/]machine``, parsed; ``mqtts://`` with TLS."""

    nodes: tuple[tuple[str, int], ...]
    """Host and port of each node of the broker; at least one."""
    tls: bool
    root: str
    """Root of the machine's topics, without a slash at the end."""
    shown: str
    """The given address, without user and password."""
    user: str | None = None
    password: str | None = field(default=None, repr=False)

    @classmethod
    def parse(cls, text: str) -> Address:
        """Read an address.

        Raises:
            AddressError: describes the mistake and the correct form, without the password.
        """
        scheme, found, rest = text.partition("://")
        if not found:
            scheme, rest = "mqtt", text
        authority, _, path = rest.partition("/")
        login, found, hosts = authority.rpartition("@")
        # text before an @ may be a password, wherever the @ is
        shown = f"{scheme}://{rest.rpartition('@')[2]}"

        def wrong(reason: str) -> AddressError:
            return AddressError(f"{shown} is not an address of a machine: {reason}")

        if scheme not in ("mqtt", "mqtts"):
            raise wrong("write mqtt://host:port/machine, or mqtts:// with TLS")
        try:
            nodes = tuple(_node(node, 8883 if scheme == "mqtts" else 1883) for node in hosts.split(","))
        except ValueError as error:
            raise wrong(str(error)) from None
        if len(nodes) > NODES_MAX:
            raise wrong(f"it names more than {NODES_MAX} hosts")
        prefix, slash, machine = path.rpartition("/")
        if not machine:
            raise wrong("it names no machine; write mqtt://host:port/machine")
        if "+" in path or "#" in path or path.startswith("/") or "//" in path:
            raise wrong("topic levels are not empty and have no + or #")
        user, _, password = login.partition(":")
        return cls(
            nodes=nodes,
            tls=scheme == "mqtts",
            root=f"{prefix}{slash}tandem/v1/{machine}",
            shown=shown,
            user=unquote(user) if found else None,
            password=unquote(password) if found else None,
        )


def _node(text: str, default: int) -> tuple[str, int]:
    if text.startswith("["):
        host, found, rest = text[1:].partition("]")
        if not found:
            raise ValueError("the ] of its IPv6 address is missing")
        port = rest.removeprefix(":") if rest else None
    else:
        host, found, rest = text.partition(":")
        port = rest if found else None
    if not host:
        raise ValueError("it names no host; write mqtt://host:port/machine")
    if port is None:
        return host, default
    if not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise ValueError("its port is not a number; / @ and : of a password are written %2F, %40 and %3A")
    return host, int(port)
