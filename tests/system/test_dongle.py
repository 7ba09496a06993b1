"""Several drones behind one Crazyradio, through cflib's radio link, without hardware: a fake dongle at cflib's USB.

Behind its radio are virtual Crazyflies, served by the test itself.
"""

import asyncio
import contextlib
import json
import threading
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from cflib.drivers import crazyradio
from fake_dongle import FakeDongle, Receiver
from system.hall import udp_block

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.errors import LinkFailed
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.upload import fit_upload
from crazychoir.radio.drone.drone_setup import DroneSetup
from crazychoir.radio.drone.pose_broadcast import PoseBroadcast, ToldPose
from crazychoir.radio.drone.timing import CONNECT_ATTEMPTS
from crazychoir.radio.link import drivers
from crazychoir.radio.link.connection import Connection
from crazychoir.radio.link.dongles import DongleFailed
from crazychoir.radio.link.firmware import ConnectedFirmware
from crazychoir.radio.link.toc_cache import TableOfContents
from crazychoir.radio.owner import RadioProcess
from crazychoir.radio.protocol.crtp import PACKET_FORMS, CrtpPort, Packet
from crazychoir.radio.protocol.handlers import emergency_packets
from crazychoir.radio.protocol.packed_poses import NumberedPose
from crazychoir.radio.virtual.server import VirtualServer
from crazychoir.radio.virtual.setup import place_on_grid
from crazychoir.runtime.clock import WallClock
from crazychoir.types import Pose

pytestmark = [pytest.mark.system, pytest.mark.real_time]
HOVER = PACKET_FORMS["hover"]


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """A folder for tables of contents, which the first test that connects fills."""
    return tmp_path_factory.mktemp("contents")


@contextlib.contextmanager
def plugged(*dongles):
    """These are there for cflib, the first as number 0; the sockets of their drones are closed at the end."""
    drivers.register_drivers()
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                crazyradio,
                "_find_devices",
                lambda serial=None: [one for one in dongles if one.there],
            )
            yield
    finally:
        for dongle in dongles:
            dongle.there = False  # links that a failing test has left open end too
            for drone in dongle.drones.values():
                drone.close()


@contextlib.asynccontextmanager
async def air(n, exchanges=1000.0, loss=0.0, inline=False):
    """clock;  server: of virtual drones;  dongle: reaches them at addresses E7E7E7E700 and following, channel 80."""
    clock, port = WallClock(asyncio.get_running_loop()), udp_block(n)
    hall = place_on_grid(n, port, None)
    server = VirtualServer(clock, hall.world(0), hall.seats, hall.poses)
    server.listen()
    running = asyncio.create_task(server.run())
    dongle = FakeDongle(
        {(80, address(i)): Receiver(port + i, loss) for i in range(n)},
        exchanges,
        inline=inline,
    )
    try:
        with plugged(dongle):
            yield (
                there := SimpleNamespace(
                    clock=clock, server=server, dongle=dongle, links=[]
                )
            )
    finally:
        await asyncio.gather(*(link.close() for link in there.links))
        running.cancel()
        await asyncio.wait([running])
        await server.on_stop()
        clock.close()


def address(i):
    return f"E7E7E7E7{i:02X}"


def uri(i):
    return f"radio://0/80/2M/{address(i)}"


async def opened(there, folder, n, seconds=10.0):
    contents = TableOfContents(folder)
    links = [Connection(there.clock, uri(i), contents) for i in range(n)]
    there.links += links
    await asyncio.gather(*(link.open(seconds) for link in links))
    return links


async def closed(links):
    """Within 1.5 s, and no thread is left."""
    async with asyncio.timeout(1.5):
        await asyncio.gather(*(link.close() for link in links))
    for _ in range(40):
        names = [
            thread.name
            for thread in threading.enumerate()
            if thread.name.startswith(("radio", "Radio", "Inc"))
        ]
        if not names:
            return
        await asyncio.sleep(0.05)
    raise AssertionError(names)


def plain(packet):
    """Without the bits of safelink."""
    return bytes([packet[0] | 0x0C]) + packet[1:]


EMERGENCY = [packet.framed() for packet in emergency_packets()]


async def until(holds, seconds=5.0):
    for _ in range(round(seconds / 0.02)):
        if holds():
            return
        await asyncio.sleep(0.02)
    raise AssertionError(f"not so within {seconds:g} s")


def flood(links, height=0.4):
    """Set-points of one pass: of each link the newest counts."""
    for link in links:
        link.newest("command", HOVER.packet(0.0, 0.0, 0.0, height))


