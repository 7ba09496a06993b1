"""Pilots for tests, each with a batch of its own, and their ticks."""

from crazychoir.flight.body import LocalBody
from crazychoir.flight.pilot import Pilot
from crazychoir.flight.setup import FlightSetup


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


def make_pilot(port, link, limits, room, *, state_filter=None, collision=None, **setup):
    """Return the pilot of a drone with this link, in this room; behind a radio its body tells what a test wants."""
    has_radio = setup.get("reach", "no") != "no"
    return Pilot(
        port,
        TellingBody(link) if has_radio else LocalBody(link),
        FlightSetup(limits=limits, room=room, **setup),
        state_filter,
        collision,
    )


def tick(pilot, pose):
    """Let the drone tick with a pose, which is believed, or without one, now."""
    pilot.tick.see(pilot.row.index, pose)
    pilot.tick.run()
