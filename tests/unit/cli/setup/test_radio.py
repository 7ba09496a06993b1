"""crazychoir radio: what it measures on a simulated radio, writes and says."""

import contextlib
import json

import pytest
from typer.testing import CliRunner

from crazychoir.cli.setup import radio, radio_maintenance
from crazychoir.cli.setup.radio_tables import progress_table
from crazychoir.radio.survey.ping import PingResult
from crazychoir.radio.survey.simulated_radio import SimulatedRadio, random_room
from crazychoir.radio.survey.survey import Survey, Visit, run_survey

SWARM = """\
name = "lab"
[[drones]]
id = 0
home = [0, 0, 0]
uri = "radio://1/80/2M/E7E7E7E701"   # the left dongle
[[drones]]
id = 1
home = [1, 0, 0]
uri = "radio://0/80/2M/E7E7E7E702"
[[drones]]
id = 2
home = [2, 0, 0]
uri = "radio://1/80/2M/E7E7E7E703"
"""
BRIEF = ["--passes", "3", "--packets", "20", "--channels", "0-80:8"]
FEW = ["--simulated", "3", *BRIEF]


def said(*words):
    return CliRunner().invoke(radio.app, [str(word) for word in words])


@pytest.fixture
def swarm(tmp_path):
    file = tmp_path / "lab.toml"
    file.write_text(SWARM)
    return file


@pytest.fixture
def dongle(monkeypatch):
    """Replace the dongle by a simulated radio."""
    room = random_room(3, range(0, 81, 8))
    open_probe = contextlib.nullcontext(SimulatedRadio(room, 3))
    monkeypatch.setattr(
        "crazychoir.radio.survey.survey_radio.open_probe", lambda uri, now: open_probe
    )


def test_the_survey_says_what_it_has_measured():
    done = said("survey", *FEW, "--dongles", 2, "--json")
    assert done.exit_code == 0
    result = json.loads(done.stdout)
    rows = {row["channel"]: row for row in result["channels"]}
    assert list(rows) == list(range(0, 81, 8))
    assert result["success"]
    assert len(result["chosen"]) == 2
    assert [c for c, row in rows.items() if row["chosen"]] == result["chosen"]
    assert result["worst_ack_rate"] == min(
        rows[c]["worst_pass"] for c in result["chosen"]
    )
    for row in rows.values():
        assert len(row["passes"]) == 3
        assert sum(row["retries"]) + row["lost_with_retries"] == 60
        assert 0.0 <= row["expected_ack_rate"] <= 1.0


def test_the_table_marks_what_is_picked(tmp_path):
    done = said("survey", *FEW, "--picture", tmp_path / "out.png")
    assert done.exit_code == 0
    assert done.stdout.count("◀") == 1
    assert "Picked: " in done.stdout
    assert (tmp_path / "out.png").read_bytes()[:4] == b"\x89PNG"


def test_the_channels_of_a_swarm_file_are_written(swarm, dongle):
    result = json.loads(
        said("survey", *BRIEF, "--swarm", swarm, "--write", "--json").stdout
    )
    low, high = result["chosen"]
    assert result["dongles"] == {"1": low, "0": high}
    assert result["written"] == str(swarm)
    expected = SWARM.replace("//1/80/", f"//1/{low}/").replace(
        "//0/80/", f"//0/{high}/"
    )
    assert swarm.read_text() == expected != SWARM


def test_without_write_the_file_stays(swarm):
    done = said("survey", *FEW, "--swarm", swarm)
    assert "Not written (see --write): dongle 1: " in done.stdout
    assert swarm.read_text() == SWARM