@pytest.mark.slow
async def test_three_on_one_dongle_are_read_told_and_flown(known) -> None:
    async with air(3) as there:
        links = await opened(there, known, 3)
        heights = [0.0] * 3

        def take(i, values, at):
            heights[i] = values["stateEstimate.z"]

        for i, link in enumerate(links):
            await link.log("height", ["stateEstimate.z"], 0.02, partial(take, i), 2.0)
            assert await ConnectedFirmware(link).release() == "2025.12"
            assert await ConnectedFirmware(link).set("led.bitmask", 3 + i) == 3 + i
        for _ in range(100):
            flood(links)
            await asyncio.sleep(0.02)
        assert all(0.3 < z < 0.5 for z in heights), heights
        assert [
            there.server.drones[i].parameters.read("led.bitmask") for i in range(3)
        ] == [3, 4, 5]
        assert all(link.answered == 1.0 and 0.0 < link.latency < 0.1 for link in links)
        assert all(link.rssi == pytest.approx(-40.0) for link in links)
        assert [drone.flight.zeros for drone in there.server.drones.values()] == [
            0,
            0,
            0,
        ]
        await closed(links)


async def test_a_busy_dongle_blocks_no_link_and_sends_an_emergency_stop_first(
    known,
) -> None:
    """40 exchanges a second for 300 set-points, and questions to the firmware between them."""
    async with air(3) as there:
        links = await opened(there, known, 3)
        there.dongle.exchanges = 40.0
        asking = [
            asyncio.create_task(ConnectedFirmware(link).get("led.bitmask"))
            for link in links
        ]
        used = there.dongle.used
        for _ in range(200):
            flood(links, 0.3)
            await asyncio.sleep(0.01)
        assert 60 <= there.dongle.used - used <= 95, "it was busy all the time"
        await asyncio.wait(asking, timeout=2.0)
        assert all(task.done() and task.exception() is None for task in asking)
        assert all(link.failure == "" for link in links)
        before = [len(drone.up) for drone in there.dongle.drones.values()]
        for link in links:
            link.send(Packet(15, 2, b"an order that waits"))
            link.urgent(emergency_packets())
        flood(links, 0.3)
        await until(
            lambda: all(
                drone.onboard.state == "locked"
                for drone in there.server.drones.values()
            ),
            1.0,
        )
        for drone, k in zip(there.dongle.drones.values(), before, strict=True):
            after = [plain(packet) for packet in drone.up[k:]]
            assert after.index(EMERGENCY[0]) <= 2, (
                "one packet was in the air, one was on its way there"
            )
            assert (
                EMERGENCY[1] not in after
                or after.index(EMERGENCY[1]) == after.index(EMERGENCY[0]) + 1
            )
        await closed(links)


@pytest.mark.slow
async def test_what_is_sent_in_order_arrives_once_and_in_order_whatever_is_lost(
    known,
) -> None:
    async with air(2, loss=0.3) as there:
        links = await opened(there, known, 2)
        orders = [Packet(15, 2, bytes([k])) for k in range(100)]
        for link in links:
            for order in orders:
                link.send(order)

        def arrived(drone):
            return [packet[1] for packet in drone.up if packet[0] & 0xF3 == 0xF2]

        await until(
            lambda: all(
                len(arrived(drone)) == 100 for drone in there.dongle.drones.values()
            )
        )
        assert all(
            arrived(drone) == list(range(100)) for drone in there.dongle.drones.values()
        )
        await closed(links)


@pytest.mark.parametrize("inline", [False, True])
async def test_one_broadcast_tells_all_drones_their_poses(known, inline) -> None:
    """The drones fly by set-points meanwhile: acknowledged packets and broadcasts take turns."""
    async with air(3, inline=inline) as there:
        links = await opened(there, known, 3)
        config = swarm(3, broadcast=True)
        bus, broadcast = Bus(there.clock), PoseBroadcast(there.clock, 20.0)
        for i in config.ids:
            bus.port(PORT_ADDRESSES.body_offset + i)
        setups = [DroneSetup(bus, config, i, "xyz", 0.0) for i in config.ids]
        began = there.clock.now()
        for k in range(50):
            pose = Pose(np.array([0.0, 0.0, 0.01 * k, 0.0, 0.0, 0.0, 1.0]))
            for setup, link in zip(setups, links, strict=True):
                row = NumberedPose(there.server.seats[setup.drone].number, pose)
                broadcast.tell(ToldPose(row, there.clock.now(), link, setup))
            flood(links)
            await asyncio.sleep(0.02)
        broadcast.end()
        most = 20.0 * (there.clock.now() - began) + 2.0
        for drone in there.server.drones.values():
            assert 10 <= drone.flight.told.count <= most, "20 times a second"
            assert drone.flight.told.last[2] > 0.4
            assert len(drone.flight.told.last) == 7
        assert there.dongle.broadcasts >= 2 * 10, "two poses in a packet"
        assert broadcast.age < 0.1
        assert all(link.answered == 1.0 for link in links)
        await closed(links)


