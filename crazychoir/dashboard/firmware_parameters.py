"""Parameters of the firmware of drones: their names, their values, and changes of them, for a page."""

from collections.abc import Mapping
from typing import Any

from crazychoir.bus.commands import ANSWER_TEXTS
from crazychoir.dashboard.commands import CommandDesk
from crazychoir.dashboard.orders import ORDER_LIMITS
from crazychoir.dashboard.receipts import RECEIPT_TEXTS

FLOAT_DIGITS = 7
"""Digits of a float32 that are shown."""


class FirmwareParameters:
    """Lists, reads and sets parameters of the firmware of drones.

    desk: gives the commands
    """

    def __init__(self, desk: CommandDesk) -> None:
        self._desk = desk

    async def list_names(self, drone: int) -> dict[str, Any]:
        """Return type and access of all parameters of a drone, by name, or the problem."""
        return {"parameters": await self._ask(drone, "types", "firmware_list")}

    async def read(self, drone: int, name: str) -> dict[str, Any]:
        """Return the value of a parameter, or the values of a group, or the problem."""
        told = await self._ask(drone, "values", "firmware_get", name=name)
        return {"parameters": told}

    async def change(
        self, drone: int, name: str, value: float
    ) -> dict[str, Any] | None:
        """Set a parameter, and return the value that the firmware then has.

        Returns None if the drone has not set it; the receipt of the command says why.
        """
        taken: dict[str, float] = {}

        def describe(values: Mapping[str, float]) -> str:
            taken.update(values)
            return ", ".join(
                f"{name} = {_number_text(value)}" for name, value in values.items()
            )

        receipt = self._desk.order(
            "firmware_set",
            (drone,),
            words=f"{name} = {_number_text(value)}",
            each=lambda i: {"name": name, "value": value},
            says=describe,
        )
        await self._desk.settled(receipt)
        return {"parameters": {"drone": drone, "values": taken}} if taken else None

    async def _ask(
        self, drone: int, kind: str, verb: str, **arguments: Any
    ) -> dict[str, Any]:
        """Return the answer of a drone under the name `kind`, or the problem in words."""
        place = self._desk.place
        told: dict[str, Any] = {"drone": drone}
        if place.replays:
            return told | {"problem": RECEIPT_TEXTS.replayed}
        try:
            answer = await place.commander.request(
                drone, verb, ORDER_LIMITS.request_timeout, **arguments
            )
        except TimeoutError as error:
            return told | {"problem": str(error)}
        if answer.kind != ANSWER_TEXTS.done:
            return told | {"problem": f"drone {drone}: {answer.detail}"}
        return told | {kind: answer.detail}


def _number_text(value: float) -> str:
    """Return a whole number with all its digits, another one with those of a float32."""
    is_whole = float(value).is_integer()
    return str(int(value)) if is_whole else f"{value:.{FLOAT_DIGITS}g}"
