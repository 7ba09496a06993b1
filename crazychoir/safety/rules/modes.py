"""The flight modes of a drone: one table says what each event does in each mode.

All control schemes use it.
"""

from dataclasses import dataclass
from enum import Enum


class Mode(Enum):
    """Modes of the pilot."""

    GROUND = "on ground"
    TAKEOFF = "taking off"
    HOVER = "hovering"
    FOLLOW = "mission"  # flies what guidance wants: references, or a planned flight
    RETURN = "returning"
    LAND = "landing"
    CUT = "stopped"


class ModeEvent(Enum):
    """Events that may change the mode: commands of an operator or of guidance, or progress."""

    ARM = "arm"
    TAKE_OFF = "take-off"
    START = "start"
    HOLD = "hold"
    GO = "go"
    LAND = "land"
    HOME = "home"
    STOP = "stop"
    FLY = "fly"  # guidance flies to a place, along a trajectory, or a reference
    ARRIVED = "arrived"  # the planned flight is over
    DOWN = "down"  # low enough, or at rest where the descent ends
    FOUND = "found in the air"  # another agent has flown the drone there


# Members of an enumeration are slow to look up, above all in Python 3.11; each tick needs these.
GROUND_MODE = Mode.GROUND
TAKEOFF_MODE = Mode.TAKEOFF
HOVER_MODE = Mode.HOVER
FOLLOW_MODE = Mode.FOLLOW
RETURN_MODE = Mode.RETURN
LAND_MODE = Mode.LAND
CUT_MODE = Mode.CUT
MOTORS_OFF_MODES = (GROUND_MODE, CUT_MODE)
"""Modes in which the motors are off."""
GUIDED_MODES = (FOLLOW_MODE, HOVER_MODE, TAKEOFF_MODE)
"""Modes in which guidance may move the drone."""
OPERATOR_EVENTS = (
    ModeEvent.ARM,
    ModeEvent.TAKE_OFF,
    ModeEvent.START,
    ModeEvent.HOLD,
    ModeEvent.GO,
    ModeEvent.LAND,
    ModeEvent.HOME,
    ModeEvent.STOP,
)
"""Events that an operator may command."""
HELD_TEXT = "held by its operator"
"""Text for a drone that stays where it is until its operator lets it go on."""


@dataclass(frozen=True, slots=True)
class _RefusalTexts:
    """The reasons why the mode table refuses an event."""

    on_ground: str = "it is on the ground"
    """Of a drone that stands on the ground."""
    landing: str = "it is landing"
    """Of a landing drone."""
    returning: str = "it is returning: its mission is over"
    """Of a drone that returns after its mission."""
    motors_off: str = "its motors are off until its agent is started again"
    """Of a drone with stopped motors."""
    in_air: str = "it is in the air already"
    """Of a flying drone."""
    no_flight: str = "no flight is planned"
    """Of a drone without a planned flight."""
    not_landing: str = "it is not landing"
    """Of a flying drone that does not land."""
    taking_off: str = "it is taking off already"
    """Of a drone that takes off."""


_REFUSAL_TEXTS = _RefusalTexts()


