"""The memories of a drone, and how packets read and write them."""

from typing import NamedTuple


class MemoryKinds(NamedTuple):
    """Types of memories. There is no 1-wire memory: clients would read it at each connection."""

    eeprom: int = 0x00
    """Configuration of the radio."""
    leds: int = 0x10
    """Colours of the LED ring."""
    trajectory: int = 0x12
    """Trajectories."""
    lighthouse: int = 0x14
    """Geometry and calibration of the lighthouses."""
    tester: int = 0x15
    """Test of memories."""
    timings: int = 0x17
    """Timings of the LED ring."""
    decks: int = 0x19
    """Properties of decks."""


MEMORY_KINDS = MemoryKinds()


class MemoryPackets(NamedTuple):
    """Channels, commands and sizes of packets for memories."""

    information: int = 0
    """Channel for the commands `count_command` and `description_command`."""
    read: int = 1
    """Channel that reads memories."""
    write: int = 2
    """Channel that writes memories."""
    count_command: int = 1
    """Command that asks for the number of memories."""
    description_command: int = 2
    """Command that asks for the type and size of one memory."""
    largest_part: int = 24
    """Most bytes that one packet reads; a packet that writes could hold one more."""


MEMORY_PACKETS = MemoryPackets()


class TrajectoryMemory(NamedTuple):
    """Sizes of the memory for trajectories."""

    slot_count: int = 31
    """Slots for trajectories."""
    byte_count: int = 4096
    """Bytes of the memory."""
    size: int = 1024
    """Float32 in the memory."""
    piece_size: int = 33
    """Float32 of one piece: 4 axes of 8 coefficients and a duration."""
    most_pieces: int = 31
    """Pieces that fit into the memory."""


TRAJECTORY_MEMORY = TrajectoryMemory()


class TrajectoryKinds(NamedTuple):
    """Where a trajectory lies, and how it is written."""

    memory: int = 1
    """Location: the memory for trajectories."""
    polynomial: int = 0
    """Type: pieces of degree 7."""
    compressed: int = 1
    """Type: Bezier curves in 16 bits."""


TRAJECTORY_KINDS = TrajectoryKinds()


class MemorySizes(NamedTuple):
    """Sizes of the memories in bytes, as the firmware tells them."""

    eeprom: int = 0x1FFF
    """Bytes of the EEPROM that are served: all but the last."""
    leds: int = 24
    """Bytes of the colours of twelve LEDs."""
    lighthouse: int = 0x2000
    """Bytes for geometries and calibrations."""
    tester: int = 0x1000
    """Bytes of the test of memories."""
    timings: int = 2000
    """Bytes of the timings of the LED ring."""
    deck: int = 0x10000000
    """Bytes of the section of each deck, and of the section before them with their properties."""
    most_decks: int = 4
    """Decks that have a section."""


MEMORY_SIZES = MemorySizes()
