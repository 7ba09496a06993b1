"""Readers in processes of their own, with stand-ins for the library: it hangs, it fails, it sees."""

import asyncio
import sys
from pathlib import Path

import pytest

from crazychoir.errors import ConfigError
from crazychoir.mocap.system import SystemSource
from crazychoir.runtime.clock import run_wall

HANGS = """
import ctypes

def connect(system, settings):
    ctypes.PyDLL(None).pause()  # in C, and the interpreter's lock is kept
"""
FAILS = "def connect(system, settings): raise RuntimeError(f'{system}: no {settings}')"
SEES = """
import ctypes, time
from types import SimpleNamespace

def connect(system, settings):
    assert settings == {"hostname": "10.0.0.5", "gain": "2"}
    return Cameras()

class Cameras:
    k = 0
    def waitForNextFrame(self):
        time.sleep(0.01)
        self.k += 1
        if self.k > 20:
            ctypes.PyDLL(None).pause()
    @property
    def rigidBodies(self):
        q = SimpleNamespace(x=0.0, y=0.0, z=0.6, w=0.8)
        one = SimpleNamespace(position=[self.k, 2.0, 3.0], rotation=q)
        return {"cf0": one, 50 * "x": one}
"""


@pytest.fixture
def library(tmp_path, monkeypatch):
    """A stand-in for `motioncapture`, for this process and its children."""

    def installed(text):
        (tmp_path / "motioncapture.py").write_text(text)
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{Path(__file__).parents[3]}")

    yield installed
    sys.modules.pop("motioncapture", None)


def watched(seconds, until, deadline=0.3):
    """Frames and words of a source, until so many words were said; how late the loop was at worst meanwhile."""

    async def main(clock):
        taken, said = [], []
        source = SystemSource(
            clock, "vicon", "10.0.0.5", {"gain": 2}, deadline, said.append
        )
        running, worst = (
            asyncio.create_task(source.run(lambda *frame: taken.append(frame))),
            0.0,
        )
        ends = clock.now() + seconds
        while len(said) < until and clock.now() < ends:
            began = clock.now()
            await clock.sleep(0.01)
            worst = max(worst, clock.now() - began - 0.01)
        running.cancel()
        await asyncio.wait([running])
        return taken, said, worst

    return run_wall(main)


@pytest.mark.real_time
def test_a_connect_that_hangs_blocks_nothing_and_is_named(library):
    library(HANGS)
    taken, said, worst = watched(15.0, until=1)
    assert not taken
    assert said == [
        "vicon at 10.0.0.5: no connection within 0.3 s; its library waits for ever if no server answers. Is Vicon "
        "Tracker or Nexus, with its DataStream, running there? Trying again in 1 s."
    ]
    assert worst < 0.5, "it would hang for ever"


def test_what_the_library_says_is_passed_on(library):
    library(FAILS)
    _, said, _ = watched(15.0, until=1)
    assert said[0].startswith(
        "vicon at 10.0.0.5: RuntimeError: vicon: no {'hostname': '10.0.0.5', 'gain': '2'}."
    )


def test_frames_come_with_their_age_and_cameras_that_hang_later_are_named(
    library, monkeypatch
):
    monkeypatch.setattr("crazychoir.mocap.system.FRAME_TIMEOUT", 0.3)
    library(SEES)
    taken, said, _ = watched(15.0, until=1, deadline=5.0)
    assert [frame.number for frame, _ in taken] == list(range(20))
    assert [float(frame.bodies["cf0"][0]) for frame, _ in taken] == list(range(1, 21))
    assert list(taken[0][0].bodies["cf0"]) == [1.0, 2.0, 3.0, 0.0, 0.0, 0.6, 0.8]
    assert 40 * "x" in taken[0][0].bodies, "as much of a name as a frame takes"
    assert all(0.0 <= age < 1.0 for _, age in taken)
    assert said[0].startswith("vicon at 10.0.0.5: connected, and no frame for 0.3 s.")


def test_a_library_that_connects_to_nothing_does_not_count_as_connected(
    library, monkeypatch
):
    monkeypatch.setattr("crazychoir.mocap.system.FRAME_TIMEOUT", 0.3)
    library(SEES.replace("> 20", "> 0"))
    taken, said, _ = watched(15.0, until=1, deadline=5.0)
    assert not taken
    assert said[0].startswith(
        "vicon at 10.0.0.5: no frame within 0.3 s: nothing answers, or it sends nothing."
    )


def test_without_the_library_it_is_said_what_to_install(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        ConfigError,
        match=r"no module motioncapture; .*pip install 'crazychoir\[mocap\]'",
    ):
        SystemSource(None, "vicon", "10.0.0.5")
