"""Parameters and trajectories on board, asked of the firmware of a virtual Crazyflie in virtual time."""

from types import SimpleNamespace

import numpy as np
import pytest
from radio_drones import READY, Kept, made, tell
from virtual_drones import Hangar
from virtual_time import virtual

from crazychoir.control.firmware import WaypointController
from crazychoir.control.handlers import FullStateTraj
from crazychoir.control.senders import XYZSender
from crazychoir.errors import Refused
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.radio.drone.firmware_access import FOLLOWED_DISTANCE, FirmwareAccess
from crazychoir.types import XYZ, State

EIGHT = minimum_snap(
    [[0, 0, 0], [0.4, 0.2, 0.1], [0, 0, 0], [-0.4, -0.2, 0], [0, 0.1, 0]],
    [0.0, 1.0, 2.0, 3.0, 4.0],
)


class Elements:
    """The table of parameters of a virtual drone, as cflib has it."""

    def __init__(self, hangar):
        self.toc = {}
        for ident, entry in enumerate(hangar.drone.parameters.toc.entries):
            self.toc.setdefault(entry.group, {})[entry.name] = SimpleNamespace(
                ident=ident,
                pytype=f"<{entry.letter}",
                ctype=entry.kind,
                access=int(entry.read_only),
                RO_ACCESS=1,
            )

    def get_element_by_complete_name(self, name):
        group, _, item = name.partition(".")
        return self.toc.get(group, {}).get(item)


class HangarLink(Kept):
    """A connection to a virtual drone without sockets: it answers at once."""

    uri = "udp://127.0.0.1:19850"

    def __init__(self, hangar):
        super().__init__()
        self.hangar = hangar
        toc = Elements(hangar)
        self.cf = SimpleNamespace(param=SimpleNamespace(toc=toc))

    async def ask(self, packet, answers, seconds, again):
        self._keep(packet)
        for reply in self.hangar.drone.take(packet):
            if answers(reply):
                return reply
        raise TimeoutError


def connected(clock, hangar, kind="xyz"):
    drone, _ = made(clock, kind)
    drone.link.connection = link = HangarLink(hangar)
    return drone, link


def requests_of(drone):
    access = FirmwareAccess(drone.setup, drone.link, drone.commands.on_board)
    return access.requests


def message(path):
    return {"coefficients": path.coefficients, "durations": path.durations}


async def start(drone, flown, **how):
    told = {"timescale": 1.0, "relative": False, "reversed": False, **how}
    return await requests_of(drone)["trajectory_start"](message(flown) | told)


def wanted(hangar):
    return np.array([float(hangar.onboard.record["wanted"][axis]) for axis in "xyz"])


@virtual
async def test_a_parameter_is_set_in_flight_and_read_back(clock):
    drone, _ = connected(clock, Hangar().hovering())
    requests = requests_of(drone)
    said = await requests["firmware_set"]({"name": "locSrv.extPosStdDev", "value": 0.5})
    assert said == {"locSrv.extPosStdDev": 0.5}
    lit = await requests["firmware_set"]({"name": "led.bitmask", "value": 255})
    assert lit == {"led.bitmask": 255}
    group = await requests["firmware_get"]({"name": "locSrv"})
    assert group["locSrv.extPosStdDev"] == 0.5
    assert len(group) > 3


@virtual
async def test_all_parameters_are_listed_with_type_and_access(clock):
    drone, _ = connected(clock, Hangar())
    listed = await requests_of(drone)["firmware_list"]({})
    assert len(listed) > 200
    assert listed["led.bitmask"] == ("uint8_t", True)
    assert listed["locSrv.extPosStdDev"] == ("float", True)
    assert listed["cpu.flash"] == ("uint16_t", False)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"name": "ring.efect", "value": 1}, "no parameter ring.efect; it has"),
        ({"name": "led.bitmask", "value": 256}, "0 to 255"),
        ({"name": "led.bitmask", "value": [1.0, 2.0]}, "a number is allowed"),
    ],
)
def test_a_wrong_parameter_or_value_is_refused_with_what_is_allowed(arguments, words):
    @virtual
    async def ask(clock):
        drone, _ = connected(clock, Hangar())
        with pytest.raises(Refused, match=words):
            await requests_of(drone)["firmware_set"](arguments)

    ask()


@pytest.mark.parametrize("is_reversed", [False, True])
def test_the_drone_flies_an_uploaded_trajectory_slowed_relative_and_reversed(
    is_reversed,
):
    @virtual
    async def fly(clock):
        hangar = Hangar().hovering(0.8)
        drone, _ = connected(clock, hangar)
        said = await requests_of(drone)["trajectory_upload"](message(EIGHT))
        assert said == "4 pieces, 528 bytes"
        flown = EIGHT.slowed(2.0)
        flown = flown.reversed() if is_reversed else flown
        flown = flown.shifted(wanted(hangar) - flown.sample(0.0).p)
        how = {"timescale": 2.0, "relative": True, "reversed": is_reversed}
        assert await start(drone, flown, **how) == "started"
        for k in range(1, 9):
            hangar.run(1.0)
            np.testing.assert_allclose(
                wanted(hangar), flown.sample(float(k)).p, atol=0.02
            )
        assert np.linalg.norm(hangar.state[0:3] - flown.sample(8.0).p) < 0.1

    fly()