MODE_TABLE: dict[Mode, dict[ModeEvent, Mode | str]] = {
    GROUND_MODE: {
        ModeEvent.ARM: GROUND_MODE,
        ModeEvent.TAKE_OFF: TAKEOFF_MODE,
        ModeEvent.START: GROUND_MODE,
        ModeEvent.HOLD: GROUND_MODE,
        ModeEvent.GO: GROUND_MODE,
        ModeEvent.LAND: GROUND_MODE,
        ModeEvent.HOME: _REFUSAL_TEXTS.on_ground,
        ModeEvent.STOP: CUT_MODE,
        ModeEvent.FLY: _REFUSAL_TEXTS.on_ground,
        ModeEvent.ARRIVED: _REFUSAL_TEXTS.no_flight,
        ModeEvent.DOWN: GROUND_MODE,
        ModeEvent.FOUND: HOVER_MODE,
    },
    TAKEOFF_MODE: {
        ModeEvent.ARM: _REFUSAL_TEXTS.taking_off,
        ModeEvent.TAKE_OFF: _REFUSAL_TEXTS.taking_off,
        ModeEvent.START: TAKEOFF_MODE,
        ModeEvent.HOLD: HOVER_MODE,
        ModeEvent.GO: TAKEOFF_MODE,
        ModeEvent.LAND: LAND_MODE,
        ModeEvent.HOME: RETURN_MODE,
        ModeEvent.STOP: CUT_MODE,
        ModeEvent.FLY: FOLLOW_MODE,
        ModeEvent.ARRIVED: HOVER_MODE,
        ModeEvent.DOWN: _REFUSAL_TEXTS.not_landing,
        ModeEvent.FOUND: TAKEOFF_MODE,
    },
    HOVER_MODE: {
        ModeEvent.ARM: _REFUSAL_TEXTS.in_air,
        ModeEvent.TAKE_OFF: _REFUSAL_TEXTS.in_air,
        ModeEvent.START: HOVER_MODE,
        ModeEvent.HOLD: HOVER_MODE,
        ModeEvent.GO: HOVER_MODE,
        ModeEvent.LAND: LAND_MODE,
        ModeEvent.HOME: RETURN_MODE,
        ModeEvent.STOP: CUT_MODE,
        ModeEvent.FLY: FOLLOW_MODE,
        ModeEvent.ARRIVED: HOVER_MODE,
        ModeEvent.DOWN: _REFUSAL_TEXTS.not_landing,
        ModeEvent.FOUND: HOVER_MODE,
    },
    FOLLOW_MODE: {
        ModeEvent.ARM: _REFUSAL_TEXTS.in_air,
        ModeEvent.TAKE_OFF: _REFUSAL_TEXTS.in_air,
        ModeEvent.START: FOLLOW_MODE,
        ModeEvent.HOLD: HOVER_MODE,
        ModeEvent.GO: FOLLOW_MODE,
        ModeEvent.LAND: LAND_MODE,
        ModeEvent.HOME: RETURN_MODE,
        ModeEvent.STOP: CUT_MODE,
        ModeEvent.FLY: FOLLOW_MODE,
        ModeEvent.ARRIVED: HOVER_MODE,
        ModeEvent.DOWN: _REFUSAL_TEXTS.not_landing,
        ModeEvent.FOUND: FOLLOW_MODE,
    },
    RETURN_MODE: {
        ModeEvent.ARM: _REFUSAL_TEXTS.in_air,
        ModeEvent.TAKE_OFF: _REFUSAL_TEXTS.in_air,
        ModeEvent.START: _REFUSAL_TEXTS.returning,
        ModeEvent.HOLD: HOVER_MODE,
        ModeEvent.GO: RETURN_MODE,
        ModeEvent.LAND: LAND_MODE,
        ModeEvent.HOME: RETURN_MODE,
        ModeEvent.STOP: CUT_MODE,
        ModeEvent.FLY: _REFUSAL_TEXTS.returning,
        ModeEvent.ARRIVED: LAND_MODE,
        ModeEvent.DOWN: _REFUSAL_TEXTS.not_landing,
        ModeEvent.FOUND: RETURN_MODE,
    },
    LAND_MODE: {
        ModeEvent.ARM: _REFUSAL_TEXTS.landing,
        ModeEvent.TAKE_OFF: _REFUSAL_TEXTS.landing,
        ModeEvent.START: _REFUSAL_TEXTS.landing,
        ModeEvent.HOLD: _REFUSAL_TEXTS.landing,
        ModeEvent.GO: _REFUSAL_TEXTS.landing,
        ModeEvent.LAND: LAND_MODE,
        ModeEvent.HOME: _REFUSAL_TEXTS.landing,
        ModeEvent.STOP: CUT_MODE,
        ModeEvent.FLY: _REFUSAL_TEXTS.landing,
        ModeEvent.ARRIVED: LAND_MODE,
        ModeEvent.DOWN: GROUND_MODE,
        ModeEvent.FOUND: LAND_MODE,
    },
    CUT_MODE: {event: _REFUSAL_TEXTS.motors_off for event in ModeEvent}
    | {ModeEvent.STOP: CUT_MODE},
}
"""For each mode and event: the next mode, or the reason why the event changes nothing.

START frees a mission that waits for its operator, and GO frees a held mission. Neither changes
the mode: what guidance does next changes it. Other conditions (a pose, a latched rule of the
safety table, a waiting mission) are checked before this table is read.
"""


def get_next_mode(mode: Mode, event: ModeEvent) -> Mode:
    """Return the mode after an event: the old mode if the table refuses the event."""
    found = MODE_TABLE[mode][event]
    return found if isinstance(found, Mode) else mode


def get_refusal(mode: Mode, event: ModeEvent) -> str:
    """Return why the table refuses the event in this mode; empty if it does not."""
    found = MODE_TABLE[mode][event]
    return found if isinstance(found, str) else ""
