import math

import numpy as np
from virtual_time import virtual

from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.dashboard.event_log import MOST_LOG_LINES as LINES
from crazychoir.dashboard.event_log import EventLog
from crazychoir.dashboard.model import (
    AGE_COLUMN,
    FRAME_COLUMNS,
    LINK_STATUS_TIMEOUT,
    PAGE_DATA,
    REFERENCE_COLUMNS,
    SwarmModel,
)
from crazychoir.types import FullState, LinkStatus, State, Status


class Seen:
    """Two drones on a bus, and the model of an observer."""

    def __init__(self, clock):
        self.clock, self.bus, self.watch = clock, Bus(clock), EventLog(clock)
        drones = [
            {"id": 3, "name": "cf3", "home": [0, 0, 0]},
            {"id": 7, "home": [1.0, 0, 0], "leader": True},
        ]
        self.config = SwarmConfig.of({"name": "a", "drones": drones, "edges": [[3, 7]]})
        self.ports = {i: self.bus.port(i) for i in (3, 7)}
        self.bus.port(PORT_ADDRESSES.first_observer)
        self.model = SwarmModel(
            self.bus, PORT_ADDRESSES.first_observer, self.config, self.watch
        )

    def frame(self):
        data = self.model.frame()
        (t,) = np.frombuffer(data, "<f8", 1)
        return float(t), np.frombuffer(data, "<f4", offset=8).reshape(2, FRAME_COLUMNS)

    def row(self, i):
        return next(row for row in self.model.table() if row["id"] == i)

    def lines(self):
        return [(line.drone, line.level, line.text) for line in self.watch.after(0)]


@virtual
async def test_a_frame_has_a_row_a_drone_and_nan_for_what_was_not_heard(clock):
    seen = Seen(clock)
    await clock.sleep(1.0)
    seen.ports[7].publish(DRONE_TOPICS.state, State(np.arange(13.0), age=0.02))
    seen.ports[7].publish(DRONE_TOPICS.reference, FullState.at((1.0, 2.0, 3.0)))
    await clock.sleep(0.1)
    t, rows = seen.frame()
    assert t == clock.now()
    assert np.isnan(rows[0, :AGE_COLUMN]).all()
    assert rows[0, AGE_COLUMN] == np.inf
    assert rows[1, :AGE_COLUMN].tolist() == list(range(13))
    assert math.isclose(rows[1, AGE_COLUMN], 0.12, abs_tol=1e-6)
    assert rows[1, REFERENCE_COLUMNS].tolist() == [1.0, 2.0, 3.0]
    assert seen.model.position(3) is None
    assert seen.model.position(7).tolist() == [0.0, 1.0, 2.0]
    await clock.sleep(DRONE_TOPICS.reference.max_age)
    assert np.isnan(seen.frame()[1][1, REFERENCE_COLUMNS]).all(), (
        "a reference that is not renewed is none"
    )


@virtual
async def test_states_come_at_most_thirty_times_a_second(clock):
    seen, heard = Seen(clock), []
    seen.model._rows = type(
        "Rows", (), {"__setitem__": lambda self, key, value: heard.append(clock.now())}
    )()
    async for _ in clock.ticks(100.0):
        if clock.now() >= 2.0:
            break
        seen.ports[3].publish(DRONE_TOPICS.state, State.at((0, 0, 1)))
    assert 58 <= len(heard) <= 61


@virtual
async def test_the_share_of_lost_messages_is_that_of_the_last_seconds(clock):
    seen = Seen(clock)
    for k in range(40):
        lost = max(0, k - 19) * 30
        seen.ports[3].publish(
            DRONE_TOPICS.status, Status("mission", sent=100 * k, lost=lost)
        )
        await clock.sleep(0.25)
    assert PAGE_DATA.loss_window == 5.0
    assert seen.row(3)["lost"] == 0.3
    seen.ports[3].publish(DRONE_TOPICS.status, Status("on ground", sent=5, lost=0))
    await clock.sleep(0.1)
    assert seen.row(3)["lost"] == 0.0, "its agent was started again"


@virtual
async def test_a_table_row_says_what_is_known_and_whether_the_drone_is_heard(clock):
    seen = Seen(clock)
    seen.ports[3].publish(
        DRONE_TOPICS.status,
        Status(
            "hovering", "waits", cost=1.5, round=4, process="p", host="h", note="low"
        ),
    )
    await clock.sleep(0.5)  # a seldom value waits for its drone's turn
    seen.ports[3].publish(
        DRONE_TOPICS.link, LinkStatus("up", latency=0.0071, rssi=-61.0, battery=3.912)
    )
    await clock.sleep(0.1)
    row = seen.row(3)
    expected = {
        "phase": "hovering",
        "task": "waits",
        "cost": 1.5,
        "round": 4,
        "process": "p",
        "host": "h",
        "note": "low",
        "heard": True,
        "link": "up",
        "latency": 0.0071,
        "rssi": -61.0,
        "battery": 3.91,
        "age": None,
        "answered": None,
    }
    assert {key: row[key] for key in expected} == expected
    assert seen.row(7)["heard"] is False
    await clock.sleep(PAGE_DATA.status_timeout)
    assert seen.row(3)["heard"] is False


