"""Virtual Crazyflies, flown through cflib by agents, owners of dongles and a process of motion capture of their own."""

import asyncio
import json
import math
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from system.agents import RADIO, Program
from system.hall import Hall, processes, reached

from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.guidance.mission import load_mission

pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.timeout(240),
    pytest.mark.usefixtures("compiled"),
]
FIGURE = {
    "mission": "figure",
    "mission_options": {"size": 0.25, "laps": 1.0, "period": 8.0},
}
TILTS, STAYS = (
    "it does not tilt as its body does, but as",
    "its body does not rise as it takes off: another drone's",
)
"""Reasons of a drone with a wrong body. If two are exchanged, the second may see that the first has landed before."""
UP = 0.4
"""m, above which a drone flies."""


def figures(n: int, sender: str, **changes: Any) -> SwarmConfig:
    flight = {"takeoff_height": 0.6, "landing_speed": 0.4}
    return default_swarm(n).replace(
        **FIGURE, control={"sender": sender}, flight=flight, **changes
    )


async def flown(
    config: SwarmConfig, folder, seconds: float = 150.0, *options: str
) -> dict[str, Any]:
    """What a run of it said, whole."""
    async with Hall(config, folder, *options) as hall:
        run = await hall.fly()
        result = await run.end(seconds)
        assert result["success"], (result["reasons"], run.text, hall.programs[0].text)
        landed = hall.state()
        assert all(landed[i]["resting"] and not landed[i]["crashed"] for i in landed), (
            landed
        )
        assert all(said["malformed"] == 0 for said in landed.values()), (
            "a packet at which a firmware resets"
        )
        return result


async def in_the_air(hall: Hall, run: Program, *ids: int) -> None:
    await hall.until(lambda state: all(state[i]["p"][2] > UP for i in ids), 90.0)
    await asyncio.sleep(2.0)


@pytest.mark.slow
async def test_virtual_and_simulated_drones_fly_one_mission(tmp_path) -> None:
    config = reached(figures(2, "fpqr"), ids=(1,))
    result = await flown(config, tmp_path)
    assert sorted(map(int, result["results"])) == [0, 1]
    assert result["min_separation_m"] > 0.4


@pytest.mark.slow
async def test_absent_or_silent_drones_are_named_and_the_others_fly(tmp_path) -> None:
    some = figures(4, "xyz", graph="complete", start=2, start_deadline=8.0)
    config = reached(some, radio={"connect_deadline": 3.0})
    async with Hall(config, tmp_path) as hall:
        hall.fault(0, off=1)
        hall.fault(2, silent=1)
        run = await hall.fly()
        result = await run.end(120.0)
        state = hall.state()
    assert [result["results"][i]["success"] for i in "13"] == [True, True], result[
        "reasons"
    ]
    assert "no virtual drone is there" in result["reasons"]["0"]
    assert "no answer within" in result["reasons"]["2"]
    assert state[1]["poses"] > 0
    assert state[0]["impact"] == state[2]["impact"] == 0.0, "they have not moved"


@pytest.mark.slow
async def test_a_drone_in_hover_keeps_hovering_through_a_reconnect_and_sees_no_zero_set_point(
    tmp_path,
) -> None:
    config = reached(
        figures(1, "xyz").replace(
            mission_options={"size": 0.1, "laps": 3.0, "period": 10.0}
        )
    )
    async with Hall(config, tmp_path) as hall:
        run = await hall.fly()
        await in_the_air(hall, run, 0)
        before = hall.state()[0]
        hall.fault(0, silent=1)
        await asyncio.sleep(3.2)  # longer than an owner waits before it connects anew
        hall.fault(0, silent=0)
        await run.says("lost: ")
        await asyncio.sleep(2.0)
        after = hall.state()[0]
        assert after["p"][2] > UP, (after, run.text)
        assert after["starts"] == before["starts"]
        hall.interrupt(run)
        landed = (await hall.until(lambda state: state[0]["resting"], 30.0))[0]
        await run.end(60.0)
    assert landed["zeros"] == 0, "cflib's own closing sends one"
    assert landed["impact"] < 1.0


@pytest.fixture
def fake_usb(tmp_path, monkeypatch):
    """A folder that says what a fake dongle of other processes reaches, and whether it is plugged in."""
    folder = tmp_path / "usb"
    folder.mkdir()
    here = Path(__file__).parent
    path = os.pathsep.join(
        [str(here / "fake_usb"), str(here.parent), os.environ.get("PYTHONPATH", "")]
    )
    monkeypatch.setenv("FAKE_USB", str(folder))
    monkeypatch.setenv("PYTHONPATH", path.rstrip(os.pathsep))
    return folder


