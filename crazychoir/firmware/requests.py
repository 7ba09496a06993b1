"""Channels and commands of the requests for the link, logs, parameters, the platform and the supervisor.

The packets with fields are in radio/protocol/crtp.py, those of memories in memories.py.
"""

from enum import IntEnum
from typing import NamedTuple


class LinkChannels(NamedTuple):
    """Channels of the port of the link itself."""

    echo: int = 0
    """Returns each packet."""
    source: int = 1
    """Tells what kind of drone is at the end of the link."""
    sink: int = 2
    """Drops each packet."""
    null: int = 3
    """Empty packets, which only the link handles."""


LINK_CHANNELS = LinkChannels()


class LogChannels(NamedTuple):
    """Channels of logs."""

    table: int = 0
    """The table of log variables."""
    settings: int = 1
    """The commands of `BlockCommand`."""
    values: int = 2
    """Values from the drone."""


LOG_CHANNELS = LogChannels()


class BlockCommand(IntEnum):
    """Commands for log blocks; 0 and 1 are those of an old version, which is not served."""

    DELETE = 2
    """Deletes a block."""
    START = 3
    """Starts a block, with a period in 10 ms."""
    STOP = 4
    """Stops a block."""
    RESET = 5
    """Deletes all blocks."""
    CREATE = 6
    """Creates a block."""
    APPEND = 7
    """Adds variables to a block."""
    START_V2 = 8
    """Starts a block, with a period in ms."""


class ParameterChannels(NamedTuple):
    """Channels of parameters."""

    table: int = 0
    """The table of parameters."""
    read: int = 1
    """Reads parameters."""
    write: int = 2
    """Writes parameters."""


PARAMETER_CHANNELS = ParameterChannels()


class PlatformRequests(NamedTuple):
    """Channels and commands of the platform."""

    command_channel: int = 0
    """Channel of commands, such as `notification`."""
    version_channel: int = 1
    """Channel of the requests below."""
    protocol: int = 0
    """Asks for the version of the protocol."""
    release: int = 1
    """Asks for the release."""
    device: int = 2
    """Asks for the kind of drone."""
    notification: int = 3
    """Command that shows the user a sign; its answer is empty."""


PLATFORM_REQUESTS = PlatformRequests()


class SupervisorRequests(NamedTuple):
    """Requests for the supervisor."""

    all_bits: int = 12
    """Asks for all bits of `SupervisorBits`; 1 to 11 ask for the first to the eleventh."""
    answer: int = 0x80
    """Bit that an answer adds to its request."""


SUPERVISOR_REQUESTS = SupervisorRequests()


class PowerPackets(NamedTuple):
    """Packets on the null channel of the link by which the chip of the radio switches a drone."""

    mark: int = 0xFE
    """First byte."""
    all_off: int = 0x01
    """Switches the whole drone off, as its button does."""
    system_off: int = 0x02
    """Switches the main processor and the decks off; the chip of the radio stays on."""
    system_on: int = 0x03
    """Switches the main processor and the decks on."""


POWER_PACKETS = PowerPackets()
