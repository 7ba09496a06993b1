"""Commands of an operator as services of another tool: a request in JSON, answered by a receipt."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from crazychoir.dashboard.commands import CommandDesk
from crazychoir.dashboard.operator import PageOperator
from crazychoir.dashboard.receipts import Receipt
from crazychoir.dashboard.requests import GoTo, Order, Stop, decode_page_message
from crazychoir.errors import ConfigError
from crazychoir.files.path_texts import json_bytes

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
        if not isinstance(message, Order | Stop | GoTo):
            raise TypeError(f"{path} stands for {message}")
        return self._operator.command(message)


def describe_receipt(receipt: Receipt) -> dict[str, Any]:
    """Return a receipt for JSON: whether all drones have done it, and the answer of each drone."""
    answers = {
        str(i): {"answer": kind, "says": str(words)}
        for i, (kind, words) in receipt.answers.items()
    }
    return {"done": receipt.done(), "answers": answers}