def by_radio(config: SwarmConfig, folder: Path) -> dict[str, Any]:
    """Return the swarm with its udp:// drones behind a fake dongle; write their ports in the folder of the dongle."""
    raw, ports = json.loads(config.dumps()), {}
    for drone in raw["drones"]:
        address = f"E7E7E7E7{drone['id']:02X}"
        ports[address] = int(drone["uri"].rpartition(":")[2])
        drone["uri"] = f"radio://0/80/2M/{address}"
    (folder / "drones").write_text(json.dumps(ports))
    return raw


@pytest.mark.slow
async def test_a_dongle_that_is_pulled_out_in_flight_and_plugged_in_again_finds_its_drones(
    tmp_path, fake_usb
) -> None:
    some = figures(2, "xyz").replace(
        mission_options={"size": 0.1, "laps": 6.0, "period": 10.0}
    )
    raw = json.loads(reached(some, radio={"log_rate": 25.0}).dumps())
    for drone in raw["drones"]:
        drone["pose"] = "onboard"  # an owner without a dongle sends no camera poses
    config = SwarmConfig.of(raw)
    async with Hall(config, tmp_path, "--capacity", "100000") as hall:
        hall.path.write_text(json.dumps(by_radio(config, fake_usb)))
        run = await hall.fly()
        await in_the_air(hall, run, 0, 1)
        (fake_usb / "pulled").touch()
        await run.says("pulled out")
        await run.says("dongle 0: its owner ended with code 1: started again")
        await run.says("Plug a Crazyradio in")
        (fake_usb / "pulled").unlink()
        landed = await hall.until(
            lambda state: all(state[i]["resting"] for i in (0, 1)), 60.0
        )
        await run.end(60.0)
    for said in landed.values():
        assert (said["zeros"], said["crashed"], said["starts"]) == (0, "", 1), said
        assert said["impact"] < 1.0, (
            "landed by its firmware, as the owner that found it has told it"
        )


@pytest.mark.slow
async def test_a_run_without_its_dongle_ends_and_says_what_to_do(
    tmp_path, fake_usb
) -> None:
    some = figures(1, "xyz", start_deadline=8.0)
    config = reached(some, radio={"connect_deadline": 2.0})
    (fake_usb / "pulled").touch()
    async with Hall(config, tmp_path) as hall:
        hall.path.write_text(json.dumps(by_radio(config, fake_usb)))
        run = await hall.fly()
        result = await run.end(90.0)
    assert not result["success"]
    assert result["code"] == 1
    assert "Plug a Crazyradio in" in run.text


@pytest.mark.slow
async def test_an_agent_that_is_killed_leaves_its_drone_to_its_firmware(
    tmp_path,
) -> None:
    config = reached(figures(2, "frpy"))
    async with Hall(config, tmp_path) as hall:
        run = await hall.fly()
        await in_the_air(hall, run, 0, 1)
        (agent,) = processes(f"[c]li.agent --swarm .*{config.name}.* --id 0 ")
        os.kill(agent, signal.SIGKILL)
        landed = await hall.until(lambda state: state[0]["resting"], 20.0)
        assert landed[0]["impact"] < 1.0
        assert not landed[0]["crashed"]
        result = await run.end(90.0)
    assert not result["success"]
    assert "no command for" in run.text


@pytest.mark.slow
@pytest.mark.parametrize("given", [None, 136_531.0])
async def test_thrust_is_known_by_the_release_and_a_wrong_map_is_found_in_hover(
    tmp_path, given
) -> None:
    radio = {} if given is None else {"thrust_map": given}
    config = reached(figures(1, "fpqr"), radio=radio)
    async with Hall(config, tmp_path, "--firmware", "2023.11") as hall:
        run = await hall.fly()
        result = await run.end(90.0)
        landed = hall.state()[0]
    assert landed["resting"]
    assert not landed["crashed"]
    assert result["success"] is (given is None), result["reasons"]
    if given is not None:
        assert (
            "times the thrust that its platform and firmware are known for"
            in result["reasons"]["0"]
        )


def pickup(per_dongle: int) -> SwarmConfig:
    config = (
        load_mission("pickup_delivery")
        .swarm(None)
        .replace(mission="pickup_delivery", control={"sender": "xyz"})
    )
    return reached(config, per_dongle=per_dongle)


@pytest.fixture
def exclusive(tmp_path, monkeypatch):
    """Let each link be opened once at a time; return the folder that lists which process has opened which link."""
    folder = tmp_path / "links"
    folder.mkdir()
    monkeypatch.setenv("EXCLUSIVE_LINKS", str(folder))
    here = Path(__file__).parent
    path = os.pathsep.join(
        [
            str(here / "exclusive_driver"),
            str(here.parent),
            os.environ.get("PYTHONPATH", ""),
        ]
    )
    monkeypatch.setenv("PYTHONPATH", path.rstrip(os.pathsep))
    return folder


