"""A recording said again: the same values, at 1x, at 10x and step by step, at the addresses where they were said."""

import asyncio

import numpy as np
import pytest

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.recording.mcap.file import RecordingEntry, RecordingFile, Series
from crazychoir.recording.mcap.messages import (
    FORM_BY_VALUE_TYPE,
    Exchanged,
    make_packer,
)
from crazychoir.recording.replayer import Replayer
from crazychoir.runtime.clock import run_virtual
from crazychoir.runtime.mailbox import Call
from crazychoir.types import FPQR, State, Status, Vel

BEGAN = 1_700_000_000_000_000_000
STEP = 50_000_000


@pytest.fixture
def path(tmp_path):
    """Two seconds of the states of drone 3, 20 a second, each 10 ms old; a status; a message of a round."""
    path = tmp_path / "a.mcap"
    file, entries = RecordingFile(path, {"version": "1"}, "{}", False), []
    series = {
        name: Series(3, name, FORM_BY_VALUE_TYPE[kind])
        for name, kind in (
            ("state", State),
            ("truth", State),
            ("status", Status),
            ("round", Exchanged),
        )
    }
    for k in range(41):
        ns = BEGAN + k * STEP
        for name in ("state", "truth"):
            data = make_packer(series[name].message, 3)(
                State.at((k, 0, 0)), ns - 10_000_000
            )
            entries.append(RecordingEntry(series[name], ns, ns - 10_000_000, data))
    entries.append(
        RecordingEntry(
            series["status"],
            ns,
            ns,
            make_packer(series["status"].message, 3)(Status("landing"), ns),
        )
    )
    data = make_packer(series["round"].message, 3)(Exchanged(1, 2, 0, "sum", b""), ns)
    entries.append(RecordingEntry(series["round"], ns, ns, data))
    file.write(entries)
    file.close()
    return path


def listening(clock, source=lambda topic, i: i):
    """A bus on which an observer hears drone 3; what it hears: (s, topic, value, age)."""
    bus, heard = Bus(clock), []
    bus.port(PORT_ADDRESSES.first_observer + 1)
    for topic in (DRONE_TOPICS.state, DRONE_TOPICS.status, DRONE_TOPICS.truth):
        bus.port(source(topic, 3))
        box = Call(
            clock,
            lambda value, age, topic=topic: heard.append(
                (clock.now(), topic.name, value, age)
            ),
        )
        bus.subscribe(topic, source(topic, 3), PORT_ADDRESSES.first_observer + 1, box)
    return bus, heard


@pytest.mark.parametrize("speed", [1.0, 10.0, 0.5])
def test_at_its_pace_and_faster(path, speed):
    async def main(clock):
        bus, heard = listening(clock)
        replayer = Replayer(bus, path, speed)
        began = clock.now()
        await replayer.run()
        states = [(t, value, age) for t, topic, value, age in heard if topic == "state"]
        assert [value.p[0] for _, value, _ in states] == list(range(41))
        np.testing.assert_allclose(
            [t - began for t, *_ in states], np.arange(41) * 0.05 / speed, atol=1e-6
        )
        assert [age for *_, age in states] == pytest.approx([0.01] * 41)
        assert (heard[-1][1], heard[-1][2].phase) == ("status", "landing")
        assert (replayer.said, replayer.at) == (83, 2.0), (
            "a round is between drones, and is not said again"
        )

    run_virtual(main)


def test_step_by_step(path):
    async def main(clock):
        bus, heard = listening(clock)
        asked, steps = [], asyncio.Queue()

        async def step():
            asked.append(len(heard))
            return await steps.get()

        running = asyncio.create_task(Replayer(bus, path, step=step).run())
        await clock.sleep(1.0)
        assert [value.p[0] for _, topic, value, _ in heard if topic == "state"] == [
            0
        ], "the first moment, and waits"
        for seconds, last in ((0.1, 2), (0.5, 12), (float("inf"), 40)):
            steps.put_nowait(seconds)
            await clock.sleep(1.0)
            assert [value.p[0] for _, topic, value, _ in heard if topic == "state"][
                -1
            ] == last
        await running
        assert asked == [2, 6, 26]

    run_virtual(main)


def test_all_types_of_a_topic_are_published_on_it_for_unopened_drones(tmp_path):
    path = tmp_path / "a.mcap"
    file, entries = RecordingFile(path, {"version": "1"}, "{}", False), []
    for name, value in (
        ("command", FPQR(np.arange(4.0))),
        ("command/vel", Vel(np.arange(4.0) + 5.0)),
    ):
        series = Series(3, name, FORM_BY_VALUE_TYPE[type(value)])
        entries.append(
            RecordingEntry(
                series,
                BEGAN,
                BEGAN + STEP,
                make_packer(series.message, 3)(value, BEGAN + STEP),
            )
        )
    file.write(entries)
    file.close()

    async def main(clock):
        bus, heard = Bus(clock), []
        bus.port(PORT_ADDRESSES.first_observer + 1)
        bus.subscribe(
            DRONE_TOPICS.command,
            3,
            PORT_ADDRESSES.first_observer + 1,
            Call(clock, lambda value, age: heard.append((value, age))),
        )
        await Replayer(bus, path).run()
        assert [(type(value), value.flat.tolist()) for value, _ in heard] == [
            (FPQR, [0, 1, 2, 3]),
            (Vel, [5, 6, 7, 8]),
        ]
        assert [age for _, age in heard] == [0.0, 0.0], (
            "nothing is born after it has come"
        )

    run_virtual(main)


def test_where_it_was_said(path):
    async def main(clock):
        bus, heard = listening(
            clock,
            lambda topic, i: (
                PORT_ADDRESSES.body_offset + i if topic is DRONE_TOPICS.truth else i
            ),
        )
        await Replayer(
            bus,
            path,
            10.0,
            source=lambda topic, i: (
                PORT_ADDRESSES.body_offset + i if topic is DRONE_TOPICS.truth else i
            ),
        ).run()
        assert {topic for _, topic, *_ in heard} == {"state", "truth", "status"}

    run_virtual(main)
