"""How a process is reached: endpoints, Zenoh's settings, and what is said when one cannot be used."""

import ipaddress
import re
from collections.abc import Iterable
from typing import Any

from crazychoir.errors import ConfigError

MAX_MESSAGE = 8 << 20
"""Bytes that Zenoh puts together from fragments; more ends the link to the sender."""
LOCAL_LEASE = 10.0
"""s, where all processes are on one host: 4 keep-alives a lease and connection cost CPU."""
BATCHES = 16
"""Of 64 kB, that wait for the network, a class; Zenoh's most. As no put waits, a frame must fit into them.

frames.MAX_FRAME is 10 of them: of 12 at once Zenoh drops some, also on an idle link.
"""

_ENDPOINT = re.compile(
    r"(tcp|udp|tls|quic|ws)/(\[(?P<ipv6>[^/\[\]\s]+)\]|(?P<host>[^/:\[\]\s]+)):(?P<port>\d{1,5})([?#]\S*)?"
    r"|unixsock-stream/\S+"
)
_LABEL = r"[A-Za-z0-9]([A-Za-z0-9-]{0,61}[A-Za-z0-9])?"
_NAME = re.compile(rf"{_LABEL}(\.{_LABEL}){{0,20}}")
"""Of a host, as DNS has it."""
_PRIORITIES = (
    *("control", "real_time", "interactive_high", "interactive_low"),
    *("data_high", "data", "data_low", "background"),
)
_CHUNK = re.compile(r"[A-Za-z0-9_.-]{1,100}")
_REASON = re.compile(r"([A-Z][\w ]+) \(os error|message: \"([^\"]+)\"")
_DROP = "transport/link/tx/queue/congestion_control/drop"


def settings(
    listen: list[str], connect: list[str], lease: float, mode: str = "peer"
) -> dict[str, Any]:
    """Zenoh's settings by path: explicit endpoints, no multicast, puts that never wait; raises ConfigError.

    lease: s without a sign of another host before its tokens go; a process that dies here closes its connections,
    so that on one host only a longer one is needed. Gossip: who is given the endpoints of only some processes learns
    the others' from those, and has a link to each; without it, it would see no token but theirs. A client has one link,
    to a router, over which all goes: Zenoh's routers pass nothing on between peers.
    """
    check(listen, connect)
    if are_local(listen + connect):
        lease = max(lease, LOCAL_LEASE)
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
        "transport/link/tx/queue/size": dict.fromkeys(_PRIORITIES, BATCHES),
        f"{_DROP}/wait_before_drop": 0,
        f"{_DROP}/max_wait_before_drop_fragments": 0,
        "transport/link/rx/max_message_size": MAX_MESSAGE,
        "transport/shared_memory/enabled": False,
    }


def of_router(listen: list[str], lease: float) -> dict[str, Any]:
    """Those of a process that passes on what its clients say to each other; raises ConfigError."""
    return settings(listen, [], lease, "router") | {"timestamping/enabled": False}


def are_local(endpoints: Iterable[str]) -> bool:
    """Whether all of them are this machine's own."""
    return all(map(_is_local, endpoints))


def _is_local(endpoint: str) -> bool:
    found = _ENDPOINT.fullmatch(endpoint)
    if found is None:
        return False
    return endpoint.startswith("unixsock-stream/") or is_loopback(
        found["ipv6"] or found["host"]
    )


def is_loopback(address: str) -> bool:
    """Whether only this machine reaches the address of a host, without brackets."""
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return address.lower() == "localhost"


def address_fault(address: str) -> str:
    """Return what to do about the address of a host in a file that all hosts read; empty for a good one.

    Good are an IPv4 address, an IPv6 address without brackets and without a zone, and a DNS name, all without a port.
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
        is_name = _NAME.fullmatch(address) and not re.fullmatch(r"[\d.]+", address)
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


def check(listen: Iterable[str], connect: Iterable[str]) -> None:
    """Raises ConfigError for what is not an endpoint."""
    for where, endpoints in (("listen", listen), ("connect", connect)):
        for endpoint in endpoints:
            found = _ENDPOINT.fullmatch(endpoint)
            allowed = "tcp/<address>:<port>, as tcp/192.168.1.10:7460, port 0 to 65535; also udp, tls, quic, ws"
            if found is None or int(found["port"] or 0) > 65535:
                do = "Look at base_port and [hosts] in the swarm file."
                raise ConfigError(f"{where} endpoint", endpoint, allowed, do)
            if found["ipv6"] and (do := _ipv6_fault(found["ipv6"])):
                raise ConfigError(f"{where} endpoint", endpoint, allowed, do)


def _ipv6_fault(address: str) -> str:
    """Return what to do about an address in brackets; empty for a good one. Zenoh takes the zone as a number alone."""
    bare, percent, zone = address.partition("%")
    if ":" not in bare or not _is_ip(bare):
        return "Only an IPv6 address is in brackets."
    if percent and not (zone.isascii() and zone.isdecimal()):
        return f"Write the number of the network card {zone} instead of its name, as %2: `ip link` has it."
    return ""


def is_name(text: str) -> bool:
    """Whether it can be part of a key, and means only itself there."""
    return _CHUNK.fullmatch(text) is not None


def check_name(where: str, name: str) -> None:
    """Raises ConfigError for a name that cannot be part of a key."""
    if not is_name(name):
        raise ConfigError(
            f"name of the {where}", name, "1 to 100 of A-Z, a-z, 0-9, _, . and -"
        )


_NOT_OURS = "Cannot assign requested address"


def cannot_open(listen: list[str], connect: list[str], error: str) -> ConfigError:
    """What to tell the user of Zenoh's error."""
    at_fault = next((endpoint for endpoint in listen if endpoint in error), "")
    reason = _REASON.search(error)
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
            "somebody must listen there",
            do,
            problem=said,
        )
    return ConfigError(
        "listen endpoint" if at_fault else "endpoints",
        at_fault or ", ".join(listen + connect),
        "it must be a free port of an address of this host",
        "The address of this host in [hosts] is not its own: see `ip -brief address`."
        if _NOT_OURS in error
        else "Is another agent with this id running here? Stop it, or set another base_port in the swarm file.",
        problem=said,
    )