@pytest.mark.slow
async def test_six_share_pickups_and_deliveries_over_three_dongles(
    tmp_path, exclusive
) -> None:
    config = pickup(2)
    result = await flown(config, tmp_path)
    assert [r["cost"] for r in result["results"].values()] == [
        pytest.approx(32.6247, abs=1e-3)
    ] * 6
    owners: dict[str, list[str]] = {}
    for line in (exclusive / "opened").read_text().splitlines():
        process, uri = line.split()
        owners.setdefault(process, []).append(uri)
    uris = [config.drone(i).uri for i in config.ids]
    assert sorted(owners.values()) == sorted([uris[0:2], uris[2:4], uris[4:6]]), (
        "three owners, two links each, once"
    )


async def test_a_dongle_has_one_owner(tmp_path, exclusive) -> None:
    config = reached(figures(2, "xyz"))
    async with Hall(config, tmp_path) as hall:
        first = await Program.start(*RADIO, "--swarm", hall.path, "--dongle", "0")
        hall.programs.append(first)
        await hall.until(
            lambda state: all(said["client"] for said in state.values()), 30.0
        )
        second = await (
            await Program.start(*RADIO, "--swarm", hall.path, "--dongle", "0", "--json")
        ).end(30.0)
        assert second["code"] == 2
        has_it = f"dongle 0: refused: process {first.process.pid} (swarm {config.name}) has it, and may fly drones"
        assert second["error"].startswith(has_it)
        first.signal(signal.SIGTERM)
        assert (await first.end(20.0))["code"] == 0
        assert all(said["zeros"] == 0 for said in hall.state().values())


@pytest.mark.slow
async def test_a_word_is_drawn_by_body_rates(tmp_path) -> None:
    config = reached(
        load_mission("drawn_path")
        .swarm(None)
        .replace(mission="drawn_path", control={"sender": "fpqr"})
    )
    await flown(config, tmp_path)


@pytest.mark.slow
async def test_a_formation_stands_by_roll_and_pitch_at_the_rate_that_a_dongle_carries(
    tmp_path,
) -> None:
    config = (
        load_mission("bearing_formation")
        .swarm(4)
        .replace(mission="bearing_formation", control={"sender": "frpy"})
    )
    result = await flown(reached(config, per_dongle=4), tmp_path)
    assert result["formation_error_m"] < 0.01


@pytest.mark.slow
async def test_twenty_fly_a_figure(tmp_path) -> None:
    """The cameras run at 50 Hz: at 100 Hz the nine processes of this flight would need more than two processors."""
    groups = [list(range(0, 20, 2)), list(range(1, 20, 2))]
    config = reached(
        figures(20, "xyz", processes=groups), per_dongle=4, mocap={"rate": 50}
    )
    await flown(config, tmp_path, 200.0)


async def farthest(hall: Hall, run: Program, homes: dict[int, Any]) -> dict[int, float]:
    """Return how far, in m, each drone with turning motors strayed sideways from its home until the run was over."""
    far = dict.fromkeys(homes, 0.0)
    while run.process.returncode is None:
        for i, said in hall.state().items():
            if any(share > 0.01 for share in said["motors"]):
                far[i] = max(far[i], math.dist(said["p"][:2], homes[i][:2]))
        await asyncio.sleep(0.05)
    return far


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "sender"),
    [("exchanged", "fpqr"), ("exchanged", "xyz"), ("turned", "frpy")],
)
async def test_drones_with_wrong_bodies_are_named_in_the_ascent_and_come_down(
    tmp_path, case, sender
) -> None:
    """Exchanged: the radio of drone 0 reaches drone 1, and the other way round; the cameras see both as they are."""
    config = reached(figures(2, sender))
    raw = json.loads(config.dumps())
    homes = {drone["id"]: drone["home"] for drone in raw["drones"]}
    wrong = (0, 1) if case == "exchanged" else (0,)
    if case == "exchanged":
        a, b = (drone["uri"] for drone in raw["drones"])
        raw["drones"][0]["uri"], raw["drones"][1]["uri"] = b, a
    async with Hall(config, tmp_path) as hall:
        if case == "turned":
            hall.fault(0, turned=math.pi)
        (tmp_path / "flown.json").write_text(json.dumps(raw))
        run = await hall._start("run", str(tmp_path / "flown.json"), "--json")
        far = await asyncio.wait_for(farthest(hall, run, homes), 90.0)
        result = await run.end(30.0)
        landed = hall.state()
    said = [result["results"][str(i)]["reason"] for i in wrong]
    assert any(TILTS in reason for reason in said), result["reasons"]
    assert all(TILTS in reason or STAYS in reason for reason in said), result["reasons"]
    assert max(far[i] for i in wrong) < 0.5, far
    assert all(said["p"][2] < 0.05 for said in landed.values())
    for i in [i for i in homes if i not in wrong]:  # it may have failed with its team
        assert f"drone {i}: stopped" not in result["reasons"].get(str(i), ""), result[
            "reasons"
        ]
