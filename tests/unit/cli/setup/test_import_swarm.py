"""A swarm of Crazyswarm2, imported as a swarm file."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.cli.setup.crazyswarm_swarm import SourceFiles, import_swarm
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission import load_mission

FOLDER = Path(__file__).parents[3] / "data" / "crazyswarm2"
FILES = SourceFiles(
    FOLDER / "crazyflies.yaml",
    FOLDER / "motion_capture.yaml",
    FOLDER / "server.yaml",
)
ROBOTS = """
robots:
  cf1: {enabled: true, uri: "radio://0/80/2M/E7E7E7E701", initial_position: [0, 0, 0], type: a}
  cf2: {enabled: true, uri: "radio://0/80/2M/E7E7E7E702", initial_position: [1, 0, 0], type: a}
robot_types:
  a: {motion_capture: {tracking: vendor}}
"""


def imported(**changes):
    swarm = import_swarm(FILES, "lab", **({"is_virtual": False} | changes))
    return SwarmConfig.loads(swarm.format(FILES), "lab.toml"), swarm


def import_text(tmp_path, text):
    (tmp_path / "crazyflies.yaml").write_text(text)
    return import_swarm(SourceFiles(tmp_path / "crazyflies.yaml"), "lab", False)


def test_robots_become_drones_with_their_numbers_names_and_places():
    config, _ = imported()
    assert config.ids == (5, 231)
    assert config.left_out == (14,)
    assert config.drone(5).uri == "radio://0/80/2M/E7E7E7E705"
    assert config.drone(5).home == (0.0, -0.5, 0.0)
    assert config.body_name(231) == "cf231"
    assert config.drone(231).battery_warning == 3.8


def test_parameters_of_a_robot_count_before_its_type_and_all():
    config, _ = imported()
    assert config.drone(231).parameters == {
        "locSrv.extPosStdDev": 0.001,
        "locSrv.extQuatStdDev": 0.05,
    }
    assert config.drone(5).parameters["kalman.pNAcc_xy"] == 1.0
    assert config.drone(5).parameters["ring.effect"] == 16


def test_topics_become_log_variables_of_the_drones_that_have_them():
    config, _ = imported()
    battery, acceleration = config.logs
    assert battery.variables == ("pm.vbat",)
    assert battery.drones is None
    assert acceleration.drones == (5,)
    assert acceleration.rate == 33.3333


def test_cameras_keep_their_type_and_address():
    config, _ = imported()
    assert config.mocap.source == "optitrack"
    assert config.mocap.hostname == "192.168.2.15"
    assert config.mocap.options == {"port_command": "1510"}


@pytest.mark.parametrize(
    "line",
    [
        "crazyflies.yaml: all.broadcasts.num_repeats = 15: no broadcasts",
        'crazyflies.yaml: robots.cf14.reference_frame = "lab": no equivalent',
        'crazyflies.yaml: robots.wand = "tracked": no drone',
        "crazyflies.yaml: all.firmware_params.oldGroup.oldName = 3: not a parameter",
        "crazyflies.yaml: all.firmware_params.stabilizer.controller = 2: set a sender",
        "crazyflies.yaml: custom_topics.acceleration.frequency = 30: 33.3333 Hz",
        "motion_capture.yaml: /motion_capture_tracking.ros__parameters.topics",
        'server.yaml: /crazyflie_server.ros__parameters.sim.backend = "np"',
    ],
)
def test_what_has_no_equivalent_is_listed_with_file_and_key(line):
    _, swarm = imported()
    assert any(one.startswith(line) for one in swarm.remarks.lines)


def test_keys_that_the_format_does_not_have_are_listed_in_each_table(tmp_path):
    motion = "{motion_capture: {tracking: vendor}}"
    more = """\
{connection: udp, motion_capture: {tracking: vendor, color: red}, battery: {voltage_low: 3.0},
 firmware_logging: {topics: 1}}"""
    lines = import_text(tmp_path, ROBOTS.replace(motion, more)).remarks.lines
    for path in (
        'connection = "udp"',
        'motion_capture.color = "red"',
        "battery.voltage_low = 3.0",
        "firmware_logging.topics = 1",
    ):
        where = f"crazyflies.yaml: robot_types.a.{path}: "
        assert any(line.startswith(where) for line in lines), path


def test_a_swarm_to_try_has_virtual_drones_and_no_decks():
    config, swarm = imported(is_virtual=True)
    assert config.drone(231).uri == "udp://127.0.0.1:19850"
    assert config.drone(5).uri == "udp://127.0.0.1:19851"
    assert config.mocap.source == "virtual"
    assert "ring.effect" not in config.drone(5).parameters
    assert any("ring.effect = 16: virtual drones" in x for x in swarm.remarks.lines)


def test_drones_that_no_camera_sees_send_their_own_poses_often_enough(tmp_path):
    swarm = import_text(
        tmp_path, ROBOTS.replace("{tracking: vendor}", "{enabled: false}")
    )
    config = SwarmConfig.loads(swarm.format(FILES), "lab.toml")
    assert config.drone(1).pose == "onboard"
    assert config.radio.log_rate == 25.0
    assert imported()[1].radio == {}


def test_many_drones_of_a_dongle_are_sent_places(tmp_path):
    rows = "".join(
        f"  cf{k}: {{uri: 'radio://0/80/2M/E7E7E7E70{k}', initial_position: [{k}, 0, 0], type: a}}\n"
        for k in range(4)
    )
    text = (
        f"robots:\n{rows}robot_types:\n  a: {{motion_capture: {{tracking: vendor}}}}\n"
    )
    assert import_text(tmp_path, text).control == {"sender": "xyz"}
    assert import_text(tmp_path, ROBOTS).control == {}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("robots:", "drones:", "crazyflies.yaml: robots: found nothing"),
        ("type: a}", "type: b}", r"robots.cf1.type: found \"b\"; allowed: one of rob"),
        ("[0, 0, 0]", "[0, 0]", r"robots.cf1.initial_position: found \[0, 0\]"),
        ("[0, 0, 0]", "[0, 0, up]", r'initial_position: found "up"; allowed: a number'),
        ("robot_types:", "robot_types: {{", r"crazyflies.yaml, line \d+: found"),
    ],
)
def test_files_of_another_structure_are_refused_with_file_and_key(
    tmp_path, old, new, words
):
    with pytest.raises(ConfigError, match=words):
        import_text(tmp_path, ROBOTS.replace(old, new))


def test_the_command_writes_the_file_and_says_what_remains_to_do(tmp_path):
    out = tmp_path / "lab.toml"
    told = CliRunner().invoke(app, ["import", str(FILES.robots), "-o", str(out)])
    assert told.exit_code == 0
    assert "3 drones, 2 of them enabled" in told.output
    written = SwarmConfig.load(out)
    assert (written.name, written.mission) == ("lab", "operator")
    load_mission("operator").check(written)
    same = tmp_path / "crazyflies.yaml"
    same.write_text(ROBOTS.replace("[1, 0, 0]", "[0, 0, 0]"))
    told = CliRunner().invoke(app, ["import", str(same), "-o", str(out)])
    assert told.exit_code == 1
    assert "home" in told.output
