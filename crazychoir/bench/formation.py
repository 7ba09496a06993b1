"""Times in which formations form up at motor level: the worst of many seeds counts.

The time begins with the law. It ends when every drone stays within 1 cm of its place, measured
by the true positions.
"""

from collections.abc import Callable
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any

from rich import box
from rich.table import Table

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.mission import Mission, load_mission
from crazychoir.launch.flight import fly_fast

LOSSY_NETWORK = {"loss": 0.2, "delay": 0.02}
"""Network of the lossy cases: share of lost messages and delay in s."""
GRID_GAINS = {"kp": 2.0, "kv": 2.5}
"""Gains of the paper's law on the grid, where drones have up to eight neighbours: 1/s2 and 1/s."""
START_SCATTER: dict[int, list[float]] = {4: [1.0, 1.0, 1.0], 30: [0.2, 0.2, 0.2]}
"""Largest displacement of a start, m an axis, by number of drones."""
FORMATION_FLIGHT_TABLE = {
    "takeoff_height": 1.2,
    "speed_limit": 3.0,
    "acceleration_limit": 4.0,
    "landing_speed": 1.0,
}
"""The table [flight] of the swarm: m, m/s, m/s2."""


@dataclass(frozen=True)
class FormationCase:
    """One row: a team, its law and its network."""

    drones: int
    """Number of drones."""
    law: str
    """Name of the law."""
    network: str
    """"perfect" or "lossy"."""
    limit: float
    """Seconds that the worst seed may need."""

    def config(self, mission: Mission, seed: int) -> SwarmConfig:
        """Return the mission's own swarm, of perfect Crazyflies with motors, scattered by this seed.

        What is measured is the law: typical drones never come within its centimetre, see guidance/README.md.
        """
        config = mission.swarm(self.drones)
        given: dict[str, Any] = {"scatter": START_SCATTER[self.drones]}
        if self.law == "paper" and self.drones == 30:
            given |= GRID_GAINS
        drones = [
            {
                "id": d.id,
                "home": d.home,
                "leader": d.leader,
                "uri": "sim://motors",
                "platform": "cf21",
            }
            for d in config.drones
        ]
        options = {
            **config.mission_options,
            **given,
            "law": self.law,
            "duration": 6.0 if self.law == "normalised" else 20.0,
        }
        network = LOSSY_NETWORK if self.network == "lossy" else {}
        return mission.scatter(
            config.replace(
                drones=drones,
                motors={"imperfections": 0.0},
                mocap={"tilt_spread": 0.0},
                seed=seed,
                flight=FORMATION_FLIGHT_TABLE,
                mission_options=options,
                network=network,
                plant={"command_delay": 0.02},
                fence={"min": [-3, -3, 0], "max": [6, 6, 4]},
            )
        )


FORMATION_CASES = (
    FormationCase(4, "paper", "perfect", 16.0),
    FormationCase(4, "normalised", "perfect", 3.0),
    FormationCase(4, "normalised", "lossy", 3.0),
    FormationCase(30, "paper", "perfect", 16.0),
    FormationCase(30, "normalised", "perfect", 4.0),
    FormationCase(30, "normalised", "lossy", 4.0),
)


def measure_forming_times(
    case: FormationCase, seeds: range, say: Callable[[str], None] = lambda line: None
) -> list[float | None]:
    """Return the s to 1 cm of each seed; None if it was not reached or the flight failed."""
    mission = load_mission("bearing_formation")
    found = []
    for seed in seeds:
        result = fly_fast(case.config(mission, seed), mission)
        found.append(result["settling_s"] if result["success"] else None)
        say(
            f"{case.drones} drones, {case.law}, {case.network}: seed {seed}: {found[-1]} s"
        )
    return found


def run(
    seeds: range,
    cases: tuple[FormationCase, ...] = FORMATION_CASES,
    say: Callable[[str], None] = lambda line: None,
) -> dict[str, Any]:
    """Return the worst and the median time of each case."""
    return {
        "seeds": len(seeds),
        "rows": [
            summary(case, measure_forming_times(case, seeds, say)) for case in cases
        ],
    }


def summary(case: FormationCase, found: list[float | None]) -> dict[str, Any]:
    """Return the row of a case.

    found: s of each seed, None if it did not settle; worst_s is then None
    """
    settled = [s for s in found if s is not None]
    worst = max(settled) if len(settled) == len(found) else None
    reached = worst is not None and worst <= case.limit
    return {
        **asdict(case),
        "worst_s": worst,
        "median_s": median(settled) if settled else None,
        "failed": len(found) - len(settled),
        "reached": reached,
    }


def table(result: dict[str, Any]) -> Table:
    """Return the result as a table."""
    shown = Table(
        title=f"time to 1 cm, motor level, {result['seeds']} seeds", box=box.SIMPLE_HEAD
    )
    for name in (
        "drones",
        "law",
        "network",
        "worst s",
        "median s",
        "allowed s",
        "failed",
    ):
        shown.add_column(
            name, justify="left" if name in ("law", "network") else "right"
        )
    for row in result["rows"]:
        figures = [
            f"{row[key]:.2f}" if row[key] is not None else "-"
            for key in ("worst_s", "median_s", "limit")
        ]
        shown.add_row(
            str(row["drones"]), row["law"], row["network"], *figures, str(row["failed"])
        )
    return shown