def test_channels_where_nothing_comes_through_are_not_written(
    swarm, dongle, monkeypatch
):
    monkeypatch.setattr(
        "crazychoir.radio.survey.simulated_radio.reception_probability",
        lambda sinr: 0.0 * sinr,
    )
    done = said("survey", *BRIEF, "--swarm", swarm, "--write", "--json")
    assert done.exit_code == 1
    assert json.loads(done.stdout)["written"] is None
    assert swarm.read_text() == SWARM


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--write"], "--swarm"),
        (["--swarm", "SWARM", "--write"], "--write: found --simulated beside it"),
        (
            ["--swarm", "SWARM", "--write", "--dongles", "3", "REAL"],
            "that is how many the file has",
        ),
        (["--dongles", "12"], "room for 11"),
        (["--drone", "radio://0/80"], "no real drone hears a simulated radio"),
        (["--channels", "9-3"], "channels 0 to 125"),
        (["--swarm", "absent.toml"], "No such file"),
        (["--swarm", "BROKEN"], "drones[0].home"),
        (["--swarm", "ODD", "--write", "REAL"], "Write the channels yourself"),
        (["--picture", "a.gif"], ".png"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_is_measured(
    swarm, words, says, monkeypatch
):
    monkeypatch.setattr(Survey, "visits", None)
    broken = swarm.with_name("broken.toml")
    broken.write_text(SWARM.replace("home = [0, 0, 0]", ""))
    odd = swarm.with_name("odd.toml")
    odd.write_text(SWARM.replace('"radio://0/80', '"radio:\\u002f/0/80'))
    files = {"SWARM": swarm, "BROKEN": broken, "ODD": odd}
    few = BRIEF if "REAL" in words else FEW
    done = said(
        "survey",
        *few,
        *(files.get(word, word) for word in words if word != "REAL"),
        "--json",
    )
    assert done.exit_code == 2
    assert says in json.loads(done.stdout)["error"]


def test_without_hardware_it_says_what_to_plug_in(monkeypatch):
    monkeypatch.setattr(
        "cflib.drivers.crazyradio._find_devices", lambda serial=None: []
    )
    done = said("survey")
    assert done.exit_code == 2
    assert "Plug a Crazyradio in" in done.stderr


def test_the_drone_that_answers_is_the_first_of_the_file(swarm, monkeypatch):
    opened = []
    monkeypatch.setattr(
        "crazychoir.radio.survey.survey_radio.open_probe",
        lambda uri, now: opened.append(uri) or 1 / 0,
    )
    said("survey", "--swarm", swarm)
    said("survey", "--swarm", swarm, "--drone", "radio://0/7")
    said("survey")
    assert opened == ["radio://1/80/2M/E7E7E7E701", "radio://0/7", radio.NEW_DRONE_URI]


def test_progress_shows_each_channel():
    from crazychoir.radio.survey.simulated_radio import SimulatedRadio, random_room

    found = Survey(range(0, 40, 4), passes=2, packets=5)
    run_survey(found, SimulatedRadio(random_room(1, range(40)), 1))
    head, bars, _ = progress_table((found, Visit(1, 12))).renderables
    assert head.plain == "pass 2 of 2, channel  12: 100%"
    assert len(bars.plain) == len("0 ") + 10 + len(" 36")


@pytest.mark.parametrize(
    ("lost", "error", "code"), [(0, "", 0), (1, "", 1), (0, "cut", 1)]
)
def test_ping_succeeds_if_nothing_is_lost(monkeypatch, lost, error, code):
    found = [PingResult("udp://a:1", 3 + lost, (0.001, 0.002, 0.003), error)]
    monkeypatch.setattr("crazychoir.radio.survey.ping.ping", lambda *arguments: found)
    done = said("ping", "udp://a:1", "--json")
    assert done.exit_code == code
    (link,) = json.loads(done.stdout)["links"]
    assert (link["sent"], link["lost"], link["p50_s"], link["error"]) == (
        3 + lost,
        lost,
        0.002,
        error,
    )
    table = said("ping", "udp://a:1").stdout
    assert "2.00 ms" in table
    assert ("udp://a:1: cut" in table) == bool(error)


def test_a_failure_of_several_drones_is_said_once_below_their_whole_uris(
    swarm, monkeypatch
):
    def ping(uris, *arguments):
        return [PingResult(uri, 0, (), "no dongle") for uri in uris]

    monkeypatch.setattr("crazychoir.radio.survey.ping.ping", ping)
    monkeypatch.setattr(
        radio_maintenance, "_owned_dongles", lambda *_: contextlib.nullcontext()
    )
    text = said("scan", "--swarm", swarm).stdout
    assert text.count("no dongle") == 1
    assert "drones 0 to 2: no dongle" in text
    assert all(
        f"radio://{end}" in text for end in ("1/80/2M/E7E7E7E701", "0/80/2M/E7E7E7E702")
    )


def test_ping_refuses_what_is_no_address():
    done = said("ping", "usb://0", "--json")
    assert done.exit_code == 2
    assert "udp://HOST:PORT" in json.loads(done.stdout)["error"]
