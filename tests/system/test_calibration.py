"""A drone that flies in the simulator with a calibration is found again from its recording."""

import pytest

from crazychoir.config.swarm_config import find_swarm

pytestmark = pytest.mark.system
MISSION = '''
"""Fly to and fro, up and down, and record what a calibration needs."""
from crazychoir import CFGuidance

PLACES = [(0.8, 0.0, 1.3), (-0.8, 0.5, 0.8), (0.6, -0.7, 1.4), (-0.5, -0.5, 0.7), (0.0, 0.8, 1.4), (0.0, 0.0, 0.8)]

class Exciting(CFGuidance):
    async def mission(self):
        motors = [f"motor.m{n}" for n in (1, 2, 3, 4)]
        inertial = [f"{name}.{c}" for name in ("gyro", "acc") for c in "xyz"]
        self.log(*motors, *inertial, "pm.vbat", period=0.01)
        await self.take_off()
        for place in PLACES * 3:
            await self.go_to(place)
        await self.land()

def guidance(i, config):
    return Exciting()
'''
SWARM = """name = "calibrated"

[[drones]]
id = 3
home = [0.0, 0.0, 0.0]
uri = "sim://motors"
platform = "cf21"
calibration = { thrust_factor = 0.9, rotor_lag = 0.05, drag = [0.011, 0.013, 0.0128], speed_moment = [0.0004, 0.0006] }
"""


def test_the_calibration_of_a_simulated_drone_is_found_in_its_recording(here, tmp_path):
    mission = tmp_path / "exciting.py"
    mission.write_text(MISSION)
    swarm = tmp_path / "swarm.toml"
    swarm.write_text(SWARM)
    true = find_swarm(str(swarm))[0].drone(3).calibration
    recording = tmp_path / "flight.mcap"
    flown = here(
        "crazychoir",
        "run",
        mission,
        "--swarm",
        swarm,
        "--fast",
        "--record",
        recording,
    )
    assert flown.code == 0, flown.err
    said = here(
        "crazychoir",
        "calibrate",
        recording,
        "--swarm",
        swarm,
        "--id",
        3,
        "--write",
        "--json",
    )
    assert said.code == 0, said.err
    assert said.json["written"]
    names = (
        "thrust_factor",
        "rotor_lag",
        "drag_x",
        "drag_y",
        "moment_roll",
        "moment_pitch",
    )
    values = (true.thrust_factor, true.rotor_lag, *true.drag[:2], *true.speed_moment)
    for name, value in zip(names, values, strict=True):
        one = said.json["parameters"][name]
        assert abs(one["found"] - value) < 3.0 * one["standard_error"], name
    found = find_swarm(str(swarm))[0].drone(3).calibration
    assert found.thrust_factor == pytest.approx(true.thrust_factor, abs=0.01)
    assert found.drag[:2] == pytest.approx(true.drag[:2], rel=0.15)
    assert found.speed_moment == pytest.approx(true.speed_moment, rel=0.2)
