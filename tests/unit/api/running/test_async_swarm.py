"""A running swarm as an asynchronous object, over whole drones in virtual time."""

import asyncio
from contextlib import asynccontextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from msgspec import to_builtins
from msgspec.structs import replace
from operators import play_scene

from crazychoir.agent import steering
from crazychoir.agent.dead_man import ConsoleReporter
from crazychoir.agents import operator as mission
from crazychoir.api.connecting import connect_async
from crazychoir.api.running import async_swarm
from crazychoir.api.running.async_swarm import AsyncSwarm
from crazychoir.api.running.receipts import OrderFailed, OrderReceipt
from crazychoir.errors import ConfigError
from crazychoir.launch.observer import Window
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.trajectory_file import write_pieces
from crazychoir.safety.rules.modes import Mode


def join(operator):
    """Return the swarm of a flight in virtual time."""
    bus = operator.agent.bus
    port = operator.commander.port
    seen = SimpleNamespace(
        ports={port.address: port}, subscribe=bus.subscribe, host=bus.host
    )
    link = SimpleNamespace(bus=seen, directory=dict.fromkeys(bus.ports), peers={})
    return AsyncSwarm(Window(operator.clock, operator.agent.config, link))


def fly(scene, drones=2):
    async def joined(operator):
        await scene(join(operator), operator)

    made = SimpleNamespace(guidance=mission.guidance)
    return play_scene(made, joined, mission.swarm(drones))


def test_script_takes_off_moves_follows_and_lands(tmp_path):
    eight = tmp_path / "path.csv"
    write_pieces(eight, minimum_snap([[0, 0, 0], [0.4, 0.3, 0.0], [0.8, 0, 0.1]]))

    async def scene(swarm, operator):
        await swarm.take_off(height=0.5, duration=2.0)
        await swarm.go_to([0.0, 0.5, 0.2], relative=True)
        states = await swarm.states()
        assert states[1].p == pytest.approx([0.6, 0.5, 0.7], abs=0.05)
        await swarm.follow(eight)
        assert (await swarm[0].state()).p == pytest.approx([0.8, 0.5, 0.8], abs=0.05)
        began = operator.clock.now()
        await swarm.follow(str(eight), timescale=2.0, reverse=True)
        seconds = 2.0 * minimum_snap([[0, 0, 0], [0.4, 0.3, 0], [0.8, 0, 0.1]]).duration
        assert operator.clock.now() - began == pytest.approx(seconds, abs=0.5)
        await swarm[1].velocity([0.0, -0.3, 0.0], duration=1.0)
        await swarm[[0, 1]].hold()
        await swarm[0].go_to([0.0, 0.0, 0.6], speed=0.3)
        await swarm.land(duration=2.0)
        assert operator.modes() == [Mode.GROUND] * 2

    assert all(result["success"] for result in fly(scene).values())


def test_refused_drone_raises_with_its_receipt():
    async def scene(swarm, operator):
        with pytest.raises(OrderFailed) as failed:
            await swarm[1].go_to([0.0, 0.0, 1.0])
        assert failed.value.receipts == (
            OrderReceipt(1, "go-to", "refused", "it is on ground"),
        )
        assert str(failed.value) == "drone 1: go-to refused: it is on ground"
        await swarm[0].take_off()
        with pytest.raises(OrderFailed) as failed:
            await swarm.take_off()
        assert [receipt.drone for receipt in failed.value.receipts] == [0]
        await swarm.land()

    fly(scene)


def test_flight_on_board_is_refused_by_a_drone_without_firmware():
    async def scene(swarm, operator):
        await swarm.take_off()
        with pytest.raises(OrderFailed, match="it has no firmware here"):
            await swarm.follow(minimum_snap([[0, 0, 0], [0.4, 0.3, 0]]), on_board=True)
        await swarm.land()

    fly(scene)


def test_drones_of_a_running_swarm_are_found_by_their_names():
    swarm = mission.swarm(2)
    named = [replace(drone, name=f"cf{drone.id}") for drone in swarm.drones]
    config = swarm.replace(drones=to_builtins(named))

    async def scene(operator):
        swarm = join(operator)
        assert swarm["cf1"].ids == (1,)
        assert swarm[["cf1", 0]].ids == (1, 0)
        with pytest.raises(ConfigError, match=r"found cf3.*Did you mean"):
            swarm["cf3"]
        await swarm.take_off()
        await swarm.land()

    play_scene(SimpleNamespace(guidance=mission.guidance), scene, config)


class Firmware:
    """The firmware of a drone that takes an upload after some seconds, and notes when it begins a path."""

    def __init__(self, clock, upload_time):
        self.clock = clock
        self.upload_time = upload_time
        self.uploads = 0
        self.starts = []

    async def request(self, verb, deadline, **arguments):
        if verb == "trajectory_upload":
            self.uploads += 1
            await self.clock.sleep(self.upload_time)
        else:
            self.starts.append(self.clock.now())
        return ""


def test_drones_begin_a_trajectory_on_board_when_all_have_it_in_memory(monkeypatch):
    step = minimum_snap([[0, 0, 0], [0.0, 0.3, 0]])

    async def scene(swarm, operator):
        made = {i: Firmware(operator.clock, 4.0 * i) for i in (0, 1)}
        monkeypatch.setattr(steering, "require_firmware", lambda drone: made[drone.id])
        await swarm.take_off()
        for _ in range(2):
            await swarm.follow(step, on_board=True)
        assert [firmware.uploads for firmware in made.values()] == [2, 2]
        for starts in zip(
            *(firmware.starts for firmware in made.values()), strict=True
        ):
            assert abs(np.subtract(*starts)) < 0.2
        await swarm.land()

    fly(scene)


