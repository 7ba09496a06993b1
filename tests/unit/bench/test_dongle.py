"""The radio model of a dongle carries what its plan allows, in time."""

import pytest

from crazychoir.bench.dongle import DONGLE_BENCH, DongleCase, measure_dongle, table
from crazychoir.radio.checks import link_problems

SECONDS = 5.0


def p95(row, key):
    return 1e-3 * row[key][1]


@pytest.mark.parametrize(
    "case",
    [
        DongleCase(13, "xyz"),
        DongleCase(12, "xyz", inline=True),
        DongleCase(12, "xyz", inline=True, pose_rate=50.0),
        DongleCase(6, "frpy", 30.0),
        DongleCase(6, "frpy", 50.0, inline=True),
        DongleCase(6, "fpqr", 100.0, inline=True),
    ],
)
def test_what_a_plan_allows_arrives_in_time(case):
    row = measure_dongle(case, SECONDS)
    assert row["planned"] <= 0.85
    assert row["commands_hz"] == pytest.approx(case.rate or 10.0, abs=0.6)
    assert p95(row, "command_age_ms") < 1.0 / (case.rate or 10.0)
    assert p95(row, "pose_age_ms") < 1.6 / case.pose_rate
    assert p95(row, "round_trip_ms") < 0.2, "logs are compared with the cameras' poses"
    assert row["refused"] == 0


def test_one_packet_a_visit_carries_five_drones_and_not_twelve():
    few, many = (
        measure_dongle(DongleCase(n, "xyz", visit=1), SECONDS) for n in (5, 12)
    )
    assert link_problems(p95(few, "round_trip_ms"), 1.0) == []
    assert link_problems(p95(many, "round_trip_ms"), 1.0)
    assert few["busy_changing"] > 0.7, (
        "most of the time goes into changes of the address"
    )


def test_lost_broadcasts_make_the_last_pose_older():
    ages = {
        loss: measure_dongle(DongleCase(12, "xyz", inline=True, loss=loss), 20.0)[
            "pose_age_ms"
        ]
        for loss in (0.0, 0.1)
    }
    assert ages[0.0][2] < 110.0
    assert 150.0 < ages[0.1][1] < 250.0
    assert ages[0.1][2] > 290.0, "some drone missed two in a row"


def test_the_table_has_a_row_a_case():
    rows = [measure_dongle(case, 2.0) for case in DONGLE_BENCH.cases[:2]]
    assert table(rows).row_count == 2