@pytest.mark.slow
async def test_a_silent_drone_takes_little_air_time_and_later_gets_the_newest_set_point(
    known,
) -> None:
    async with air(2, 250.0) as there:
        links = await opened(there, known, 2)
        silent, other = there.dongle.drones.values()
        silent.silent = True
        other.up.clear()
        silent.tries = 0
        for k in range(100):
            flood(links, 0.3 + 1e-3 * k)
            await asyncio.sleep(0.01)
        assert len([packet for packet in other.up if packet[1] == HOVER.head[0]]) > 75
        assert silent.tries < 80, "it would be 125 of the 250 exchanges"
        assert links[0].silence > 0.8
        silent.up.clear()
        silent.silent = False

        def heights():
            return [
                HOVER.values(Packet(7, 0, p[1:]))[3]
                for p in silent.up
                if p[0] & 0xF3 == 0x70
            ]

        await until(lambda: heights()[-1:] == [pytest.approx(0.399)])
        assert len(heights()) <= 3, (
            "one set-point in the air, one on its way there, and the newest"
        )
        await closed(links)


@pytest.mark.parametrize("n", [1, 2])
async def test_a_dongle_that_is_pulled_out_is_named(known, n) -> None:
    async with air(n) as there:
        links = await opened(there, known, n)
        assert links[0].dongle_failure == ""
        there.dongle.there = False
        await until(lambda: "No such device" in links[0].dongle_failure, 1.0)
        assert "pulled out" in links[0].dongle_failure
        await closed(links)
        late = Connection(there.clock, uri(0), TableOfContents(known))
        with pytest.raises(DongleFailed, match="Plug a Crazyradio in"):
            await late.open(2.0)
        await closed([late])
        there.dongle.there = True
        links = await opened(there, known, n)
        assert links[0].dongle_failure == ""
        await closed(links)


@pytest.mark.slow
async def test_trajectories_are_uploaded_and_what_does_not_fit_is_not_sent(
    known,
) -> None:
    async with air(1) as there:
        links = await opened(there, known, 1)
        firmware, (receiver,) = (
            ConnectedFirmware(links[0]),
            there.dongle.drones.values(),
        )
        flown = fit_upload(minimum_snap([[0, 0, 0.5], [0.3, 0, 0.5], [0.3, 0.3, 0.5]]))
        pieces = len(flown.pieces.durations)
        await firmware.upload(flown.memory, 3, pieces, offset=132)
        kept = bytes(there.server.drones[0].memories.all[2].content)
        assert kept[132 : 132 + len(flown.memory)] == flown.memory
        before = sum(plain(packet)[:1] == b"\x4e" for packet in receiver.up)
        for memory, slot, offset in (
            (flown.memory, 31, 0),
            (flown.memory, -1, 0),
            (flown.memory, 0, 4000),
        ):
            with pytest.raises(LinkFailed, match=r"slots 0 to 30|4096 are there"):
                await firmware.upload(memory, slot, pieces, offset)
        assert sum(plain(packet)[:1] == b"\x4e" for packet in receiver.up) == before
        with pytest.raises(LinkFailed, match="its planner refuses"):
            await firmware.start(7)
        asked = sum(
            packet[0] >> 4 == CrtpPort.MEMORY and packet[0] & 3 == 0
            for packet in receiver.up
        )
        assert asked <= 2 * len(there.server.drones[0].memories.all), (
            "those of decks are not read"
        )
        await closed(links)


@pytest.mark.slow
async def test_three_cold_ones_are_told_their_tables_once_and_in_time(
    tmp_path, monkeypatch
) -> None:
    """250 exchanges a second; the tables have 738 entries, which one of the three is asked."""
    async with (
        air(3, 250.0) as there,
        owner(there.clock, swarm(3), tmp_path, monkeypatch) as (radios, _),
    ):
        limit = radios.config.radio.connect_deadline + CONNECT_ATTEMPTS.tables_deadline
        await until(
            lambda: all(drone.link.state == "up" for drone in radios.drones.values()),
            limit,
        )
        entries = [
            sum(plain(packet)[:2] in (b"\x5c\x02", b"\x2c\x02") for packet in drone.up)
            for drone in there.dongle.drones.values()
        ]
        drone = there.server.drones[0]
        names = len(drone.logs.toc.entries) + len(drone.parameters.toc.entries)
        assert names == 738
        assert names <= sum(entries) < 1.25 * names, "one was asked, with a few repeats"
        assert there.dongle.used < limit * 250.0


