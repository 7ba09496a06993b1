"""What a second of the motor-level world costs at 1, 100 and 1000 drones, beside MuJoCo and crazyflow.

python tests/bench/motor_world.py prints, a row an engine and a number of drones, ns a drone and millisecond, and how
many times faster than real time one core computes it: the median of seven repetitions.
"""

import statistics
import time
from collections.abc import Callable

import numpy as np

from crazychoir.math3d import GRAVITY
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.air import Wind
from crazychoir.simulation.crazyflies import CrazyflieWorld
from crazychoir.simulation.integrator import CFIntegrator
from crazychoir.simulation.motors import MotorWorld

COUNTS = (1, 100, 1000)
TICK = 0.01  # s


def seconds(call: Callable[[], object], n: int) -> float:
    """Median over seven repetitions of n calls, s a call."""
    call()
    took = []
    for _ in range(7):
        start = time.perf_counter()
        for _ in range(n):
            call()
        took.append((time.perf_counter() - start) / n)
    return statistics.median(took)


def places(n: int) -> np.ndarray:
    """n places in a lattice 0.8 m wide, 1 m above the floor and higher: as dense as drones fly."""
    side = int(np.ceil(np.cbrt(n)))
    lattice = np.stack(np.meshgrid(*[np.arange(side)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)[:n]
    return 0.8 * lattice + [0.0, 0.0, 1.0]


def motor_level(n: int) -> Callable[[], object]:
    """Everything of the default model, and wind with gusts; motor commands are held."""
    return MotorWorld(range(n), places(n), wind=Wind((0.5, 0.0, 0.0), 0.2)).step


def with_firmware(n: int) -> Callable[[], object]:
    """The same with the firmware on board of every drone, all hovering 1 m above the floor."""
    side = int(np.ceil(np.sqrt(n)))
    floor = 0.8 * np.array([(k % side, k // side, 0.0) for k in range(n)])
    world = CrazyflieWorld(range(n), floor, wind=Wind((0.3, 0.0, 0.0), 0.1))
    for tick in range(200):
        world.step()
        for i, drone in world.onboard.items():
            drone.external_pose(world.states[i, :3].copy(), world.states[i, 6:10].copy())
            if tick == 50:
                drone.arm()
            if tick == 60 and drone.take_off(1.0, 1.0) != 0:
                raise RuntimeError(f"drone {i} does not take off: {drone.state}")
    return world.step


def lightweight(n: int) -> Callable[[], object]:
    """The paper's model: one step of 10 ms."""
    return CFIntegrator(range(n), places(n)).step


def in_mujoco(n: int) -> Callable[[], object]:
    """n free bodies in one model, 1 kHz, wrenches held for 10 ms; its contacts are off, as nothing touches."""
    import mujoco

    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = 0.001, [0, 0, -GRAVITY]
    for p in places(n):
        body = spec.worldbody.add_body(pos=p)
        body.add_freejoint()
        body.mass, body.inertia, body.explicitinertial = CRAZYFLIE_21.mass, CRAZYFLIE_21.inertia, True
        body.ipos, body.iquat = [0, 0, 0], [1, 0, 0, 0]
    model = spec.compile()
    data = mujoco.MjData(model)

    def step() -> None:
        data.xfrc_applied[1:, 2] = CRAZYFLIE_21.weight
        mujoco.mj_step(model, data, nstep=10)

    return step


def in_crazyflow(n: int) -> Callable[[], object]:
    """crazyflow's default model and control, 500 Hz."""
    from crazyflow.sim import Sim

    sim = Sim(n_worlds=1, n_drones=n)
    sim.reset()
    return lambda: (sim.step(max(1, round(TICK * sim.freq))), sim.data.states.pos.block_until_ready())


ENGINES = {
    "lightweight, 100 Hz": lightweight,
    "motor level, 1 kHz": motor_level,
    "  with firmware": with_firmware,
    "MuJoCo, 1 kHz": in_mujoco,
    "crazyflow, 500 Hz": in_crazyflow,
}


def row(name: str, engine: Callable[[int], Callable[[], object]], n: int) -> str:
    """One line of the table."""
    try:
        step = engine(n)
    except ModuleNotFoundError as missing:
        return f"{name:22} {n:5}  not installed: {missing.name}"
    took = seconds(step, max(5, 1000 // n))
    return f"{name:22} {n:5}  {took / n / 10.0 * 1e9:9.1f} ns  {TICK / took:9.1f} x real time"


if __name__ == "__main__":
    for name, engine in ENGINES.items():
        for n in COUNTS:
            print(row(name, engine, n), flush=True)
