"""Cost of one step of a simulated world alone, beside other simulators of quadrotors."""

import importlib
import importlib.util
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

from crazychoir.errors import Refused
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.lightweight.integrator import CFIntegrator
from crazychoir.simulation.motor_level.air import Wind
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.motor_level.motors import MotorConditions, MotorWorld
from crazychoir.types import Mat


@dataclass(frozen=True, slots=True)
class WorldBenchSettings:
    """Settings of the measurement of a simulated world alone."""

    drone_counts: tuple[int, ...] = (100, 1000)
    """Numbers of drones."""
    step_length: float = 0.01
    """Length of one step, s."""
    repeats: int = 7
    """Repetitions of a measurement; the median counts."""
    simulator_timeout: float = 300.0
    """Seconds that another simulator gets."""
    set_point_interval: int = 40
    """Steps after which set-points are sent again.

    This is before the firmware takes the silence for a lost radio.
    """


WORLD_BENCH = WorldBenchSettings()


BENCH_CONDITIONS = MotorConditions(wind=Wind((0.5, 0.0, 0.0), 0.2))

Step = Callable[[], object]
Engine = Callable[[int], Step]


def lattice_places(n: int) -> Mat:
    """Return n places in a lattice of 0.8 m, from 1 m above the floor: as dense as drones fly."""
    side = int(np.ceil(np.cbrt(n)))
    lattice = np.stack(
        np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1
    ).reshape(-1, 3)[:n]
    return np.asarray(0.8 * lattice + [0.0, 0.0, 1.0])


def lightweight_step(n: int) -> Step:
    """Return the step of the paper's model."""
    return CFIntegrator(range(n), lattice_places(n)).step


def motor_level_step(n: int) -> Step:
    """Return the step of the whole motor level, with wind, gusts and constant motor commands."""
    return MotorWorld(range(n), lattice_places(n), conditions=BENCH_CONDITIONS).step


def crazyflies_step(n: int) -> Step:
    """Return the step of the motor level with the firmware on board, flying body rates."""
    return _hovering_step(
        CrazyflieWorld(range(n), lattice_places(n), conditions=BENCH_CONDITIONS), n
    )


def mujoco_crazyflies_step(n: int) -> Step:
    """Return the step of the same drones in MuJoCo, with contacts.

    Raises ModuleNotFoundError if MuJoCo is not installed.
    """
    importlib.import_module("mujoco")
    from crazychoir.simulation.mujoco.world import MujocoWorld

    return _hovering_step(
        MujocoWorld(range(n), lattice_places(n), conditions=BENCH_CONDITIONS), n
    )


def _hovering_step(world: CrazyflieWorld, n: int) -> Step:
    """Return the step of a world with armed drones that get their weight as thrust."""
    steps = 0
    links = [world.link(i, "fpqr") for i in range(n)]
    for link in links:
        link.onboard.arm()

    def step() -> None:
        nonlocal steps
        if steps % WORLD_BENCH.set_point_interval == 0:
            for link in links:
                link.onboard.setpoints.fpqr(
                    0.0 if steps == 0 else CRAZYFLIE_21.weight, 0.0, 0.0, 0.0
                )
        steps += 1
        world.step()

    for _ in range(WORLD_BENCH.set_point_interval + 1):
        step()
    return step


def mujoco_bodies_step(n: int) -> Step:
    """Return the step of n free bodies in one model of MuJoCo, at 1 kHz, without contacts.

    Wrenches are held for 10 ms. Contacts are off because nothing touches.
    """
    mujoco: Any = importlib.import_module("mujoco")
    spec = mujoco.MjSpec()
    spec.option.timestep = 0.001
    spec.option.gravity = [0, 0, -STANDARD_GRAVITY]
    for p in lattice_places(n):
        body = spec.worldbody.add_body(pos=p)
        body.add_freejoint()
        body.mass = CRAZYFLIE_21.mass
        body.inertia = CRAZYFLIE_21.inertia
        body.explicitinertial = True
        body.ipos = [0, 0, 0]
        body.iquat = [1, 0, 0, 0]
    model = spec.compile()
    data = mujoco.MjData(model)

    def step() -> None:
        data.xfrc_applied[1:, 2] = CRAZYFLIE_21.weight
        mujoco.mj_step(model, data, nstep=10)

    return step


def measure_crazyflow(n: int, calls: int) -> float:
    """Return the s of a step of crazyflow, in a process of its own.

    Raises ModuleNotFoundError if it is not installed.
    """
    if importlib.util.find_spec("crazyflow") is None:
        raise ModuleNotFoundError("crazyflow")
    program = Path(__file__).with_name("peers") / "crazyflow_peer.py"
    words = [sys.executable, str(program), *map(str, (n, calls, WORLD_BENCH.repeats))]
    done = subprocess.run(
        words,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=WORLD_BENCH.simulator_timeout,
        check=False,
    )
    if done.returncode:
        raise Refused(
            "crazyflow", (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
        )
    return float(json.loads(done.stdout.splitlines()[-1])["seconds"])


WORLD_ENGINES: dict[str, Engine] = {
    "lightweight": lightweight_step,
    "motor level": motor_level_step,
    "  with firmware": crazyflies_step,
    "    in MuJoCo, contacts": mujoco_crazyflies_step,
    "MuJoCo, free bodies": mujoco_bodies_step,
}
CRAZYFLOW_ROW = "crazyflow"


def run(
    counts: tuple[int, ...] = WORLD_BENCH.drone_counts,
    say: Callable[[str], None] = lambda line: None,
) -> list[dict[str, Any]]:
    """Return rows {engine, drones, real_time_factor, ns_per_drone_ms} of medians.

    The note of a row says if the simulator is not installed.
    """
    return [
        _row(name, n, say) for n in counts for name in (*WORLD_ENGINES, CRAZYFLOW_ROW)
    ]


def _row(name: str, n: int, say: Callable[[str], None]) -> dict[str, Any]:
    say(f"{name.strip()}: {n} drones")
    row: dict[str, Any] = {
        "engine": name,
        "drones": n,
        "real_time_factor": None,
        "ns_per_drone_ms": None,
        "note": "",
    }
    calls = max(5, 1000 // n)
    try:
        took = (
            measure_crazyflow(n, calls)
            if name == CRAZYFLOW_ROW
            else _measure_step(WORLD_ENGINES[name](n), calls)
        )
    except ModuleNotFoundError:
        return row | {"note": "not installed"}
    return row | {
        "real_time_factor": WORLD_BENCH.step_length / took,
        "ns_per_drone_ms": took / n / (1e3 * WORLD_BENCH.step_length) * 1e9,
    }


def _measure_step(step: Step, calls: int) -> float:
    """Return the s of one call: the median over repeats, each with `calls` calls."""
    took = []
    for _ in range(WORLD_BENCH.repeats):
        start = time.perf_counter()
        for _ in range(calls):
            step()
        took.append((time.perf_counter() - start) / calls)
    return statistics.median(took)


def table(rows: list[dict[str, Any]]) -> Table:
    """Return the rows as a table."""
    shown = Table(title="The step of a world alone, one core")
    for name in ("engine", "drones", "times real time", "ns/drone/ms"):
        shown.add_column(name, justify="left" if name == "engine" else "right")
    for row in rows:
        figures = [row["note"], ""]
        if not row["note"]:
            figures = [
                f"{row['real_time_factor']:.1f}",
                f"{row['ns_per_drone_ms']:.0f}",
            ]
        shown.add_row(row["engine"], str(row["drones"]), *figures)
    return shown
