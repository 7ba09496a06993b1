"""Endpoints of processes, Zenoh's settings for them, and the
errors for endpoints that cannot be used.
"""

import ipaddress
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from crazychoir.errors import ConfigError


@dataclass(frozen=True, slots=True)
class ZenohSettings:
    """Settings of Zenoh that are the same in every process."""

    max_message_bytes: int = 8 << 20
    """Bytes that Zenoh assembles from fragments; a larger message ends the link to its sender.
    """
    local_lease: float = 30.0
    """s: least lease if all processes are on one host, because 4
    keep-alives for each lease and connection cost CPU time.
    """
    batches: int = 16
    """Batches of 64 kB, for each class, that may wait for the network; this is Zenoh's maximum.

    As no put waits, a frame must fit into them. A frame has at most 10 of them: of 12 at once Zenoh
    drops some, also on an idle link.
    """
    priorities: tuple[str, ...] = (
        *("control", "real_time", "interactive_high", "interactive_low"),
        *("data_high", "data", "data_low", "background"),
    )
    """Zenoh's priorities."""
    drop_path: str = "transport/link/tx/queue/congestion_control/drop"
    """Path of Zenoh's settings for messages that find no room."""


ZENOH_SETTINGS = ZenohSettings()


@dataclass(frozen=True, slots=True)
class _ZenohTexts:
    """Forms of the texts that Zenoh reads, and of those in its errors."""

    endpoint: re.Pattern[str] = re.compile(
        r"(tcp|udp|tls|quic|ws)/(\[(?P<ipv6>[^/\[\]\s]+)\]|(?P<host>[^/:\[\]\s]+)):(?P<port>\d{1,5})([?#]\S*)?"
        r"|unixsock-stream/\S+"
    )
    """An endpoint in Zenoh's form."""
    key_part: re.Pattern[str] = re.compile(r"[A-Za-z0-9_.-]{1,100}")
    """Part of a Zenoh key without special letters."""
    error_reason: re.Pattern[str] = re.compile(
        r"([A-Z][\w ]+) \(os error|message: \"([^\"]+)\""
    )
    """Reason within Zenoh's error text."""
    foreign_address: str = "Cannot assign requested address"
    """Text of the error for an address of another host."""


_ZENOH_TEXTS = _ZenohTexts()


_DNS_LABEL = r"[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?"
"""Part of a DNS name."""
_DNS_NAME = re.compile(rf"{_DNS_LABEL}(\.{_DNS_LABEL}){{0,20}}")
"""DNS name of a host."""


def zenoh_settings(
    listen: list[str], connect: list[str], lease: float, mode: str = "peer"
) -> dict[str, Any]:
    """Return Zenoh's settings by path: explicit endpoints, no multicast, puts that never wait.

    lease: seconds without a sign of another host before its tokens disappear; at least
        `local_lease` on one host, where a process that dies closes its connections
    mode: "peer", "client" or "router"

    With gossip, a process that knows only some endpoints learns the others from those processes,
    and connects to each. Without gossip it would see only the tokens of the processes that it
    knows.
    A client has one link, to a router, for all messages: Zenoh's routers pass nothing on between
    peers.
    Raises ConfigError for a malformed endpoint.
    """
    check_endpoint(listen, connect)
    if are_local(listen + connect):
        lease = max(lease, ZENOH_SETTINGS.local_lease)
    return {
        "mode": mode,
        "listen/endpoints": listen,
        "connect/endpoints": connect,
        "connect/retry": {
            "period_init_ms": 100,
            "period_max_ms": 500,
            "period_increase_factor": 2,
        },
        "open/return_conditions": {"connect_scouted": False, "declares": False},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": True,
        "transport/link/tx/lease": round(1000 * lease),
        "transport/link/tx/queue/size": dict.fromkeys(
            ZENOH_SETTINGS.priorities, ZENOH_SETTINGS.batches
        ),
        f"{ZENOH_SETTINGS.drop_path}/wait_before_drop": 0,
        f"{ZENOH_SETTINGS.drop_path}/max_wait_before_drop_fragments": 0,
        "transport/link/rx/max_message_size": ZENOH_SETTINGS.max_message_bytes,
        "transport/shared_memory/enabled": False,
    }


def router_settings(listen: list[str], lease: float) -> dict[str, Any]:
    """Return the settings of a process that passes on the messages between its clients.

    Raises ConfigError for a malformed endpoint.
    """
    return zenoh_settings(listen, [], lease, "router") | {"timestamping/enabled": False}


def are_local(endpoints: Iterable[str]) -> bool:
    """Return True if all endpoints are on this machine only."""
    return all(map(_is_local, endpoints))


