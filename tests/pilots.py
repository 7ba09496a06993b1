"""Pilots for tests, each with a batch of its own, their ticks, and stand-ins for pilots."""

from types import SimpleNamespace

from crazychoir.flight.body import LocalBody
from crazychoir.flight.pilot import Pilot
from crazychoir.flight.setup import FlightSetup
from crazychoir.safety.rules.guard import Guard


class TellingBody(LocalBody):
    """A body that says of its motors and its owner what a test wants."""

    is_watched = True

    def __init__(self, link):
        super().__init__(link)
        self.turning, self.unheard, self.astray = False, False, ""
        self.problems = []

    def is_turning(self):
        """What the test wants."""
        return self.turning

    def is_unheard(self):
        """What the test wants."""
        return self.unheard

    def list_problems(self):
        """What the test wants."""
        return self.problems

    def explain_astray(self):
        """What the test wants."""
        return self.astray


def make_pilot(
    port,
    link,
    limits,
    room,
    *,
    state_filter=None,
    collision=None,
    shared=None,
    row=None,
    **setup,
):
    """Return the pilot of a drone with this link, in this room.

    Behind a radio its body tells what a test wants.

    shared: the tick that the drone shares with others; None for one of its own
    row: record of the drone in the batch of the tick; None for a new one
    setup: fields of FlightSetup
    """
    has_radio = setup.get("reach", "no") != "no"
    return Pilot(
        port,
        TellingBody(link) if has_radio else LocalBody(link),
        FlightSetup(limits=limits, room=room, **setup),
        state_filter,
        collision,
        shared,
        row,
    )


def make_stand_in(parts):
    """Return a stand-in for a pilot that has only these parts.

    parts: values by dotted name, such as {"notes.text": "", "permission.held": False}
    """
    whole = SimpleNamespace()
    for name, value in parts.items():
        *path, last = name.split(".")
        part = whole
        for step in path:
            part = vars(part).setdefault(step, SimpleNamespace())
        setattr(part, last, value)
    return whole


def change_fence(pilot, fence):
    """Let the guard of a drone keep it in this fence from now on, with the default safety table."""
    Guard.__init__(pilot.guard, fence, rows=pilot.guard._rows)


def tick(pilot, pose):
    """Let the drone tick with a pose, which is believed, or without one, now."""
    pilot.tick.see(pilot.row.index, pose)
    pilot.tick.run()
