"""Periods, pauses and deadlines that the parts of a drone on a radio share."""

from dataclasses import dataclass

from crazychoir.firmware.timeouts import FIRMWARE_TIMEOUTS

LINK_CHECK_RATE = 20.0
"""Hz at which links are checked."""


@dataclass(frozen=True, slots=True)
class SilenceLimits:
    """Seconds without packets, logs or commands after which a link or a drone counts as troubled."""

    link_degraded: float = 0.3
    """s of silence after which a link is degraded. Set-points are still sent: the firmware takes
    the first that arrives, if it arrives within 2 s.
    """
    link_lost: float = 2.5
    """s of silence after which a link is lost and is opened again."""
    drone_unreached: float = 1.0
    """s of silence after which a drone may not have obeyed its last command."""
    logs_dropped: float = 1e-3 * FIRMWARE_TIMEOUTS.link_silence
    """s without a log from a drone that still answers: its firmware has dropped its log blocks."""
    drone_orphaned: float = 3.0
    """s without commands after which a flying drone is landed."""


SILENCE_LIMITS = SilenceLimits()


@dataclass(frozen=True, slots=True)
class ConnectAttempts:
    """Pauses between the attempts to connect, and their deadlines."""

    early_pause: float = 0.2
    """s: time between two attempts to connect, before the deadline."""
    late_pause: float = 1.0
    """s: time between two attempts to connect, after the deadline."""
    reopen_deadline: float = 1.5
    """s for an attempt to connect in flight; the tables of contents are known by then."""
    tables_deadline: float = 30.0
    """More s for a first connection, on the ground, that still loads its tables of contents. Over
    a dongle that four drones share, the tables take about 10 s, once for each firmware.
    """


CONNECT_ATTEMPTS = ConnectAttempts()


@dataclass(frozen=True, slots=True)
class RepeatRules:
    """When packets to land, to stop and to feed the watchdog are sent again."""

    land_period: float = 0.25
    """s between two commands to land until the planner on board answers."""
    refused_pause: float = 1.0
    """s until the next command to land after the planner has refused one."""
    stop_delay: float = 1.0
    """s after the planned end of a landing until the drone is told to stop. The planner has then
    ended the landing. The command to land is not repeated from then on: the planner would start
    a new landing.
    """
    vain_time: float = 3.0
    """s of unanswered commands to land after which the motors may be stopped instead. The link
    works meanwhile: otherwise the drone may still land when it receives the command.
    """
    longest_overrun: float = 10.0
    """s after its planned end in which a landing is not ended while the firmware says that its planner flies."""
    stop_period: float = 0.5
    """s between two commands to stop, for a drone that stands."""
    watchdog_period: float = 0.25e-3 * FIRMWARE_TIMEOUTS.watchdog
    """s between two packets for the emergency-stop watchdog: four within its time."""


REPEAT_RULES = RepeatRules()
