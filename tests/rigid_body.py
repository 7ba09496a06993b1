"""A body with four motors for tests of the firmware on board: RK4 at 1 ms, first-order motors, no air, a floor at 0."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from crazychoir.numerics.kernels import kernel, memory
from crazychoir.numerics.math3d import STANDARD_GRAVITY
from crazychoir.platforms import CRAZYFLIE_21
from crazychoir.simulation.onboard.loop import stabilize
from crazychoir.simulation.onboard.onboard import Onboard
from crazychoir.simulation.onboard.record import CONTROLLER_KINDS, rows, whole


@kernel()
def slope(s, f, m, out):
    thrust, a, k = f[0] + f[1] + f[2] + f[3], m[4], m[5]
    torque = (
        a * (-f[0] - f[1] + f[2] + f[3]),
        a * (-f[0] + f[1] + f[2] - f[3]),
        k * (-f[0] + f[1] - f[2] + f[3]),
    )
    x, y, z, w, p, q, r = s[6], s[7], s[8], s[9], s[10], s[11], s[12]
    acceleration = thrust / m[0]
    out[0], out[1], out[2] = s[3], s[4], s[5]
    out[3] = acceleration * 2.0 * (x * z + y * w)
    out[4] = acceleration * 2.0 * (y * z - x * w)
    out[5] = acceleration * (1.0 - 2.0 * (x * x + y * y)) - STANDARD_GRAVITY
    out[6] = 0.5 * (w * p + y * r - z * q)
    out[7] = 0.5 * (w * q + z * p - x * r)
    out[8] = 0.5 * (w * r + x * q - y * p)
    out[9] = 0.5 * (-x * p - y * q - z * r)
    out[10] = (torque[0] - (m[3] - m[2]) * q * r) / m[1]
    out[11] = (torque[1] - (m[1] - m[3]) * r * p) / m[2]
    out[12] = (torque[2] - (m[2] - m[1]) * p * q) / m[3]


@kernel(rows, memory, memory, memory, memory, whole)
def advance(fleet, s, f, force, m, ms):
    k, h = np.zeros((4, 13)), 0.001
    for _ in range(ms):
        fw = fleet[0]
        stabilize(fw, s[10], s[11], s[12], force[0], force[1], force[2])
        for i in range(4):
            f[i] += (1.0 - math.exp(-h / m[7])) * (fw.motors[i] * m[6] - f[i])
        slope(s, f, m, k[0])
        slope(s + h / 2 * k[0], f, m, k[1])
        slope(s + h / 2 * k[1], f, m, k[2])
        slope(s + h * k[2], f, m, k[3])
        s += h / 6 * (k[0] + 2 * k[1] + 2 * k[2] + k[3])
        s[6:10] /= math.sqrt(np.sum(s[6:10] ** 2))
        thrust = np.sum(f)
        force[2] = thrust / m[0]
        if s[2] <= 0.0 and s[5] <= 0.0 and thrust < m[0] * STANDARD_GRAVITY:
            n = math.sqrt(s[8] ** 2 + s[9] ** 2)
            s[2:8], s[8:10], s[10:13], force[2] = (
                0.0,
                s[8:10] / n,
                0.0,
                STANDARD_GRAVITY,
            )


class Body:
    """state: p, v, quaternion, w; the firmware sees perfect sensors, and poses at 100 Hz where `poses`."""

    def __init__(self, platform=CRAZYFLIE_21, p=(0.0, 0.0, 0.0), yaw=0.0, poses=True):
        self.platform, self.poses = platform, poses
        self.onboard = Onboard(platform)
        self.onboard.place(p, yaw)
        self.s = np.array(
            [*p, 0, 0, 0, 0, 0, np.sin(yaw / 2), np.cos(yaw / 2), 0, 0, 0], dtype=float
        )
        self.f = np.zeros(4)
        self.force = np.array([0.0, 0.0, STANDARD_GRAVITY])
        f, r = platform.firmware, platform.rotor
        self.figures = np.array(
            [
                platform.mass,
                *platform.inertia,
                platform.arm,
                f.thrust_to_torque,
                f.thrust_max,
                r.lag,
            ]
        )

    @property
    def p(self):
        return self.s[0:3]

    @property
    def v(self):
        return self.s[3:6]

    @property
    def w(self):
        return self.s[10:13]

    @property
    def angles(self):
        """Roll, pitch (nose down positive), yaw rad."""
        yaw, pitch, roll = Rotation.from_quat(self.s[6:10]).as_euler("ZYX")
        return np.array([roll, pitch, yaw])

    def step(self, ms=1):
        """Some ms at once; one by one under a user's controller."""
        advance(self.onboard.rows, self.s, self.f, self.force, self.figures, ms)
        if self.onboard.record["law_due"]:
            self.onboard.obey_law()

    def fly(self, seconds, send=None, every=20):
        """Some seconds; send() each `every` ms."""
        block = (
            1
            if self.onboard.record["controller"] == CONTROLLER_KINDS.out_of_tree
            else 10
        )
        for k in range(0, round(1000 * seconds), block):
            if send is not None and k % every == 0:
                send()
            if self.poses and k % 10 == 0:
                self.onboard.external_pose(self.s[0:3], self.s[6:10])
            self.step(block)
        return self

    def hovering(self, height=1.0):
        """In the air, level, with the motors at hover."""
        self.s[2] = height
        self.f[:] = self.platform.weight / 4.0
        self.onboard.place(self.s[0:3], self.angles[2])
        return self
