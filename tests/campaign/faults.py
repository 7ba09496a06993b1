"""Faults of a network, and graphs, drawn from a seed."""

from typing import Any

import numpy as np

from campaign.report import Report
from crazychoir.bus.impairment.rules import ImpairmentRule, NetworkPartition
from crazychoir.team import graph as graphs
from crazychoir.team.graph import Graph

Draw = np.random.Generator


def effects(draw: Draw, report: Report, worst: float = 0.6) -> dict[str, float]:
    """What is wrong with the links: each fault in about a third of the seeds, loss in most."""
    found: dict[str, float] = {}
    if draw.random() < 0.8:
        found["loss"] = float(draw.uniform(0.0, worst))
        report.inject("loss")
    if draw.random() < 0.3:
        length = draw.uniform(2.0, 8.0)
        found |= {
            "p_bad_good": 1.0 / length,
            "p_good_bad": float(draw.uniform(0.005, 0.05)),
        }
        report.inject("bursts")
    if draw.random() < 0.4:
        found["delay"] = float(draw.uniform(0.001, 0.08))
        report.inject("delay")
    if draw.random() < 0.4:
        found["jitter"] = float(draw.uniform(0.001, 0.05))
        report.inject("jitter")
    if draw.random() < 0.3:
        found["duplicate"] = float(draw.uniform(0.05, 0.5))
        report.inject("duplicates")
    if draw.random() < 0.3:
        found |= {
            "reorder": float(draw.uniform(0.05, 0.5)),
            "reorder_delay": float(draw.uniform(0.01, 0.1)),
        }
        report.inject("reordering")
    return found


def graph(draw: Draw, n: int) -> Graph:
    """An undirected connected one."""
    kinds: list[Any] = [graphs.ring, graphs.path, graphs.star, graphs.complete]
    kinds.append(
        lambda n: graphs.erdos_renyi_connected(n, 0.5, int(draw.integers(1 << 30)))
    )
    return kinds[int(draw.integers(len(kinds)))](n)  # type: ignore[no-any-return]


def rules(
    draw: Draw, report: Report, ids: tuple[int, ...], worst: float = 0.4
) -> list[ImpairmentRule]:
    """For all, and now and then worse ones for one drone."""
    made = [ImpairmentRule(effects(draw, report, worst))]
    if draw.random() < 0.3:
        made.append(
            ImpairmentRule(
                {"loss": float(draw.uniform(0.2, 0.7))}, drone=int(draw.choice(ids))
            )
        )
        report.inject("bad link of one drone")
    return made


def partitions(
    draw: Draw, report: Report, ids: tuple[int, ...], until: float
) -> list[NetworkPartition]:
    """Up to two, of 0.2 to 15 s, that are over before `until` s."""
    found: list[NetworkPartition] = []
    for _ in range(int(draw.integers(0, 3))):
        size = int(draw.integers(1, len(ids)))
        since = float(draw.uniform(0.0, until - 0.5))
        ends = min(until, since + float(draw.choice([0.2, 1.0, 2.0, 5.0, 15.0])))
        found.append(
            NetworkPartition(
                since,
                ends,
                tuple(sorted(draw.choice(ids, size, replace=False).tolist())),
            )
        )
        report.inject("partitions")
    return found
