"""Messages as tuples, for handlers in tests that compare them; ports that hear nothing."""

from collections.abc import Callable
from typing import Any

from crazychoir.bus.message import Message
from crazychoir.bus.port import Handler, Port


def list_parts(message: Message, age: float) -> tuple[int, bytes, int, str, int, float]:
    """(source, payload, number, channel, flags, age)"""
    return (
        message.source,
        message.payload,
        message.number,
        message.channel,
        message.flags,
        age,
    )


def taking_parts(take: Callable[..., Any]) -> Handler:
    """A handler that gives the parts of each message to `take`."""

    def handle(message: Message, age: float) -> None:
        take(*list_parts(message, age))

    return handle


def deafen(port: Port) -> Callable[[], None]:
    """Let a port hear nothing until the function that is returned is called."""
    handlers, mailboxes = port.handlers, port.mailboxes
    port.handlers, port.mailboxes = {}, {}

    def hear() -> None:
        port.handlers, port.mailboxes = handlers, mailboxes

    return hear
