"""The campaign from a shell, in tests/:  python -m campaign 0-9999  or, to see one again,  python -m campaign 4711.

Every seventh seed is run again at the end, in a new process with another hash seed: its digest must be the same.
"""

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from itertools import chain
from typing import Any

from rich.console import Console
from rich.progress import track
from rich.table import Table

from campaign import flights, seeds
from campaign.report import LIGHTWEIGHT, Report

AGAIN = 7
EVERY_KIND = 20
"""So many seeds have a scenario of each kind."""


def campaign(
    chosen: list[int], jobs: int, console: Console, world: str
) -> dict[str, Any]:
    """All of them; what came of it."""
    with multiprocessing.get_context("spawn").Pool(1, seeds.quiet) as pool:
        pool.map(seeds.run, range(EVERY_KIND))  # the laws are compiled then
    began, first, reports = time.perf_counter(), dict[int, str](), list[Report]()
    cpu, kinds, injected, repeated = Counter[str](), Counter[str](), Counter[str](), 0
    again = [seed for seed in chosen if seed % AGAIN == 0]
    done = chain(each(chosen, jobs, world), each(again, jobs, world))
    for report, spent in track(
        done, "seeds", len(chosen) + len(again), console=console
    ):
        cpu[report.kind] += spent
        if report.seed in first:
            repeated += 1
            if report.digest != first[report.seed]:
                report.wrong.append("the same seed has another digest")
        else:
            kinds[report.kind] += 1
            first[report.seed] = report.digest
            injected.update(report.injected)
        if report.wrong:
            reports.append(report)
            console.print(
                f"seed {report.seed} ({report.kind}): {report.wrong[0]}",
                markup=False,
                highlight=False,
            )
            console.print(
                f"  again: cd tests && python -m campaign {report.seed} --world {report.world}",
                markup=False,
                highlight=False,
            )
    wall = time.perf_counter() - began
    return {
        "success": not reports,
        "seeds": len(chosen),
        "repeated": repeated,
        "wall_s": wall,
        "seeds_per_s": (len(chosen) + len(again)) / wall,
        "jobs": jobs,
        "kinds": dict(kinds),
        "injected": dict(injected.most_common()),
        "cpu_s": {kind: spent / max(1, kinds[kind]) for kind, spent in cpu.items()},
        "wrong": [asdict(report) for report in reports],
    }


def each(some: list[int], jobs: int, world: str) -> Iterator[tuple[Report, float]]:
    """Run these, in new processes."""
    with multiprocessing.get_context("spawn").Pool(jobs, seeds.quiet) as pool:
        chosen = [(seed, world) for seed in some]
        yield from pool.imap(seeds.timed, chosen, chunksize=4)


def show(result: dict[str, Any], console: Console) -> None:
    """Print the result as tables."""
    table = Table("scenario", "seeds", "s of CPU a seed", "wrong")
    wrong = Counter(one["kind"] for one in result["wrong"])
    for kind, count in sorted(result["kinds"].items()):
        table.add_row(
            kind, str(count), f"{result['cpu_s'][kind]:.3f}", str(wrong[kind])
        )
    console.print(table)
    faults = Table("injected", "times")
    for fault, times in result["injected"].items():
        faults.add_row(fault, str(times))
    console.print(faults)
    console.print(
        f"{result['seeds']} seeds, {result['repeated']} of them twice, in {result['wall_s']:.0f} s, "
        f"{result['seeds_per_s']:.1f} a second; {len(result['wrong'])} with a violated invariant",
        highlight=False,
    )


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m campaign", description=__doc__)
    parser.add_argument("seeds", help="one, which is told in full, or a range: 0-9999")
    parser.add_argument(
        "--kind", choices=sorted(seeds.KINDS), help="only these scenarios of the range"
    )
    parser.add_argument(
        "--world",
        default=LIGHTWEIGHT,
        help="uri of all drones in flight: sim:// (default), or sim://motors, for flights alone",
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    console = Console(stderr=chosen.json)
    first, _, last = chosen.seeds.partition("-")
    if not last:
        report = seeds.run(int(first), chosen.world)
        print(json.dumps(asdict(report), indent=None if chosen.json else 2))  # noqa: T201
        return int(bool(report.wrong))
    some = [
        seed
        for seed in range(int(first), int(last) + 1)
        if chosen.kind in (None, seeds.kind_of(seed))
        and (chosen.world == LIGHTWEIGHT or seeds.kind_of(seed) in flights.KINDS)
    ]
    result = campaign(some, chosen.jobs, console, chosen.world)
    if chosen.json:
        print(json.dumps(result))  # noqa: T201
    else:
        show(result, console)
    return int(not result["success"])


if __name__ == "__main__":
    sys.exit(main())
