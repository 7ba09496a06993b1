"""Commands of an operator as services of another tool: a request in JSON, answered by a receipt."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import msgspec

from crazychoir.agent.order_times import LONGEST_VELOCITY
from crazychoir.dashboard.commands import CommandDesk
from crazychoir.dashboard.operator import PageOperator
from crazychoir.dashboard.receipts import Receipt
from crazychoir.dashboard.requests import (
    GoTo,
    Move,
    Order,
    Steer,
    Stop,
    decode_page_message,
)
from crazychoir.dashboard.stick import is_release
from crazychoir.errors import ConfigError
from crazychoir.files.path_texts import json_bytes
from crazychoir.types import Point

SERVICE_PREFIX = "/crazychoir/"
"""Prefix of the names of all services."""
DRONES_FIELD = {
    "drones": {
        "type": "array",
        "items": {"type": "integer"},
        "description": "Ids of the drones; without it, all drones.",
    }
}
"""JSON schema of the field that chooses drones."""
PLACE_FIELDS = {
    "p": {
        "type": "array",
        "items": {"type": "number"},
        "description": "(3,) m, world: goal of the first drone.",
    },
    "yaw": {"type": "number", "description": "rad; without it, unchanged."},
    "offset": {
        "type": "array",
        "items": {"type": "number"},
        "description": "(3,) m, from the goal of one drone to the goal of the next.",
    },
}
"""JSON schemas of the fields of a goal."""

VELOCITY_FIELDS = {
    "v": {
        "type": "array",
        "items": {"type": "number"},
        "description": "(3,) m/s, world.",
    },
    "yaw_rate": {"type": "number", "description": "rad/s; without it, 0."},
    "duration": {
        "type": "number",
        "description": f"s, then the drones rest; at most {LONGEST_VELOCITY:g}, without it 1.",
    },
}
"""JSON schemas of the fields of a velocity."""


@dataclass(frozen=True)
class OperatorService:
    """One command as a service."""

    name: str
    """Its name without the prefix."""
    message: Mapping[str, Any]
    """The fixed fields of the page's message that it stands for."""
    fields: Mapping[str, Any] = field(default_factory=lambda: DRONES_FIELD)
    """JSON schema of each field of a request."""

    @property
    def path(self) -> str:
        """Its full name."""
        return SERVICE_PREFIX + self.name


def _order_service(verb: str) -> OperatorService:
    return OperatorService(verb.replace("-", "_"), {"ask": "order", "verb": verb})


OPERATOR_SERVICES = (
    *map(_order_service, ("arm", "take-off", "start", "hold", "go", "land", "home")),
    OperatorService("stop", {"ask": "stop", "clear": False}),
    OperatorService("clear_stop", {"ask": "stop", "clear": True}),
    OperatorService("go_to", {"ask": "go-to"}, DRONES_FIELD | PLACE_FIELDS),
    OperatorService("velocity", {"ask": "move"}, DRONES_FIELD | VELOCITY_FIELDS),
)
"""All services."""
_SERVICE_BY_PATH = {service.path: service for service in OPERATOR_SERVICES}


class ServiceDesk:
    """Carries out the requests of services as an operator of the page does.

    operator: checks a request, and gives its command
    desk: sends commands, and keeps their receipts
    """

    def __init__(self, operator: PageOperator, desk: CommandDesk) -> None:
        self._operator = operator
        self._desk = desk

    async def call(self, path: str, request: Mapping[str, Any]) -> dict[str, Any]:
        """Give a command, and return its receipt when no further answer can come.

        path: full name of the service
        request: its fields
        Raises ConfigError, or msgspec.ValidationError, for a request that cannot be carried out.
        """
        return describe_receipt(await self._desk.settled(self.begin(path, request)))

    def begin(self, path: str, request: Mapping[str, Any]) -> Receipt:
        """Give a command without waiting, and return its receipt; raises as `call` does."""
        service = _SERVICE_BY_PATH.get(path)
        if service is None:
            raise ConfigError("service", path, ", ".join(_SERVICE_BY_PATH))
        unknown = request.keys() - service.fields
        if unknown:
            raise ConfigError(
                f"service {path}", sorted(unknown), ", ".join(service.fields)
            )
        message = decode_page_message(json_bytes({**request, **service.message}))
        if not isinstance(message, Order | Stop | GoTo | Move):
            raise TypeError(f"{path} stands for {message}")
        return self._operator.command(message)

    def steer(self, drone: int, v: Point, yaw_rate: float) -> Receipt | None:
        """Let a drone fly with one velocity of a stream, as with the stick of the page.

        It rests STICK_TIMES.velocity_duration s after the last one, or when zeros come.

        drone: id
        v: (3,) m/s, world
        yaw_rate: rad/s
        Returns the receipt of the whole flight, or None for zeros while the drone does not fly by hand.
        Raises ConfigError, or msgspec.ValidationError, for a velocity out of bounds.
        """
        if is_release(v, yaw_rate) and not self._desk.flies_by_hand(drone):
            return None
        told = {"ask": "steer", "drone": drone, "v": list(v), "yaw_rate": yaw_rate}
        return self._operator.command(msgspec.json.decode(json_bytes(told), type=Steer))


def describe_receipt(receipt: Receipt) -> dict[str, Any]:
    """Return a receipt for JSON: whether all drones have done it, and the answer of each drone."""
    answers = {
        str(i): {"answer": kind, "says": str(words)}
        for i, (kind, words) in receipt.answers.items()
    }
    return {"done": receipt.done(), "answers": answers}
