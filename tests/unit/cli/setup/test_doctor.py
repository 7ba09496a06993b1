"""What `crazychoir doctor` says of a host: each planted fault is named, with how to correct it."""

import datetime
import json
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from crazychoir.bus.network import authority
from crazychoir.cli.setup import doctor, host_checks, host_facts
from crazychoir.cli.setup.host_checks import UsbDevice, is_wrong
from crazychoir.config.addresses import PROCESS_NUMBERS
from crazychoir.config.swarm_config import find_swarm

SWARM = """
name = "lab"
mission = "{mission}"
base_port = {port}
[hosts]
here = "127.0.0.1"
far = "{far}"
[security]
operators = ["here"]
insecure = false
[[drones]]
id = 0
host = "here"
home = [0, 0, 0]
[[drones]]
id = 1
host = "far"
home = [1, 0, 0]
"""


@pytest.fixture
def taken():
    """Yield a port on which another program listens."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        yield other.getsockname()[1]


@pytest.fixture
def free():
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        return other.getsockname()[1]


def lab(
    folder, port, mission="operator", far="127.0.0.1", expired=False, monkeypatch=None
):
    """A swarm file of two hosts with keys."""
    real = authority.date_and_time
    if expired:
        monkeypatch.setattr(
            authority, "date_and_time", lambda: real() - datetime.timedelta(days=40)
        )
    authority.make_authority(folder / "keys", days=400)
    for name in ("here", "far"):
        authority.add_host(folder / "keys", name, days=20 if expired else 300)
    if expired:
        monkeypatch.setattr(authority, "date_and_time", real)
    file = folder / "lab.toml"
    file.write_text(SWARM.format(port=port, mission=mission, far=far))
    return str(file)


def rows_of(swarm, host=None):
    return {row.what: row for row in doctor.check_swarm(swarm, host)}


def test_a_good_host_is_content(tmp_path, free):
    rows = rows_of(lab(tmp_path, free))
    assert not is_wrong(rows.values()), rows
    assert rows["own host"].found == "here 127.0.0.1, far 127.0.0.1"
    assert rows["keys of here"].state == "ok"
    assert rows["ports"].found.endswith("free")


def test_a_taken_port_is_named_with_the_process_that_has_it(tmp_path, taken):
    row = rows_of(lab(tmp_path, taken))[f"port {taken}"]
    assert row.state == "wrong"
    assert "drone 0" in row.found
    assert "pytest" in row.found or "python" in row.found
    assert "base_port" in row.mend


@pytest.mark.parametrize(
    "by",
    ["python -m crazychoir.cli.fly.agent", "/v/python3 /v/crazychoir-agent --id 0"],
)
def test_a_port_of_our_own_agents_is_good(by):
    (row,) = host_checks.check_ports({7460: "drone 0"}, {7460: f"process 7: {by}"})
    assert row.state == "ok"
    assert by in row.found


@pytest.mark.parametrize(
    "by",
    ["python -m http.server --directory /me/crazychoir", "/me/crazychoir/own 7460"],
)
def test_a_port_of_another_program_is_not_ours_whatever_its_folder_is_called(by):
    (row,) = host_checks.check_ports({7460: "drone 0"}, {7460: f"process 7: {by}"})
    assert row.state == "wrong"


def test_only_the_router_of_a_swarm_must_be_reached(tmp_path, free, monkeypatch):
    """Its other processes listen nowhere."""
    asked = []
    monkeypatch.setattr(
        host_facts, "connect_to_host", lambda *where: asked.append(where) or "refused"
    )
    monkeypatch.setattr(host_facts, "is_own", lambda address: address == "127.0.0.1")
    file = tmp_path / "lab.toml"
    text = SWARM.format(port=7460, mission="goto", far="192.0.2.7").replace(
        "[hosts]", '[hosts]\nr = "192.0.2.9"'
    )
    file.write_text(text.replace("[hosts]", 'router = "r"\n[hosts]'))
    rows = rows_of(str(file))
    assert asked == [("192.0.2.9", 7460 - 19)]
    assert "host far" not in rows
    assert rows["ports"].state == "not here"
    assert "1 process" in rows["memory"].found


def test_a_name_that_means_the_loopback_here_is_named(tmp_path, free, monkeypatch):
    there = [(2, 1, 6, "", ("127.0.1.1", 0))]
    monkeypatch.setattr(host_facts.socket, "getaddrinfo", lambda *a, **k: there)
    row = rows_of(lab(tmp_path, free, far="lab-7"), host="far")["own host"]
    assert row.state == "wrong"
    assert "far is lab-7, which is 127.0.1.1 on this machine" in row.found


def test_an_expired_key_is_named(tmp_path, free, monkeypatch):
    row = rows_of(lab(tmp_path, free, expired=True, monkeypatch=monkeypatch))[
        "keys of here"
    ]
    assert row.state == "wrong"
    assert "good from" in row.found
    assert "keys add here" in row.mend


def test_a_key_that_others_may_read_is_named(tmp_path, free):
    swarm = lab(tmp_path, free)
    (tmp_path / "keys/here/key.pem").chmod(0o644)
    assert rows_of(swarm)["keys of here"].mend.startswith("chmod 600")


def test_a_key_that_ends_soon_is_a_warning():
    assert host_checks.check_host_keys("here", "", "", 29.0).state == "warning"


def test_an_address_of_another_machine_is_named(tmp_path, free, monkeypatch):
    monkeypatch.setattr(host_facts, "OTHER_HOST_TIMEOUT", 0.05)
    monkeypatch.setattr(
        host_facts, "connect_to_host", lambda address, port: "no answer within 1 s"
    )
    rows = rows_of(lab(tmp_path, free, far="192.0.2.7"), host="far")
    assert rows["own host"].state == "wrong"
    assert "far is 192.0.2.7: no address of this machine" in rows["own host"].found
    assert rows["host far"].state == "wrong"


def test_a_governor_that_saves_power_is_named(tmp_path):
    for cpu in ("cpu0", "cpu1"):
        folder = tmp_path / "devices/system/cpu" / cpu / "cpufreq"
        folder.mkdir(parents=True)
        (folder / "scaling_governor").write_text(
            "powersave\n" if cpu == "cpu1" else "performance\n"
        )
    (row,) = (
        row for row in doctor.check_machine(tmp_path) if row.what == "cpu governor"
    )
    assert (row.state, row.mend) == (
        "warning",
        "sudo cpupower frequency-set -g performance",
    )
    assert "powersave on cpu1" in row.found


def test_a_mission_that_is_not_there_is_named(tmp_path, free):
    row = rows_of(lab(tmp_path, free, mission="nowhere.py"))["mission"]
    assert row.state == "wrong"
    assert "crazychoir push" in row.mend
    assert "nowhere.py" in row.found


def test_a_mission_that_cannot_be_flown_is_named_with_the_reason(tmp_path, free):
    row = rows_of(lab(tmp_path, free, mission="goto"))["mission"]
    assert row.state == "wrong"
    assert "drones: found 2; allowed: 4, or mission_options.goals" in row.found


def test_a_mission_file_with_a_fault_is_to_be_corrected(tmp_path, free):
    (tmp_path / "own.py").write_text("def guidance(")
    row = rows_of(lab(tmp_path, free, mission=str(tmp_path / "own.py")))["mission"]
    assert row.state == "wrong"
    assert row.mend == "Correct it as the text says."


def test_what_a_run_would_warn_of_is_a_warning_too(tmp_path):
    file = Path(__file__).parents[4] / "deploy/original_letter.toml"
    (row,) = (r for r in doctor.check_swarm(str(file), None) if r.what == "flight")
    assert row.state == "warning"
    assert "the formation will not be the shape" in row.found


def test_a_swarm_file_that_is_not_there_is_named(tmp_path):
    row = rows_of(str(tmp_path / "none.toml"))["swarm file"]
    assert row.state == "wrong"
    assert "none.toml" in row.found


def test_packages_and_python_that_are_too_old_are_named():
    rows = host_checks.check_packages(
        [
            "eclipse-zenoh>=1.10",
            "cflib>=0.1.32",
            "numpy>=2.4",
            'av>=16.0; extra == "test"',
        ],
        {"eclipse-zenoh": "1.9.0", "numpy": "2.10.1"},
    )
    assert [row.what for row in rows] == ["package eclipse-zenoh", "package cflib"]
    assert all(row.state == "wrong" for row in rows)
    assert rows[0].mend == "pip install 'eclipse-zenoh>=1.10'"
    assert (
        host_checks.check_python((3, 10, 2)).state
        == host_checks.check_python((3, 15, 0)).state
        == "wrong"
    )
    assert host_checks.check_python((3, 14, 9)).state == "ok"


def test_radios_are_those_of_the_usb_with_their_rights(tmp_path):
    for n, kind in enumerate(("1915:7777", "8087:0024")):
        folder = tmp_path / "sys/bus/usb/devices" / f"1-{n}"
        folder.mkdir(parents=True)
        for name, text in zip(
            ("idVendor", "idProduct", "busnum", "devnum"),
            (*kind.split(":"), "1", n),
            strict=True,
        ):
            (folder / name).write_text(f"{text}\n")
    (found,) = host_facts.crazyradios(tmp_path / "sys", tmp_path / "dev")
    assert (found.kind, found.path, found.writable) == (
        "1915:7777",
        str(tmp_path / "dev/001/000"),
        False,
    )
    rows = host_checks.check_crazyradios([found], [1])
    assert [row.state for row in rows] == ["wrong", "wrong"]
    assert "udevadm" in rows[0].mend
    assert "dongle 1" in rows[1].found
    assert (
        host_checks.check_crazyradios([UsbDevice("1915:7777", "/dev/x", True)], [0])[
            0
        ].state
        == "ok"
    )
    assert host_checks.check_crazyradios([], [])[0].state == "not here"
    rows = host_checks.check_crazyradios(
        [UsbDevice(host_checks.BOOTLOADER_ID, "/dev/x", True)], [0]
    )
    assert [row.state for row in rows] == ["wrong", "wrong"], (
        "one in its bootloader does not fly"
    )


def test_little_memory_and_a_late_timer_are_warnings():
    assert (
        host_checks.check_memory(500.0, 6).state
        == host_checks.check_wake_ups(9.0).state
        == "warning"
    )
    assert host_checks.check_open_files(256).state == "warning"
    assert (
        host_checks.check_synchronisation(False, 1.0).state
        == host_checks.check_disk(10.0, "/x").state
        == "warning"
    )
    assert host_checks.check_synchronisation(None, 0.0).state == "not here"


def test_other_hosts_are_asked_within_a_deadline(taken, free):
    assert host_facts.connect_to_host("127.0.0.1", taken) == "connected"
    assert host_facts.connect_to_host("127.0.0.1", free) == "refused"
    assert (
        host_checks.check_other_host("b", "10.0.0.9", "No route to host").state
        == "wrong"
    )
    stranger = host_checks.check_other_host(
        "b", "10.0.0.9", "connected", "its certificate is not valid here: expired"
    )
    assert (stranger.state, stranger.found) == (
        "wrong",
        "10.0.0.9 answers, and its certificate is not valid here: expired",
    )


def test_its_exit_code_says_that_something_is_wrong(tmp_path):
    command = (
        sys.executable,
        "-m",
        "crazychoir.cli.main",
        "doctor",
        "--json",
        "--swarm",
        tmp_path / "no.toml",
    )
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "no.toml" in json.loads(done.stdout)["rows"][-1]["found"]


@pytest.mark.parametrize(
    ("process", "name"),
    [
        (3, "drone 3"),
        (PROCESS_NUMBERS.world, "the world's owner"),
        (PROCESS_NUMBERS.motion_capture, "motion capture"),
        (PROCESS_NUMBERS.router, "the router"),
        (PROCESS_NUMBERS.first_dongle - 2, "dongle 2"),
    ],
)
def test_each_process_has_a_name(process, name):
    assert doctor.describe_process(process) == name


CAMERAS = """
name = "lab"
mission = "operator"
[mocap]
source = "{source}"
hostname = "127.0.0.1:{port}"
[[drones]]
id = 0
home = [0, 0, 0]
uri = "radio://0/80/2M/E7E7E7E700"
"""


def cameras(folder, source, port):
    """Return the checks of a swarm with cameras of this source at this port, by their names."""
    file = folder / "lab.toml"
    file.write_text(CAMERAS.format(source=source, port=port))
    config = find_swarm(str(file))[0]
    return {row.what: row for row in doctor.check_cameras(config, [])}


def test_cameras_that_answer_are_well(tmp_path, taken):
    rows = cameras(tmp_path, "vicon", taken)
    assert rows["cameras"].state == "ok"
    assert f"vicon at 127.0.0.1 answers at port {taken}" in rows["cameras"].found


def test_cameras_that_do_not_answer_are_named_with_their_program(tmp_path, free):
    cause = cameras(tmp_path, "vicon", free)["cameras"]
    assert cause.state == "wrong"
    assert f"nothing listens at port {free}" in cause.found
    assert "Is Vicon Tracker or Nexus" in cause.mend


@pytest.mark.parametrize("port", ["", 1510])
def test_cameras_that_cannot_be_asked_are_said_not_to_be_checked(tmp_path, port):
    cause = cameras(tmp_path, "optitrack", port)["cameras"]
    assert cause.state == "warning"
    assert "not checked" in cause.found


def test_a_missing_library_of_cameras_is_named(tmp_path, taken, monkeypatch):
    monkeypatch.setattr("crazychoir.mocap.system.has_library", lambda: False)
    cause = cameras(tmp_path, "vicon", taken)["package motioncapture"]
    assert (cause.state, cause.mend) == ("wrong", "pip install 'crazychoir[mocap]'")


def test_a_host_without_cameras_says_so(tmp_path, free, taken):
    here = find_swarm(lab(tmp_path, free))[0]
    (cause,) = doctor.check_cameras(here, ["here"])
    assert (cause.state, cause.found) == ("not here", "no drone is seen by cameras")
    virtual = cameras(tmp_path, "virtual", taken)["cameras"]
    assert virtual.state == "not here"
