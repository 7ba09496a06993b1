"""The row of a run has the figures that repeat."""

from crazychoir.api.sweep_rows import build_row

RESULT = {
    "report": ["cost", "plan", "late_s"],
    "cost": 2.5,
    "plan": [1, 2],
    "late_s": {"all": 3.0, "by_drone": {0: 1.0, 1: 2.0}},
    "mission": "figure",
    "success": False,
    "reason": "too slow",
    "reasons": {1: "drone 1: late", 2: "lost"},
    "drones": 3,
    "simulated_s": 10.0,
    "wall_s": 0.3,
    "startup_s": 0.1,
    "min_separation_m": float("nan"),
    "messages": {"sent": 5, "lost": 1, "resent": 2},
    "rounds": 4,
    "digest": "ab",
    "flown_m": {0: 1.25, 1: 2.0},
    "results": {},
}


def test_a_row_has_numbers_and_texts_and_no_wall_time():
    assert build_row(RESULT) == {
        "success": False,
        "reason": "too slow; drone 1: late; drone 2: lost",
        "drones": 3,
        "simulated_s": 10.0,
        "min_separation_m": None,
        "rounds": 4,
        "cost": 2.5,
        "plan": "[1, 2]",
        "late_s.all": 3.0,
        "late_s.by_drone.0": 1.0,
        "late_s.by_drone.1": 2.0,
        "messages_sent": 5,
        "messages_lost": 1,
        "messages_resent": 2,
        "flown_m": 3.25,
        "digest": "ab",
    }
