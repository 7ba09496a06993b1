"""The flight state machine that all schemes share: what each command and event does in each mode, in one table."""

from enum import Enum


class Mode(Enum):
    """What the pilot is doing."""

    GROUND = "on ground"
    TAKEOFF = "taking off"
    HOVER = "hovering"
    FOLLOW = "mission"  # flies what guidance wants: references, or a flight that it has planned
    RETURN = "returning"
    LAND = "landing"
    CUT = "stopped"


class Event(Enum):
    """What may change the mode: what operators command, what guidance wants, what the flight itself comes to."""

    ARM = "arm"
    TAKE_OFF = "take-off"
    START = "start"
    HOLD = "hold"
    GO = "go"
    LAND = "land"
    HOME = "home"
    STOP = "stop"
    FLY = "fly"  # guidance flies to a place, along a trajectory, or a reference
    ARRIVED = "arrived"  # the flight that was planned is over
    DOWN = "down"  # it is low enough, or at rest where its descent ends
    FOUND = "found in the air"  # another agent has flown it there


GROUND, TAKEOFF, HOVER, FOLLOW, RETURN, LAND, CUT = Mode
# Members of an enumeration are slow to look up, in Python 3.11 above all; a tick needs these.
DOWN = (GROUND, CUT)
GUIDED = (FOLLOW, HOVER, TAKEOFF)
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
"""What an operator may command."""
HELD = "held by its operator"
"""Said of a drone that stays where it is until it is let go."""

_STANDS, _LANDS = "it is on the ground", "it is landing"
_RETURNS = "it is returning: its mission is over"
_OFF = "its motors are off until its agent is started again"
_FLIES, _UNPLANNED, _UP = (
    "it is in the air already",
    "no flight is planned",
    "it is not landing",
)
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
"""By mode and event: the next mode, or why the event changes nothing.

A start frees a mission that waits for its operator, go one that was held: both leave the mode to what guidance does
then. What else must hold (a pose, a latched rule of the safety table, a mission that waits) is asked before.
"""


def after(mode: Mode, event: Event) -> Mode:
    """The mode after an event: the same one where the table refuses it."""
    found = TABLE[mode][event]
    return found if isinstance(found, Mode) else mode


def refusal(mode: Mode, event: Event) -> str:
    """Why the table refuses the event in this mode; empty if it does not."""
    found = TABLE[mode][event]
    return found if isinstance(found, str) else ""
