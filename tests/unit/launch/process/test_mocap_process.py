import io
from types import SimpleNamespace

import numpy as np
from rich.console import Console

from crazychoir.launch.process.mocap_process import build_mocap_table
from crazychoir.mocap.frames import PoseFrame
from crazychoir.mocap.watch import TrackingWatch


def shown(now):
    watch = TrackingWatch({0: "cf0", 1: "cf1", 2: "cf2"}, 100.0, live=True)
    for k in range(300):
        moving, still = (
            np.array([0.001 * k, 2.0, 0.5, 0, 0, 0, 1.0]),
            np.array([0, 0, 0, 0, 0, 0, 1.0]),
        )
        watch.note(
            PoseFrame(
                k,
                k / 100,
                {"wand": still} | ({"cf0": moving} if k % 2 else {}) | {"cf1": moving},
            ),
            k / 100,
        )
        if k % 25 == 0:
            watch.look(k / 100)
    source = SimpleNamespace(where="vicon at 10.0.0.5", state="connected")
    process = SimpleNamespace(
        watch=watch, clock=SimpleNamespace(now=lambda: now), source=source
    )
    text = io.StringIO()
    Console(file=text, width=100).print(build_mocap_table(process))
    return [line.split() for line in text.getvalue().splitlines() if line.strip()]


def test_each_body_has_a_row_with_its_drone_rate_and_place():
    title, heads, _, *rows = shown(2.99)
    assert " ".join(title) == "vicon at 10.0.0.5: connected, 100 Hz"
    assert heads == ["body", "drone", "Hz", "age", "s", "x", "y", "z", "dropped"]
    assert rows == [
        ["cf0", "0", "50", "0.00", "0.299", "2.000", "0.500", "149"],
        ["cf1", "1", "100", "0.00", "0.299", "2.000", "0.500", "0"],
        ["cf2", "2", "never", "seen"],
        ["wand", "-", "0", "3.0", "0.000", "0.000", "0.000", "0"],
    ]
