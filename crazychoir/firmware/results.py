"""The results of commands: what the firmware answers at the ports of plans, logs and memories."""

from typing import NamedTuple


class FirmwareResults(NamedTuple):
    """Results in answers of the firmware; except the first two they are numbers of errno."""

    done: int = 0
    """The command was done."""
    refused: int = 1
    """The planner cannot do this in its state."""
    not_found: int = 2
    """ENOENT: there is no such block, variable or parameter."""
    input_output_error: int = 5
    """EIO: there is no such address in a memory."""
    too_large: int = 7
    """E2BIG: the values of a log block would be too long."""
    unknown_command: int = 8
    """ENOEXEC: the command is unknown, or it names a trajectory that cannot be."""
    no_room: int = 12
    """ENOMEM: there are too many log blocks or variables."""
    busy: int = 16
    """EBUSY: the supervisor does not allow flight."""
    exists: int = 17
    """EEXIST: the log block is there already."""


FIRMWARE_RESULTS = FirmwareResults()


LANDING_RESULTS = (FIRMWARE_RESULTS.done, FIRMWARE_RESULTS.refused)
"""Results of a command to land by which the planner starts to land, or lands already."""
