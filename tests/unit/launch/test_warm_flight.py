"""The flight of the fork server calls what the processes of a swarm need, and leaves nothing behind."""

import os
import threading

import pytest

from crazychoir.guidance.guidance import CFGuidance
from crazychoir.launch.process.warm_flight import (
    CRUISING_HEIGHT,
    FLIGHT_LENGTH,
    ShortFlight,
    fly_once,
)


def test_both_drones_fly_and_land(monkeypatch):
    places = {}

    async def land(self):
        x, y, _ = self.member.config.drone(self.id).home
        places[self.id] = self.state.p - (x, y, 0.0)
        await CFGuidance.land(self)
        places[self.id, "landed"] = self.state.p[2]

    monkeypatch.setattr(ShortFlight, "land", land)
    fly_once()
    for i in (0, 1):
        assert places[i] == pytest.approx(
            (FLIGHT_LENGTH, 0.0, CRUISING_HEIGHT), abs=0.05
        )
        assert places[i, "landed"] < 0.05


def test_no_thread_and_no_file_is_left():
    fly_once()
    files = os.listdir("/proc/self/fd")
    before = threading.enumerate()
    fly_once()
    assert len(os.listdir("/proc/self/fd")) == len(files)
    for thread in threading.enumerate():
        if thread not in before:
            thread.join(2.0)  # the watch of the mission needs a moment to end
            assert not thread.is_alive()