@virtual
async def test_what_was_heard_of_a_radio_is_forgotten_once_its_owner_is_silent(clock):
    seen = Seen(clock)
    for _ in range(20):
        seen.ports[3].publish(
            DRONE_TOPICS.link,
            LinkStatus("up", rssi=-61.0, battery=3.9, latency=0.004, answered=0.98),
        )
        await clock.sleep(0.1)
        last = seen.row(3)
        assert clock.now() < 0.5 or (last["battery"], last["answered"]) == (3.9, 0.98)
    for _ in range(20):
        seen.ports[3].publish(DRONE_TOPICS.status, Status("mission"))
        await clock.sleep(0.25)
    row = seen.row(3)
    assert (row["heard"], row["link"]) == (True, "silent")
    assert 5.0 <= row["silent"] <= 5.3
    assert not {"battery", "rssi", "latency", "answered"} & set(row)
    assert DRONE_TOPICS.link.max_age < LINK_STATUS_TIMEOUT < 1.0


@virtual
async def test_the_log_has_phases_notes_lines_and_results_with_levels(clock):
    seen, port = Seen(clock), None
    port = seen.ports[3]
    for status in (
        Status("on ground"),
        Status("on ground"),
        Status("taking off", note="braking"),
        Status("hovering"),
        Status("landing", note="battery 2.9 V below 3.0 V: landing", grave=True),
    ):
        port.publish(DRONE_TOPICS.status, status)
        await clock.sleep(0.25)
    port.publish(DRONE_TOPICS.log, "drone 3: guidance failed: no idea")
    port.publish(DRONE_TOPICS.result, {"success": False, "reason": "no idea"})
    await clock.sleep(0.1)
    assert seen.lines() == [
        (3, "info", "on ground"),
        (3, "info", "taking off"),
        (3, "warning", "braking"),
        (3, "info", "hovering"),
        (3, "info", "landing"),
        (3, "error", "battery 2.9 V below 3.0 V: landing"),
        (3, "error", "guidance failed: no idea"),
        (3, "error", "mission ended: no idea"),
    ]


@virtual
async def test_lines_of_a_firmware_are_in_the_log_unless_they_have_their_own(clock):
    seen = Seen(clock)
    seen.ports[3].publish(DRONE_TOPICS.console, "drone 3: firmware: SYS: failed")
    await clock.sleep(0.1)
    assert seen.lines() == [(3, "info", "firmware: SYS: failed")]


@virtual
async def test_costs_are_noted_by_rounds(clock):
    seen = Seen(clock)
    for k, cost, relaxed in ((1, 9.0, math.nan), (1, 9.0, 8.0), (2, 7.0, 5.0)):
        for i in (3, 7):
            seen.ports[i].publish(
                DRONE_TOPICS.status,
                Status("mission", round=k, cost=cost + i, relaxed=relaxed),
            )
        await clock.sleep(0.25)
    assert seen.model.costs() == [(1, 14.0, 8.0), (2, 12.0, 5.0)]
    seen.ports[3].publish(DRONE_TOPICS.status, Status("mission", round=3, cost=6.0))
    await clock.sleep(0.25)
    assert seen.model.costs()[2][:2] == (3, 6.0), "drone 7 is in round 2"
    assert math.isnan(seen.model.costs()[2][2])
    for k in range(4, PAGE_DATA.most_rounds + 4):
        seen.ports[7].publish(
            DRONE_TOPICS.status, Status("mission", round=k, cost=6.0, sent=k)
        )
        await clock.sleep(0.25)
    assert [row[0] for row in seen.model.costs()] == list(
        range(4, PAGE_DATA.most_rounds + 4)
    )
    seen.ports[7].publish(DRONE_TOPICS.status, Status("on ground"))
    await clock.sleep(0.25)
    assert seen.model.costs() == [], "its agent was started again"


@virtual
async def test_what_does_not_change_is_told_in_plain_values(clock):
    about = Seen(clock).model.about()
    assert (about["ids"], about["edges"], about["leaders"]) == ([3, 7], [(3, 7)], [7])
    assert about["names"] == {"3": "3 cf3", "7": "7"}
    assert about["fence"] == [[-4.0, -4.0, 0.0], [4.0, 4.0, 3.0]]
    assert about["limit"] == [[-4.5, -4.5, -0.5], [4.5, 4.5, 3.5]]
    assert about["height"] == 1.0


@virtual
async def test_a_log_keeps_its_newest_lines(clock):
    watch = EventLog(clock)
    for k in range(LINES + 5):
        watch.add(str(k))
    assert [line.text for line in watch.after(LINES + 3)] == [
        str(LINES + 3),
        str(LINES + 4),
    ]
    assert len(watch.after(0)) == LINES


@virtual
async def test_a_row_says_whether_a_stop_of_the_swarm_is_in_force(clock):
    seen = Seen(clock)
    for i, phase in ((3, "stopped"), (7, "on ground")):
        seen.ports[i].publish(DRONE_TOPICS.status, Status(phase, stopped=i == 7))
    await clock.sleep(0.1)
    assert [(row["phase"], row["stopped"]) for row in seen.model.table()] == [
        ("stopped", False),
        ("on ground", True),
    ]