async def test_a_drone_that_comes_within_reach_while_its_link_opens_is_reached(
    known,
) -> None:
    """The drone still counts packets for an earlier link; it must not take a new packet for a repeated one."""
    async with air(1) as there:
        (first,) = await opened(there, known, 1)
        await first.close()
        (drone,) = there.dongle.drones.values()
        drone.silent = True
        opening = asyncio.create_task(opened(there, known, 1))
        await asyncio.sleep(0.5)
        drone.silent = False
        (link,) = await asyncio.wait_for(opening, 5.0)
        assert await ConnectedFirmware(link).release() == "2025.12"
        assert not any(packet[0] >> 4 == CrtpPort.MEMORY for packet in drone.up), (
            "memories of decks are not read"
        )
        await closed([link])


async def test_an_emergency_stop_leaves_while_a_link_is_being_opened(tmp_path) -> None:
    async with air(1, 100.0) as there:
        opening = asyncio.create_task(opened(there, tmp_path, 1, 60.0))
        (drone,) = there.server.drones.values()
        await until(lambda: there.dongle.used > 50)
        there.links[0].urgent(emergency_packets())
        await until(lambda: drone.onboard.state == "locked", 1.0)
        assert not opening.done(), "its tables are being read"
        opening.cancel()
        await asyncio.wait([opening])


@pytest.mark.slow
async def test_an_absent_drone_is_named_within_its_deadline(known) -> None:
    async with air(2) as there:
        links = [
            Connection(there.clock, uri(i), TableOfContents(known)) for i in (0, 7)
        ]
        said = await asyncio.gather(
            *(link.open(1.0) for link in links), return_exceptions=True
        )
        assert said[0] is None
        assert isinstance(said[1], LinkFailed)
        assert "no answer within 1 s" in str(said[1])
        await closed(links)


def swarm(n, **radio) -> SwarmConfig:
    """Drones that say themselves where they are, by their decks."""
    raw = json.loads(default_swarm(n).replace(control={"sender": "xyz"}).dumps())
    for i, drone in enumerate(raw["drones"]):
        drone |= {"uri": uri(i), "pose": "onboard"}
    return SwarmConfig.of(raw | {"radio": raw["radio"] | {"log_rate": 25.0, **radio}})


@contextlib.asynccontextmanager
async def owner(clock, config, known, monkeypatch):
    """The owner of the dongle, in this process, without a network; and the task in which it serves."""
    monkeypatch.setattr("crazychoir.radio.owner.tables_folder", lambda: known)
    radios = RadioProcess(clock, config, 0, "dongle0", "here", 1)
    serving = asyncio.create_task(radios.serve())
    try:
        yield radios, serving
    finally:
        radios.abort("the test has ended")
        await asyncio.wait([serving], timeout=5.0)


async def test_the_owner_of_a_dongle_that_is_pulled_out_ends_and_says_why(
    known, monkeypatch
) -> None:
    async with (
        air(2) as there,
        owner(there.clock, swarm(2), known, monkeypatch) as (
            radios,
            serving,
        ),
    ):
        await until(
            lambda: all(drone.link.state == "up" for drone in radios.drones.values()),
            15.0,
        )
        await until(
            lambda: all(
                drone.report.find_problems() == [] for drone in radios.drones.values()
            ),
            10.0,
        )
        there.dongle.there = False
        async with asyncio.timeout(3.0):
            await serving
        report = radios.report()
        assert not report["success"]
        assert "No such device" in report["reason"]
        assert {said["state"] for said in report["drones"].values()} == {"lost"}
    await closed([])


@pytest.mark.slow
async def test_the_owner_of_a_dongle_that_is_not_there_says_so_and_ends_by_its_deadline(
    known, monkeypatch
) -> None:
    clock = WallClock(asyncio.get_running_loop())
    with plugged():
        async with owner(clock, swarm(2, connect_deadline=1.0), known, monkeypatch) as (
            radios,
            serving,
        ):
            began = clock.now()
            async with asyncio.timeout(3.0):
                await serving
            assert 0.9 < clock.now() - began < 2.0
            assert "Cannot find a Crazyradio Dongle" in radios.report()["reason"]
            assert "Plug a Crazyradio in" in radios.report()["reason"]
    clock.close()
