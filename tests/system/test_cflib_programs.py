"""cflib's own programs, as its documentation shows them, against virtual Crazyflies: they see what they would see."""

import json
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from pages import block

pytestmark = [pytest.mark.system, pytest.mark.real_time]
HERE = Path(__file__).parent
PROGRAMS = (
    "high_level",
    "motion_commander",
    "position_commander",
    "trajectory",
    "compressed_trajectory",
    "set_points",
    "supervisor",
    "emergency_stop",
    "emergency_stop_watchdog",
    "poses_from_outside",
    "restart_by_a_wrong_packet",
    "nobody_there",
    "connect_with_callbacks",
    "log_synchronously",
    "log_by_callback",
    "log_too_much",
    "parameters",
    "persistent_parameters",
    "console",
    "memories",
    "lighthouse",
    "statistics",
    "multiranger",
    "three",
)
DRONES = 19


def _free_ports() -> int:
    """The first of as many free ports in a row, one below it for the poses."""
    for first in range(20_200, 60_000, 50):
        doors = [
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(DRONES + 1)
        ]
        try:
            for k, door in enumerate(doors):
                door.bind(("127.0.0.1", first - 1 + k))
            return first
        except OSError:
            continue
        finally:
            for door in doors:
                door.close()
    raise AssertionError("no free ports")


def _program_of_page(port: int) -> str:
    """Return the program that the page of radio/ shows, for the drone at this port.

    It ends only after a flight.
    """
    program = block("crazychoir/radio/README.md", "virtual_flight.py")
    assert "cflib" in program
    assert len(program.splitlines()) <= 10
    return program.replace("19850", str(port))


@pytest.fixture(scope="module")
def ran():
    """What each program has ended with, and the server; all fly at once, each its own drone."""
    port = _free_ports()
    command = [
        sys.executable,
        "-m",
        "crazychoir.cli.main",
        "virtual",
        "--drones",
        str(DRONES),
        "--deck",
        "bcFlow2,bcLighthouse4,bcMultiranger,bcLedRing",
        "--json",
    ]
    server = subprocess.Popen(
        [*command, "--port", str(port)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        while "poses at" not in (line := server.stderr.readline()):
            assert line, "the server has ended"
        run = [sys.executable, "-m", "cflib_programs.run", str(port)]
        shown = subprocess.Popen(
            [sys.executable, "-c", _program_of_page(port + DRONES - 1)],
            stdout=subprocess.DEVNULL,
        )
        found = subprocess.run(
            run, cwd=HERE, capture_output=True, text=True, timeout=150, check=False
        )
        assert found.stdout, found.stderr
        assert shown.wait(30) == 0
        server.send_signal(signal.SIGINT)
        said, _ = server.communicate(timeout=20)
    finally:
        server.kill()
    return json.loads(found.stdout), json.loads(said), server.returncode


@pytest.mark.timeout(240)
@pytest.mark.parametrize("program", PROGRAMS)
def test_a_program_of_cflib_ends_well(ran, program):
    results, _, _ = ran
    assert results[program] == ""


def test_no_program_is_left_out(ran):
    results, _, _ = ran
    assert set(results) == set(PROGRAMS)


def test_the_server_ends_by_ctrl_c_with_what_became_of_the_drones(ran):
    _, report, code = ran
    assert (code, report["success"]) == (0, True)
    restarted = [i for i, drone in report["drones"].items() if drone["starts"] > 1]
    assert restarted == ["10"]  # this drone got a packet that was too short
    assert report["drones"]["10"]["malformed"] == 1
    assert (
        report["drones"][str(DRONES - 1)]["last"] == "rpyt"
    )  # the page's program has flown, and has closed its link
    assert (
        sum(drone["unknown"] for drone in report["drones"].values()) == 1
    )  # to an application that is not there