def test_the_memory_is_not_written_while_its_trajectory_flies(monkeypatch):
    there = minimum_snap([[0, 0, 0], [0.0, 0.3, 0]], [0.0, 6.0])
    back = minimum_snap([[0, 0, 0], [0.0, -0.3, 0]], [0.0, 6.0])

    async def scene(swarm, operator):
        made = {i: Firmware(operator.clock, 0.1) for i in (0, 1)}
        monkeypatch.setattr(steering, "require_firmware", lambda drone: made[drone.id])
        await swarm.take_off()
        flying = asyncio.ensure_future(swarm.follow(there, on_board=True))
        await operator.clock.sleep(4.0)
        with pytest.raises(OrderFailed, match="from its memory: hold the drone first"):
            await swarm.follow(back, on_board=True)
        await flying
        await swarm.follow(back, on_board=True)
        assert [firmware.uploads for firmware in made.values()] == [2, 2]
        await swarm.land()

    fly(scene)


def test_absent_drone_raises_at_once():
    async def scene(swarm, operator):
        del swarm.window.link.directory[1]
        began = operator.clock.now()
        with pytest.raises(OrderFailed, match="drone 1: hold absent: its agent"):
            await swarm.hold()
        assert operator.clock.now() - began < 1.0
        swarm.window.link.directory[1] = None
        await swarm.land()

    fly(scene)


def test_command_without_a_wait_returns_when_it_is_accepted_and_may_be_replaced():
    async def scene(swarm, operator):
        await swarm.take_off()
        began = operator.clock.now()
        await swarm[0].go_to([0.0, 3.0, 1.0], wait=False)
        assert operator.clock.now() - began < 0.5
        await operator.clock.sleep(1.0)
        await swarm[0].go_to([0.0, 0.0, 1.0])
        assert (await swarm[0].state()).p == pytest.approx([0, 0, 1], abs=0.05)
        with pytest.raises(OrderFailed, match="outside the fence"):
            await swarm[0].go_to([0.0, 0.0, 9.0], wait=False)
        await swarm.land()

    fly(scene)


def test_several_drones_are_not_sent_to_one_place():
    async def scene(swarm, operator):
        with pytest.raises(ConfigError, match="relative=True"):
            await swarm.go_to([0.0, 0.0, 1.0])
        with pytest.raises(ConfigError, match="drone 7"):
            swarm[7]
        await swarm.take_off()
        await swarm.land()

    fly(scene)


def test_parameters_are_read_and_changed():
    async def scene(swarm, operator):
        assert sorted(await swarm.param.get()) == [0, 1]
        names = (await swarm[1].param.get())[1]
        name, value = next((n, v) for n, v in names.items() if n == "control.kp")
        changed = (0.9 * np.array(value)).tolist()
        await swarm[1].param.set(name, changed)
        found = await swarm.param.get(name)
        assert found[1] == pytest.approx(changed)
        assert found[0] == pytest.approx(value)
        with pytest.raises(OrderFailed) as failed:
            await swarm.param.set("control.nothing", 1.0)
        assert failed.value.receipts[0].answer == "refused"
        await swarm.take_off()
        await swarm.land()

    fly(scene)


def test_network_is_impaired():
    async def scene(swarm, operator):
        found = await swarm.impair(loss=0.3, edge=(0, 1))
        assert "0.3" in str(found[0])
        await swarm.impair(clear=True)
        await swarm.take_off()
        await swarm.land()

    fly(scene)


def test_log_collects_states_until_it_is_stopped():
    async def scene(swarm, operator):
        log = await swarm[0].log(rate=20.0)
        await swarm.take_off(height=0.5)
        log.stop()
        count = len(log.rows)
        await swarm.land()
        assert len(log.rows) == count > 20
        assert np.all(np.diff(log.rows[:, 0]) > 0.0)
        assert log.rows[-1, 3] == pytest.approx(0.5, abs=0.05)
        assert list(log.frame().columns[:4]) == ["t", "x", "y", "z"]

    fly(scene)


def test_stop_cuts_the_motors_of_one_drone():
    async def scene(swarm, operator):
        await swarm.take_off()
        await swarm[1].stop()
        assert operator.modes() == [Mode.HOVER, Mode.CUT]
        await swarm.begin_landing()

    fly(scene)


@pytest.mark.parametrize(("said", "count"), [({}, 0), ({"console": True}, 1)])
async def test_only_a_script_that_says_so_counts_as_a_console(monkeypatch, said, count):
    attached = []

    @asynccontextmanager
    async def attach(link, *actors):
        attached.extend(actors)
        yield

    def subscribe(*wanted):
        """Send no states."""

    port = SimpleNamespace(handlers={}, address=100)
    bus = SimpleNamespace(ports={100: port}, subscribe=subscribe, host="here")
    link = SimpleNamespace(bus=bus, directory={0: None, 1: None}, peers={})
    config = mission.swarm(2).replace(flight={"dead_man": 3.0})
    monkeypatch.setattr(async_swarm, "running_swarm", lambda swarm: config)
    monkeypatch.setattr(async_swarm, "make_observer_link", lambda clock, config: link)
    monkeypatch.setattr(async_swarm, "run_attached", attach)
    async with connect_async(**said):
        assert [type(actor) for actor in attached] == count * [ConsoleReporter]
