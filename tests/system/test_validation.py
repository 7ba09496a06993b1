"""A recording of a simulated flight is predicted by the simulator; what a recording lacks is said."""

import pytest

pytestmark = pytest.mark.system
MISSION = '''
"""Fly to and fro; with options.logs record what a comparison needs."""
from crazychoir import CFGuidance

PLACES = [(0.8, 0.0, 1.3), (-0.8, 0.5, 0.8), (0.6, -0.7, 1.2)]

class Seen(CFGuidance):
    def __init__(self, logs):
        super().__init__()
        self.logs = logs

    async def mission(self):
        if self.logs:
            motors = [f"motor.m{n}" for n in (1, 2, 3, 4)]
            self.log(*motors[:self.logs], *(f"gyro.{c}" for c in "xyz"), "pm.vbat", period=0.01)
        await self.take_off()
        for place in PLACES:
            await self.go_to(place)
        await self.land()

def guidance(i, config):
    return Seen(config.mission_options["logs"])
'''
SWARM = """name = "seen"
mission_options = {{ logs = {logs} }}
motors = {{ imperfections = 0.0 }}

[[drones]]
id = 3
home = [0.0, 0.0, 0.0]
uri = "sim://motors"
platform = "cf21"
"""


@pytest.fixture
def record(here, tmp_path):
    def fly(logs):
        mission = tmp_path / "seen.py"
        mission.write_text(MISSION)
        swarm = tmp_path / "swarm.toml"
        swarm.write_text(SWARM.format(logs=logs))
        path = tmp_path / f"logs{logs}.mcap"
        words = ("run", mission, "--swarm", swarm, "--fast", "--record", path)
        flown = here("crazychoir", *words)
        assert flown.code == 0, flown.err
        return path

    return fly


def test_the_simulator_predicts_a_recording_of_its_own(here, record):
    path = record(logs=4)
    said = here("crazychoir", "validate", path, "--json")
    assert said.code == 0, said.err
    models = said.json["models"]
    late = {name: times["0.5"]["rmse"]["position_mm"] for name, times in models.items()}
    assert late["simulator as it is"] < 0.3 * late["velocity and rates stay"]
    assert said.json["closed_loop"] == []
    (flight,) = said.json["flights"].values()
    assert any("no closed loop" in note for note in flight["notes"])
    filters = here("crazychoir", "validate", path, "--filters", "--json")
    assert filters.json["flights"] == ["logs4"]


@pytest.mark.parametrize(
    ("logs", "reasons"),
    [
        (0, ["no log variables of", "self.log('gyro.x'", "period=0.01"]),
        (3, ["no duty", "motor.m1 to motor.m4"]),
    ],
)
def test_a_recording_without_motors_is_refused_with_what_to_record(
    here, record, logs, reasons
):
    said = here("crazychoir", "validate", record(logs))
    said.refuses(*reasons)
