"""What the online mission needs beside its guidance: options, swarm, checks, report, picture."""

from typing import Any

import numpy as np

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError
from crazychoir.guidance.delivery.delivery_picture import DeliveryMap, draw_flown_ways
from crazychoir.guidance.delivery.online_delivery import OnlineDeliveryOptions
from crazychoir.guidance.delivery.online_report import report_fates
from crazychoir.guidance.delivery.online_setup import (
    FLIGHT_ABILITIES,
    DeliveryOptions,
    require_servable_places,
    require_used_keys,
)
from crazychoir.guidance.delivery.online_tasks import (
    ROOM_SIDE,
    get_instance,
    list_appearances,
    list_events,
    list_known_tasks,
    read_options,
)
from crazychoir.guidance.delivery.pickup_setup import require_flyable_features
from crazychoir.guidance.delivery.site import DeliverySite
from crazychoir.guidance.mission_report import Results
from crazychoir.guidance.tasks.task_book import Task
from crazychoir.guidance.tasks.task_source import TaskEvent
from crazychoir.guidance.tasks.team_mission import project_to_plane
from crazychoir.routing.instance.instance import Instance

ONLINE_FLIGHT_TABLE = {
    "takeoff_height": 0.4,
    "speed_limit": 1.5,
    "acceleration_limit": 3.0,
    "landing_speed": 0.6,
}
"""[flight] of this mission's own swarm."""
DOCK_DISTANCE = 0.8
"""m: distance of the drones' homes from the square of the goods, on two of its sides."""


class OnlineHooks:
    """The hooks of a mission in which tasks and drones come and go."""

    def swarm(self, drones: int | None = None) -> SwarmConfig:
        """Return the default swarm: drones along two sides of a room.

        Each drone has four neighbours in the graph. The seed of the swarm also decides the tasks.

        drones: number of drones; None for ten
        """
        n = 10 if drones is None else drones
        rows = [(k // 2, k % 2) for k in range(n)]
        gap = ROOM_SIDE / max(1, (n - 1) // 2)
        homes = [
            [
                round(gap * column, 3),
                -DOCK_DISTANCE if side == 0 else ROOM_SIDE + DOCK_DISTANCE,
                0.0,
            ]
            for column, side in rows
        ]
        return SwarmConfig.of(
            {
                "name": "online",
                "mission": "online_delivery",
                "drones": [{"id": i, "home": home} for i, home in enumerate(homes)],
                "graph": "k-regular:4" if n > 5 else "complete",
                "flight": ONLINE_FLIGHT_TABLE,
                "fence": {
                    "min": [-2.0, -DOCK_DISTANCE - 1.0, 0.0],
                    "max": [ROOM_SIDE + 2.0, ROOM_SIDE + DOCK_DISTANCE + 1.0, 3.0],
                },
                "lost_after": 2.0,
            }
        )

    def given(self, config: SwarmConfig) -> DeliveryOptions:
        """Return [mission_options]. Raises ConfigError with the key that is wrong."""
        return read_options(config)

    def instance(self, config: SwarmConfig) -> Instance:
        """Return the instance that the options name, or an instance drawn from the seed."""
        return get_instance(config)

    def known(self, config: SwarmConfig) -> list[Task]:
        """Return the tasks of the instance: all robots know them at the start."""
        return list_known_tasks(config)

    def events(self, config: SwarmConfig) -> list[TaskEvent]:
        """Return the tasks that appear, and the cancellations."""
        return list_events(config)

    def options(self, config: SwarmConfig) -> OnlineDeliveryOptions:
        """Return the options that all robots have in common."""
        chosen = self.given(config)
        last = max((event.t for event in self.events(config)), default=0.0)
        return OnlineDeliveryOptions(
            DeliverySite(config, chosen.clearance, self.instance(config)),
            service_time=chosen.service_time,
            recover=chosen.recover,
            until=max(last, chosen.until),
            method=chosen.method,
        )

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check that the drones stand where the instance says, and that each task can be served."""
        chosen = self.given(config)
        where = f"swarm {config.name}: mission_options"
        require_used_keys(config.mission_options, where)
        problem = self.instance(config)
        require_flyable_features(problem, f"{where}.instance", (), FLIGHT_ABILITIES)
        if config.ids != tuple(range(problem.robots)):
            raise ConfigError(
                f"swarm {config.name}: drones",
                list(config.ids),
                f"0 to {problem.robots - 1}",
            )
        if not config.graph().is_undirected:
            raise ConfigError(
                f"swarm {config.name}: graph", "a directed graph", "an undirected one"
            )
        for i, home in enumerate(problem.home):
            stands = np.array(config.drone(i).home[:2])
            if np.linalg.norm(stands - home[:2]) > 0.05:
                raise ConfigError(
                    f"swarm {config.name}: drones[{i}].home",
                    stands.tolist(),
                    f"{home.tolist()}",
                )
        site = self.options(config).site
        appearing = list_appearances(config)
        require_servable_places(site, self.known(config), appearing, chosen, where)
        return []

    def report(self, config: SwarmConfig, results: Results) -> dict[str, Any]:
        """Report what has become of each task, and why a task was not served."""
        return report_fates(results)

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the flown paths, the tasks and the lost drones."""
        told = [*self.known(config), *(event.task for event in self.events(config))]
        places = {
            "pickup": {task.id: task.pickup for task in told},
            "delivery": {task.id: task.delivery for task in told},
        }
        for result in results.values():
            for stop in result.get("served", []):  # also tasks that operators added
                places[stop["kind"]].setdefault(
                    stop["task"], project_to_plane(stop["place"])
                )
        found = self.report(config, results)
        lost = [i for i in config.ids if not results.get(i, {}).get("success")]
        flown = DeliveryMap(
            homes={drone.id: project_to_plane(drone.home) for drone in config.drones},
            ways={
                i: np.array(r["way"], float)
                for i, r in sorted(results.items())
                if len(r.get("way", [])) > 1
            },
            pickups=places["pickup"],
            deliveries=places["delivery"],
            undelivered=[int(j) for j in found["undone"]],
            lost=lost,
        )
        counts = found["tasks"].items()
        title = ", ".join(f"{name}: {number}" for name, number in counts)
        draw_flown_ways(path, flown, title)
