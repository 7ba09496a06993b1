"""Which Python functions are called how often, a drone and tick, in steady flight in virtual time.

    python tests/bench/tick_calls.py                       # the bearing law on a lattice of thirty
    python tests/bench/tick_calls.py --drones 100 --rows 60
    python tests/bench/tick_calls.py --mission crossing --drones 30

The counts are those of tests/unit/flight/test_cost.py: they are the same on every machine.
"""

import argparse
import json
import os
import sys
from pathlib import Path

from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tick_cost import TickCost, measure_cost, measure_lattice

from crazychoir.guidance.mission import load_mission

PACKAGE_FOLDER = Path(__file__).resolve().parents[2] / "crazychoir"


def count(drones: int, mission: str | None) -> TickCost:
    """Count the cost of a drone, of the lattice or of a mission with its own swarm."""
    if mission is None:
        return measure_lattice(drones)
    flown = load_mission(mission)
    return measure_cost(flown.swarm(drones), flown)


def list_functions(cost: TickCost) -> list[dict[str, object]]:
    """Return the functions with their calls a drone and tick, the most frequent first."""
    found = sorted(cost.calls.items(), key=lambda item: -item[1])
    return [
        {
            "calls": round(calls, 4),
            "function": code.co_qualname,
            "place": f"{os.path.relpath(code.co_filename, PACKAGE_FOLDER.parent)}:{code.co_firstlineno}",
        }
        for code, calls in found
    ]


def show(found: dict[str, object], rows: int, console: Console) -> None:
    title = f"Python calls a drone and tick, {found['drones']} drones"
    table = Table("calls", title=title)
    for name in ("function", "place"):
        table.add_column(name, overflow="fold")
    for row in found["functions"][:rows]:
        table.add_row(f"{row['calls']:.3f}", row["function"], row["place"])
    console.print(table)
    console.print(
        f"{found['calls']:.2f} calls a drone and tick; to each drone that hears it "
        f"{found['messages']:.1f} messages, {found['bytes']:.0f} bytes a second; "
        f"{found['blocks']:.1f} blocks of memory a drone and second",
        highlight=False,
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drones", type=int, default=30)
    parser.add_argument("--mission", help="a mission with its own swarm")
    parser.add_argument("--rows", type=int, default=40, help="functions to show")
    parser.add_argument("--json", action="store_true")
    chosen = parser.parse_args()
    cost = count(chosen.drones, chosen.mission)
    found = {
        "drones": cost.drones,
        "calls": cost.calls_per_tick,
        "messages": cost.messages,
        "bytes": cost.bytes,
        "blocks": cost.blocks,
        "functions": list_functions(cost),
    }
    if chosen.json:
        print(json.dumps(found))
    else:
        show(found, chosen.rows, Console())


if __name__ == "__main__":
    main()
