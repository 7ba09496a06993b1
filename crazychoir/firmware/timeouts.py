"""The times after which the firmware acts by itself."""

from typing import NamedTuple


class FirmwareTimeouts(NamedTuple):
    """Times in ms after which the firmware levels out, locks, disarms or forgets."""

    level_out: int = 500
    """ms without a set-point before a flying drone levels out."""
    free_fall: int = 2000
    """ms without a set-point before the motors of a flying drone are cut."""
    watchdog: int = 1000
    """ms without a packet for the emergency-stop watchdog before the motors are cut. It starts
    with its first packet.
    """
    resting: int = 2000
    """ms with the motors at idle before a drone no longer counts as flying."""
    tilted: int = 1000
    """ms not upright before a drone counts as tumbled."""
    inverted: int = 100
    """ms on its back before a drone counts as tumbled."""
    preflight: int = 30000
    """ms after which a drone that was armed and does not fly is disarmed, by default."""
    landed: int = 3000
    """ms after a landing until a drone is disarmed, by default."""
    spin_up: int = 2000
    """ms in which the motors of a drone that is being armed must turn, by default."""
    link_silence: int = 1000
    """ms without a packet after which the link counts as lost and the log blocks are dropped."""
    link_statistics: int = 500
    """ms over which the rates of packets are counted."""
    supervision: int = 40
    """ms between two passes of the supervisor."""


FIRMWARE_TIMEOUTS = FirmwareTimeouts()