def _is_local(endpoint: str) -> bool:
    found = _ZENOH_TEXTS.endpoint.fullmatch(endpoint)
    if found is None:
        return False
    return endpoint.startswith("unixsock-stream/") or is_loopback(
        found["ipv6"] or found["host"]
    )


def is_loopback(address: str) -> bool:
    """Return True if only this machine reaches the address of a host, given without brackets."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address.lower() == "localhost"


def address_fault(address: str) -> str:
    """Return what to do about the address of a host in a file that all hosts read.

    The text is empty for a valid address: an IPv4 address, an IPv6 address without brackets and
    zone, or a DNS name, all without a port.
    """
    bare, percent, zone = address.strip("[]").partition("%")
    if percent and _is_ip(bare):
        return (
            f"Leave out %{zone}: it names a network card of one host alone, and all hosts read this. Write an address "
            "that needs no card, as fd00::2 or 10.0.0.2, or a name."
        )
    if address != address.strip("[]") and _is_ip(bare):
        return "Leave out the brackets."
    try:
        found = ipaddress.ip_address(address)
    except ValueError:
        is_name = _DNS_NAME.fullmatch(address) and not re.fullmatch(r"[\d.]+", address)
        return "" if is_name else _name_fault(address)
    if found.is_unspecified or found.is_multicast:
        return "Write the address by which the others reach this one host."
    return ""


def _name_fault(address: str) -> str:
    """Return what to do about a text that is neither an address nor a DNS name."""
    if re.search(r":\d+$", address):
        return "Leave out the port: ports come from base_port."
    return "Write an IP address or a DNS name, as 10.0.0.2 or lab-3.local: letters a to z, digits, hyphens and dots."


def _is_ip(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


def check_endpoint(listen: Iterable[str], connect: Iterable[str]) -> None:
    """Raise ConfigError for a text that is not an endpoint."""
    for where, endpoints in (("listen", listen), ("connect", connect)):
        for endpoint in endpoints:
            found = _ZENOH_TEXTS.endpoint.fullmatch(endpoint)
            allowed = "tcp/<address>:<port>, as tcp/192.168.1.10:7460, port 0 to 65535; also udp, tls, quic, ws"
            if found is None or int(found["port"] or 0) > 65535:
                do = "Look at base_port and [hosts] in the swarm file."
                raise ConfigError(f"{where} endpoint", endpoint, allowed, do)
            if found["ipv6"] and (do := _ipv6_fault(found["ipv6"])):
                raise ConfigError(f"{where} endpoint", endpoint, allowed, do)


def _ipv6_fault(address: str) -> str:
    """Return what to do about an address in brackets; empty for a valid one.

    Zenoh takes the zone only as a number.
    """
    bare, percent, zone = address.partition("%")
    if ":" not in bare or not _is_ip(bare):
        return "Only an IPv6 address is in brackets."
    if percent and not (zone.isascii() and zone.isdecimal()):
        return f"Write the number of the network card {zone} instead of its name, as %2: `ip link` has it."
    return ""


def is_name(text: str) -> bool:
    """Return True if a text can be one part of a key, without a special meaning."""
    return _ZENOH_TEXTS.key_part.fullmatch(text) is not None


def check_name(where: str, name: str) -> None:
    """Raise ConfigError for a name that cannot be part of a key."""
    if not is_name(name):
        raise ConfigError(
            f"name of the {where}", name, "1 to 100 of A-Z, a-z, 0-9, _, . and -"
        )


def opening_error(listen: list[str], connect: list[str], error: str) -> ConfigError:
    """Return the error for the user, from Zenoh's error text."""
    at_fault = next((endpoint for endpoint in listen if endpoint in error), "")
    reason = _ZENOH_TEXTS.error_reason.search(error)
    said = (
        next((text for text in reason.groups() if text), "")
        if reason
        else error.split(" at /", 1)[0]
    )
    if not listen:
        do = "Is the router, or what else listens there, running? Start it first: crazychoir router --swarm FILE"
        return ConfigError(
            "endpoints",
            ", ".join(connect),
            "an address where a process listens",
            do,
            problem=said,
        )
    return ConfigError(
        "listen endpoint" if at_fault else "endpoints",
        at_fault or ", ".join(listen + connect),
        "it must be a free port of an address of this host",
        "The address of this host in [hosts] is not its own: see `ip -brief address`."
        if _ZENOH_TEXTS.foreign_address in error
        else "Is another agent with this id running here? Stop it, or set another base_port in the swarm file.",
        problem=said,
    )
