"""Log variables of simulated drones under the firmware's names, published when requested."""

import difflib
from collections.abc import Iterable, Mapping

from crazychoir.bus.port import Port
from crazychoir.bus.topics import DRONE_TOPICS
from crazychoir.config.checks import WORLD_URIS
from crazychoir.errors import ConfigError
from crazychoir.simulation.common.logs import LIGHTWEIGHT_LOG_READERS
from crazychoir.simulation.common.world import World

LOG_PERIOD_STEP = 0.01  # s: periods of the firmware's log blocks are multiples of this
LONGEST_LOG_PERIOD = 2.55  # s: longest period of a log block


def list_log_names(uri: str) -> Iterable[str] | None:
    """Return the log variables of drones with this uri; None if only their world knows them."""
    if uri == WORLD_URIS.motor_level:
        from crazychoir.simulation.onboard.logs import (
            FIRMWARE_LOG_READERS,
        )  # kernels that a lightweight world does not need

        return FIRMWARE_LOG_READERS
    return LIGHTWEIGHT_LOG_READERS if uri == WORLD_URIS.lightweight else None


def check_log_names(names: Iterable[str], known: Iterable[str], where: str) -> None:
    """Raise ConfigError for an unknown variable name; the error lists the nearest known names."""
    there = tuple(known)
    for name in names:
        if name not in there:
            near = (
                difflib.get_close_matches(name, there, n=3, cutoff=0.4)
                or sorted(there)[:3]
            )
            allowed = (
                f"the {len(there)} variables that it has, such as {', '.join(near)}"
            )
            do = (
                f'With uri = "{WORLD_URIS.motor_level}" it has those of the firmware.'
                if there == tuple(LIGHTWEIGHT_LOG_READERS)
                else ""
            )
            raise ConfigError(
                where,
                name,
                allowed if there else "none: its world says no log variables",
                do,
            )


def check_log_period(period: float, where: str) -> None:
    """Raise ConfigError for a period that no log block can have."""
    ticks = period / LOG_PERIOD_STEP
    if not (
        LOG_PERIOD_STEP <= period <= LONGEST_LOG_PERIOD
        and abs(ticks - round(ticks)) < 1e-6
    ):
        allowed = (
            f"multiples of {LOG_PERIOD_STEP:g} s up to {LONGEST_LOG_PERIOD:g} s, as the "
            "firmware's log blocks have"
        )
        raise ConfigError(where, period, allowed)


def round_log_period(rate: float) -> float:
    """Return the period in s of a log block with this rate in Hz."""
    return round(1.0 / (rate * LOG_PERIOD_STEP)) * LOG_PERIOD_STEP


class Telemetry:
    """The requested log variables of the drones of one world.

    Each message of a drone is {name: [value, age in s]} with all its requested variables. A message
    is sent when at least one variable is due.
    """

    def __init__(self, world: World, ports: Mapping[int, Port]) -> None:
        self.world = world
        self.ports = ports
        self.every: dict[int, dict[str, int]] = {}
        """Steps of the world from one value to the next, by drone and name."""
        self._found: dict[int, dict[str, tuple[float, int]]] = {}

    def ask(self, i: int, names: Iterable[str], period: float) -> None:
        """Publish these variables of drone i every `period` s from now on.

        If a variable is requested several times, the shortest period counts.
        Raises ConfigError for an unknown variable or an impossible period.
        """
        where = f"drone {i}: log"
        wanted = tuple(names)
        check_log_names(wanted, list_log_names_of_world(self.world), where)
        check_log_period(period, where)
        steps = max(1, round(period / self.world.dt))
        every = self.every.setdefault(i, {})
        for name in wanted:
            every[name] = min(steps, every.get(name, steps))

    def step(self, tick: int, late: float) -> None:
        """Publish the variables that are due at this step.

        late: s: how much older the world is than now
        """
        for i, every in self.every.items():
            due = [name for name, steps in every.items() if tick % steps == 0]
            if not due:
                continue
            found = self._found.setdefault(i, {})
            found.update({name: (self.world.log(i, name), tick) for name in due})  # type: ignore[attr-defined]
            dt = self.world.dt
            self.ports[i].publish(
                DRONE_TOPICS.telemetry,
                {n: [x, (tick - at) * dt] for n, (x, at) in found.items()},
                late,
            )


def list_log_names_of_world(world: World) -> Iterable[str]:
    """Return the log variables of the drones of a world; none if its engine has no log.

    An engine with a log has `variables`, the names, and `log(i, name)`, the value of drone i now.
    """
    names: Iterable[str] = getattr(world, "variables", ())
    return names