@virtual
async def test_a_trajectory_beyond_the_memory_is_refused_before_a_packet_is_sent(clock):
    hangar = Hangar()
    drone, link = connected(clock, hangar)
    times = np.arange(0.0, 60.0)
    places = np.random.default_rng(1).uniform(-1.0, 1.0, (60, 3))
    long = minimum_snap(places, times)
    with pytest.raises(Refused, match="at most 31 pieces"):
        await requests_of(drone)["trajectory_upload"](message(long))
    assert link.sent == []


@virtual
async def test_only_a_drone_that_is_sent_places_flies_from_its_memory(clock):
    drone, _ = connected(clock, Hangar(), "frpy")
    with pytest.raises(Refused, match=r'sender is "frpy"; .* needs "xyz"'):
        await requests_of(drone)["trajectory_upload"](message(EIGHT))


def agent_lines():
    """Return a function of a reference and the time: the line of an agent."""
    controller = WaypointController(XYZSender(), FullStateTraj())
    return lambda flown, t, now: controller.command(
        State.at(flown.sample(t).p), flown.sample(t), now
    )


async def flying(clock, flown):
    drone, link = connected(clock, Hangar().hovering())
    await requests_of(drone)["trajectory_upload"](message(flown))
    await start(drone, flown)
    return drone, link, len(link.sent)


@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_the_lines_of_an_agent_along_a_fast_trajectory_are_not_sent(delay):
    assert EIGHT.peaks[0] > 1.4, "m/s"

    @virtual
    async def follow(clock):
        drone, link, before = await flying(clock, EIGHT)
        line = agent_lines()
        for k in range(1, 40):
            await clock.sleep(0.1)
            drone.commands.send(line(EIGHT, 0.1 * k - delay, clock.now()))
            assert len(link.sent) == before, k

    follow()


@virtual
async def test_another_line_ends_the_trajectory_on_board(clock):
    drone, link, before = await flying(clock, EIGHT)
    line = agent_lines()
    await clock.sleep(1.0)
    command = line(EIGHT, 1.0, clock.now())
    for away, is_sent in ((0.9, False), (1.1, True), (0.0, True)):
        other = command.flat.copy()
        other[1] += away * FOLLOWED_DISTANCE
        drone.commands.send(XYZ("line", other))
        assert (len(link.sent) > before) is is_sent
        before = len(link.sent)


@virtual
async def test_a_drone_far_from_the_trajectory_is_flown_by_lines(clock):
    far = EIGHT.shifted((5.0, 0.0, 0.0))
    drone, link, before = await flying(clock, far)
    tell(drone, READY)
    await clock.sleep(0.1)
    drone.commands.send(agent_lines()(far, 0.1, clock.now()))
    assert len(link.sent) > before


@virtual
async def test_a_drone_on_its_trajectory_counts_as_commanded(clock):
    drone, _, _ = await flying(clock, EIGHT)
    drone.commands.note_silence()
    await clock.sleep(0.1)
    drone.commands.send(agent_lines()(EIGHT, 0.1, clock.now()))
    assert drone.commands.has_flown_here


@pytest.mark.parametrize("fails", [False, True])
def test_lines_are_kept_back_until_the_drone_has_begun_its_trajectory(fails):
    @virtual
    async def begin(clock):
        drone, link = connected(clock, Hangar().hovering())
        line = agent_lines()

        async def answer_late(*asked):
            before = len(link.sent)
            await clock.sleep(0.5)
            drone.commands.send(line(EIGHT, 0.0, clock.now()))
            assert len(link.sent) == before
            if fails:
                raise TimeoutError
            return await HangarLink.ask(link, *asked)

        await requests_of(drone)["trajectory_upload"](message(EIGHT))
        link.ask = answer_late
        if fails:
            with pytest.raises(Refused, match="no answer"):
                await start(drone, EIGHT)
        else:
            await start(drone, EIGHT)
        before = len(link.sent)
        await clock.sleep(0.1)
        drone.commands.send(line(EIGHT, 0.1, clock.now()))
        assert (len(link.sent) > before) is fails

    begin()


@virtual
async def test_a_drone_that_is_not_connected_refuses_with_the_reason(clock):
    drone, _ = made(clock)
    drone.link.connection = None
    with pytest.raises(Refused, match=r"drone 0: .*not connected"):
        await requests_of(drone)["firmware_get"]({"name": "led"})
