"""Parameters and trajectories on board, asked of the firmware of a virtual Crazyflie in virtual time."""

from types import SimpleNamespace

import numpy as np
import pytest
from radio_drones import Kept, made
from virtual_drones import Hangar
from virtual_time import virtual

from crazychoir.errors import Refused
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.radio.drone.firmware_access import FOLLOWED_DISTANCE, FirmwareAccess
from crazychoir.types import XYZ

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


@virtual
async def test_lines_along_the_trajectory_are_not_sent_and_another_line_ends_it(clock):
    drone, link = connected(clock, Hangar().hovering())
    flown = EIGHT.shifted((0.0, 0.0, 0.5))
    await requests_of(drone)["trajectory_upload"](message(EIGHT))
    await start(drone, flown, relative=True)
    before = len(link.sent)

    def line(t, away):
        x, y, z = flown.sample(t + 0.5).p
        return XYZ("line", np.array([x, y + away, z, 0.0, 0.5]))

    await clock.sleep(1.0)
    drone.commands.send(line(1.0, 0.9 * FOLLOWED_DISTANCE))
    assert len(link.sent) == before
    drone.commands.send(line(1.0, 1.1 * FOLLOWED_DISTANCE))
    assert len(link.sent) > before
    before = len(link.sent)
    drone.commands.send(line(1.0, 0.0))
    assert len(link.sent) > before, "the trajectory on board is over"


@virtual
async def test_a_drone_that_is_not_connected_refuses_with_the_reason(clock):
    drone, _ = made(clock)
    drone.link.connection = None
    with pytest.raises(Refused, match=r"drone 0: .*not connected"):
        await requests_of(drone)["firmware_get"]({"name": "led"})
