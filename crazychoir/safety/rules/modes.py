"""The flight state machine of all schemes: one table says what each event does in each mode."""

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


class Event(Enum):
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


GROUND, TAKEOFF, HOVER, FOLLOW, RETURN, LAND, CUT = Mode
# Members of an enumeration are slow to look up, above all in Python 3.11; each tick needs these.
DOWN = (GROUND, CUT)
"""Modes in which the motors are off."""
GUIDED = (FOLLOW, HOVER, TAKEOFF)
"""Modes in which guidance may move the drone."""
COMMANDS = (
    Event.ARM,
    Event.TAKE_OFF,
    Event.START,
    Event.HOLD,
    Event.GO,
    Event.LAND,
    Event.HOME,
    Event.STOP,
)
"""Events that an operator may command."""
HELD = "held by its operator"
"""Text for a drone that stays where it is until its operator lets it go on."""

_STANDS = "it is on the ground"
_LANDS = "it is landing"
_RETURNS = "it is returning: its mission is over"
_OFF = "its motors are off until its agent is started again"
_FLIES = "it is in the air already"
_UNPLANNED = "no flight is planned"
_UP = "it is not landing"
_RISES = "it is taking off already"

TABLE: dict[Mode, dict[Event, Mode | str]] = {
    GROUND: {
        Event.ARM: GROUND,
        Event.TAKE_OFF: TAKEOFF,
        Event.START: GROUND,
        Event.HOLD: GROUND,
        Event.GO: GROUND,
        Event.LAND: GROUND,
        Event.HOME: _STANDS,
        Event.STOP: CUT,
        Event.FLY: _STANDS,
        Event.ARRIVED: _UNPLANNED,
        Event.DOWN: GROUND,
        Event.FOUND: HOVER,
    },
    TAKEOFF: {
        Event.ARM: _RISES,
        Event.TAKE_OFF: _RISES,
        Event.START: TAKEOFF,
        Event.HOLD: HOVER,
        Event.GO: TAKEOFF,
        Event.LAND: LAND,
        Event.HOME: RETURN,
        Event.STOP: CUT,
        Event.FLY: FOLLOW,
        Event.ARRIVED: HOVER,
        Event.DOWN: _UP,
        Event.FOUND: TAKEOFF,
    },
    HOVER: {
        Event.ARM: _FLIES,
        Event.TAKE_OFF: _FLIES,
        Event.START: HOVER,
        Event.HOLD: HOVER,
        Event.GO: HOVER,
        Event.LAND: LAND,
        Event.HOME: RETURN,
        Event.STOP: CUT,
        Event.FLY: FOLLOW,
        Event.ARRIVED: HOVER,
        Event.DOWN: _UP,
        Event.FOUND: HOVER,
    },
    FOLLOW: {
        Event.ARM: _FLIES,
        Event.TAKE_OFF: _FLIES,
        Event.START: FOLLOW,
        Event.HOLD: HOVER,
        Event.GO: FOLLOW,
        Event.LAND: LAND,
        Event.HOME: RETURN,
        Event.STOP: CUT,
        Event.FLY: FOLLOW,
        Event.ARRIVED: HOVER,
        Event.DOWN: _UP,
        Event.FOUND: FOLLOW,
    },
    RETURN: {
        Event.ARM: _FLIES,
        Event.TAKE_OFF: _FLIES,
        Event.START: _RETURNS,
        Event.HOLD: HOVER,
        Event.GO: RETURN,
        Event.LAND: LAND,
        Event.HOME: RETURN,
        Event.STOP: CUT,
        Event.FLY: _RETURNS,
        Event.ARRIVED: LAND,
        Event.DOWN: _UP,
        Event.FOUND: RETURN,
    },
    LAND: {
        Event.ARM: _LANDS,
        Event.TAKE_OFF: _LANDS,
        Event.START: _LANDS,
        Event.HOLD: _LANDS,
        Event.GO: _LANDS,
        Event.LAND: LAND,
        Event.HOME: _LANDS,
        Event.STOP: CUT,
        Event.FLY: _LANDS,
        Event.ARRIVED: LAND,
        Event.DOWN: GROUND,
        Event.FOUND: LAND,
    },
    CUT: {event: _OFF for event in Event} | {Event.STOP: CUT},
}
"""For each mode and event: the next mode, or the reason why the event changes nothing.

START frees a mission that waits for its operator, and GO frees a held mission. Neither changes
the mode: what guidance does next changes it. Other conditions (a pose, a latched rule of the
safety table, a waiting mission) are checked before this table is read.
"""


def after(mode: Mode, event: Event) -> Mode:
    """Return the mode after an event: the old mode if the table refuses the event."""
    found = TABLE[mode][event]
    return found if isinstance(found, Mode) else mode


def refusal(mode: Mode, event: Event) -> str:
    """Return why the table refuses the event in this mode; empty if it does not."""
    found = TABLE[mode][event]
    return found if isinstance(found, str) else ""
