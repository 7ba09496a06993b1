"""Access rules: mutual TLS, Zenoh's access control by certificate, and checks of each message.

Zenoh restricts a host to the keys of its own frames and tokens, by the common name of the
certificate on the connection. This module checks the content of frames against the swarm file: a
HELLO that claims drones, and the commands of operators.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from crazychoir.bus.frames import Envelope
from crazychoir.bus.port import PORT_ADDRESSES
from crazychoir.bus.topics import MESSAGE_TOPICS


@dataclass(frozen=True, slots=True)
class AccessRules:
    """What observers and operators may do on the network."""

    operator_topics: tuple[int, ...] = (
        MESSAGE_TOPICS.request.number,
        MESSAGE_TOPICS.emergency_stop.number,
    )
    """Topics that only operators may send."""
    observer_prefix: str = "observer"
    """First part of the names of observing processes; their host follows."""
    max_observers: int = 32
    """Most observing processes of a host at once."""


ACCESS_RULES = AccessRules()


_DATA_MESSAGES = ["put", "delete", "declare_subscriber"]
"""Zenoh's messages with data."""
_TOKEN_MESSAGES = [
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
]
"""Zenoh's messages about tokens."""


@dataclass(frozen=True)
class NetworkAccess:
    """The rules of the swarm file."""

    swarm: str
    """Name of the swarm."""
    host: str
    """This host."""
    folder: Path
    """Folder with its certificate.pem, key.pem and authority.pem."""
    processes: Mapping[str, tuple[str, ...]]
    """{host: first parts of the names of its processes}."""
    holders: Mapping[int, str]
    """{address of a drone, its body or its eyes: host}."""
    operators: tuple[str, ...]
    """Hosts that may command."""
    router: str | None = None
    """Host that passes all messages on.

    It restricts each host to its own name, and is itself trusted.
    """

    def may_hold(self, host: str, address: int) -> bool:
        """Return True if a process of this host may have this address.

        Any host may have observers.
        """
        if PORT_ADDRESSES.first_observer <= address < PORT_ADDRESSES.body_offset:
            return True
        return self.holders.get(address) == host

    def may_be(self, host: str, process: str) -> bool:
        """Return True if a process of this name may be on a
        host: no process takes another's name.
        """
        return process.startswith(self._begins(host))

    def most(self, host: str) -> int:
        """Return the most processes of a host at once.

        Each process counts twice: it may be restarted before its end is noticed.
        """
        return 2 * len(self.processes.get(host, ())) + ACCESS_RULES.max_observers

    def _begins(self, host: str) -> tuple[str, ...]:
        """Return the first parts of the names of a host's processes.

        No name of a host has a dot.
        """
        return (
            *(f"{start}-" for start in self.processes.get(host, ())),
            f"{ACCESS_RULES.observer_prefix}-{host}.",
        )

    def may_say(self, host: str, message: Envelope) -> bool:
        """Return True if a message counts from this host.

        A drone may send requests to its own body on any host.
        """
        own_body = message.topic == MESSAGE_TOPICS.request.number and message.to == (
            PORT_ADDRESSES.body_offset + message.source,
        )
        return (
            message.topic not in ACCESS_RULES.operator_topics
            or host in self.operators
            or own_body
        )

    def settings(self) -> dict[str, Any]:
        """Return Zenoh's settings, by path."""
        own = {
            "private_key": str(self.folder / "key.pem"),
            "certificate": str(self.folder / "certificate.pem"),
        }
        tls = {
            f"{side}_{key}": path
            for side in ("listen", "connect")
            for key, path in own.items()
        }
        return {
            # A certificate names a host and no address. Access control restricts the host to the
            # keys with its name.
            "transport/link/tls": tls
            | {
                "root_ca_certificate": str(self.folder / "authority.pem"),
                "enable_mtls": True,
                "verify_name_on_connect": False,
            },
            "transport/link/protocols": ["tls", "quic"],
            "access_control": self._control(),
        }

    def _control(self) -> dict[str, Any]:
        """Return Zenoh's access control: a host may only send under its
        own name, and only subscribe to its own messages.
        """
        top = f"choir/{self.swarm}"
        rules = [
            _access_rule(
                "out", "egress", _DATA_MESSAGES + _TOKEN_MESSAGES, [f"{top}/**"]
            )
        ]
        policies: list[dict[str, Any]] = []
        for host in self.processes:
            here = [f"{top}/f/{begin}$*/**" for begin in self._begins(host)]
            drones = [
                f"{top}/drone/{i}/**"
                for i, of in self.holders.items()
                if of == host and i < PORT_ADDRESSES.first_observer
            ]
            own = [
                _access_rule(
                    f"{host} says",
                    "ingress",
                    ["put", "delete"],
                    [f"{top}/f/*/{host}/*/*", *drones],
                ),
                _access_rule(
                    f"{host} hears",
                    "ingress",
                    ["declare_subscriber"],
                    [*here, f"{top}/drone/**"],
                ),
                _access_rule(
                    f"{host} is there",
                    "ingress",
                    ["liveliness_token"],
                    [f"{top}/live/{host}/**"],
                ),
                _access_rule(
                    f"{host} looks", "ingress", _TOKEN_MESSAGES[1:], [f"{top}/live/**"]
                ),
            ]
            if host == self.router:
                own = [
                    _access_rule(
                        f"{host} passes on",
                        "ingress",
                        _DATA_MESSAGES + _TOKEN_MESSAGES,
                        [f"{top}/**"],
                    )
                ]
            rules += own
            policies.append(
                {"subjects": [host], "rules": ["out", *(rule["id"] for rule in own)]}
            )
        return {
            "enabled": True,
            "default_permission": "deny",
            "rules": rules,
            "subjects": [
                {"id": host, "cert_common_names": [host]} for host in self.processes
            ],
            "policies": policies,
        }


def _access_rule(
    name: str, flow: str, messages: list[str], keys: list[str]
) -> dict[str, Any]:
    return {
        "id": name,
        "permission": "allow",
        "flows": [flow],
        "messages": messages,
        "key_exprs": keys,
    }
