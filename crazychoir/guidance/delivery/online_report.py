"""The report of the online mission: what has become of each task, and why."""

from typing import Any

from crazychoir.guidance.mission_report import Results
from crazychoir.guidance.tasks.task_book import Fate

FINISHED_FATES = (Fate.DELIVERED.value, Fate.CANCELLED.value)
"""Fates of a task that needs no more work."""


def report_fates(results: Results) -> dict[str, Any]:
    """Report what has become of each task, and why a task was not served.

    The fates are those known to the drones that have completed the mission.
    """
    ended = {
        i: r for i, r in sorted(results.items()) if "tasks" in r and r.get("success")
    }
    stops = [stop for r in results.values() for stop in r.get("served", [])]
    delivered = sorted(stop["task"] for stop in stops if stop["kind"] == "delivery")
    first = next(iter(ended.values()), {})
    fates = first.get("tasks", {})
    why = first.get("unserved", {})
    count = {
        fate.value: sum(value[0] == fate.value for value in fates.values())
        for fate in Fate
    }
    undone = {
        j: _describe_undone(fate, robot, why.get(j))
        for j, (fate, robot) in fates.items()
        if fate not in FINISHED_FATES
    }
    twice = [j for j in delivered if delivered.count(j) > 1]
    wrong = [f"task {j}: {text}" for j, text in undone.items()] + [
        f"task {j}: delivered twice" for j in {*twice}
    ]
    wrong += [
        f"drone {i} tells of other ends of the tasks"
        for i, r in ended.items()
        if r["tasks"] != fates
    ]
    return {
        "success": bool(fates) and not wrong,
        "reasons": {next(iter(ended)): "; ".join(wrong)} if wrong else {},
        "tasks": {
            "total": len(fates),
            **{name: number for name, number in count.items() if number},
        },
        "undone": undone,
        "twice": twice,
        "plannings": max(
            (len(r.get("plannings_s", [])) for r in results.values()), default=0
        ),
        "fallbacks": first.get("fallbacks", []),
        "longest_wait_s": max(
            (r.get("longest_wait_s", 0.0) for r in results.values()), default=0.0
        ),
    }


def _describe_undone(fate: str, robot: int | None, why: str | None) -> str:
    """Return why a task is neither delivered nor cancelled."""
    if fate == Fate.LOST.value:
        return f"lost with drone {robot}, that had it aboard; with recover = true it would have been fetched"
    return why or fate
