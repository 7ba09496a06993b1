"""Flights by hand: each velocity replaces the one before, and the last one lets the drone rest."""

from desk_swarm import Swarm
from virtual_time import virtual

from crazychoir.bus.commands import ANSWER_TEXTS
from crazychoir.dashboard.receipts import RECEIPT_KINDS, RECEIPT_TEXTS
from crazychoir.dashboard.stick import STICK_TIMES

STILL = (0.0, 0.0, 0.0)


class Flown(Swarm):
    """Drone 0 flies velocities as drones do: a newer command ends an older one."""

    def executor(self, i):
        inner = super().executor(i)

        async def execute(verb, arguments):
            if verb != "velocity" or i == 1:
                return await inner(verb, arguments)
            self.obeyed.append((verb, arguments))
            await self.clock.sleep(arguments["duration"])
            return "flown"

        return execute


@virtual
async def test_one_receipt_stands_for_the_whole_flight_by_hand(clock):
    swarm = Flown(clock)
    for k in range(5):
        receipt = swarm.desk.steer(0, (0.1 * k + 0.1, 0.0, 0.0), 0.0)
        await clock.sleep(0.1)
    assert receipt.answers[0][0] == ANSWER_TEXTS.accepted
    assert swarm.desk.steer(0, STILL, 0.0) is receipt
    await clock.sleep(1.0)
    assert receipt.answers == {0: (ANSWER_TEXTS.done, "flown")}
    assert [told["v"][0] for _, told in swarm.obeyed] == [
        0.1,
        0.2,
        0.1 * 2 + 0.1,
        0.4,
        0.5,
        0.0,
    ]
    assert swarm.obeyed[0][1]["duration"] == STICK_TIMES.velocity_duration
    assert swarm.desk.steer(0, (1.0, 0.0, 0.0), 0.0) is not receipt


@virtual
async def test_repeated_zeros_of_a_stream_let_the_flight_by_hand_end(clock):
    swarm = Flown(clock)
    receipt = swarm.desk.steer(0, (0.1, 0.0, 0.0), 0.0)
    for _ in range(20):
        await clock.sleep(0.02)
        if swarm.desk.flies_by_hand(0):
            assert swarm.desk.steer(0, STILL, 0.0) is receipt
    assert not swarm.desk.flies_by_hand(0)
    assert receipt.answers == {0: (ANSWER_TEXTS.done, "flown")}
    assert [told["v"][0] for _, told in swarm.obeyed] == [0.1, 0.0]


@virtual
async def test_refusal_of_the_drone_is_shown(clock):
    swarm = Flown(clock)
    receipt = swarm.desk.steer(1, (0.1, 0.0, 0.0), 0.0)
    await clock.sleep(0.3)
    assert receipt.answers == {1: (ANSWER_TEXTS.refused, "it is on the ground")}


@virtual
async def test_refused_flight_has_one_receipt_and_one_log_line_until_the_release(clock):
    swarm = Flown(clock)
    receipt = swarm.desk.steer(1, (0.1, 0.0, 0.0), 0.0)
    for _ in range(5):
        await clock.sleep(0.1)
        assert swarm.desk.steer(1, (0.1, 0.0, 0.0), 0.0) is receipt
    await clock.sleep(0.1)
    assert swarm.desk.steer(1, STILL, 0.0) is receipt
    await clock.sleep(0.1)
    assert receipt.answers == {1: (ANSWER_TEXTS.refused, "it is on the ground")}
    assert swarm.watch.count == 1
    again = swarm.desk.steer(1, (0.1, 0.0, 0.0), 0.0)
    assert again is not receipt
    await clock.sleep(1.0)
    assert swarm.desk.steer(1, (0.1, 0.0, 0.0), 0.0) is not again, "the page was silent"


@virtual
async def test_old_velocity_is_not_sent_again_after_a_newer_one_or_a_stop(clock):
    swarm = Flown(clock)
    hear = swarm.deaf(0)
    swarm.desk.steer(0, (1.0, 0.0, 0.0), 0.0)
    await clock.sleep(0.2)
    swarm.desk.steer(0, (0.0, 1.0, 0.0), 0.0)
    hear()
    await clock.sleep(0.3)
    assert [told["v"] for _, told in swarm.obeyed] == [[0.0, 1.0, 0.0]]
    receipt = swarm.desk.steer(0, (0.0, 0.0, 1.0), 0.0)
    hear = swarm.deaf(0)
    swarm.desk.stop((0,))
    assert receipt.answers[0] == (RECEIPT_KINDS.withdrawn, "by stop")
    hear()
    await clock.sleep(1.0)
    assert len(swarm.obeyed) == 1


@virtual
async def test_silent_drone_and_a_replay_do_not_fly_by_hand(clock):
    swarm = Flown(clock)
    receipt = swarm.desk.steer(2, (0.1, 0.0, 0.0), 0.0)
    await clock.sleep(2.0)
    assert receipt.answers[2][0] == RECEIPT_KINDS.silent
    swarm.replays = True
    receipt = swarm.desk.steer(0, (0.1, 0.0, 0.0), 0.0)
    assert receipt.answers == {0: (ANSWER_TEXTS.refused, RECEIPT_TEXTS.replayed)}


@virtual
async def test_after_another_command_a_stream_must_rest_or_be_released_first(clock):
    for ends in ("rest", "release"):
        swarm = Flown(clock)
        first = swarm.desk.steer(0, (1.0, 0.0, 0.0), 0.0)
        await clock.sleep(0.1)
        swarm.desk.stop((0,))
        sent = len(swarm.obeyed)
        for _ in range(20):
            await clock.sleep(0.1)
            assert swarm.desk.steer(0, (1.0, 0.0, 0.0), 0.0) is first
        assert len(swarm.obeyed) == sent, "a stream does not take the drone back"
        if ends == "rest":
            await clock.sleep(STICK_TIMES.velocity_duration)
        else:
            assert swarm.desk.steer(0, STILL, 0.0) is first
        assert swarm.desk.steer(0, (1.0, 0.0, 0.0), 0.0) is not first
        await clock.sleep(0.1)
        assert len(swarm.obeyed) > sent
