"""How long one ms of one drone's firmware takes, a controller a line: process time, the best of some runs."""

import time

import numpy as np

from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.motor_level.motor_control import MotorCtrlFPQR
from crazychoir.simulation.onboard import loop
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.record import make_fleet
from crazychoir.types import FPQR

DRONES, MS, RUNS = 100, 100, 20


def main():
    rows = make_fleet(DRONES, CRAZYFLIE_21)
    drones = [Onboard(CRAZYFLIE_21, rows, k) for k in range(DRONES)]
    loop.run(rows, 200.0, 0.0, 0.0, 0.0, 0.0, 0.0, STANDARD_GRAVITY)
    rates = [MotorCtrlFPQR(drone) for drone in drones]
    command = FPQR(np.array([0.3, 0.1, 0.2, 0.1]))
    measure("rates", rows, lambda: [link.send(command) for link in rates])
    for name in ("pid", "mellinger", "lee"):
        for drone in drones:
            drone.set("stabilizer.controller", name)
        measure(
            f"position, {name}",
            rows,
            lambda: [
                drone.setpoints.position((0.0, 0.0, 1.0), 0.0) for drone in drones
            ],
        )


def measure(name, rows, send):
    best = float("inf")
    for _ in range(RUNS):
        rows["vbat"], rows["vbat_low"] = 4.0, 4.01
        send()
        start = time.process_time()
        loop.run(rows, float(MS), 0.01, 0.02, 0.0, 0.1, 0.0, STANDARD_GRAVITY)
        best = min(best, time.process_time() - start)
    print(f"{name:20} {best / DRONES / MS * 1e9:6.1f} ns a ms and drone")


if __name__ == "__main__":
    main()
