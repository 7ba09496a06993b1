"""Control of a unicycle: the velocity of a point ahead of its axle, or its pose."""

import math
from dataclasses import dataclass

import numpy as np

from crazychoir.numerics.math3d import clip, saturate, wrap_angle, yaw_of
from crazychoir.types import State, Vec


@dataclass(frozen=True, slots=True)
class UnicycleLimits:
    """Limits that decide whether a unicycle follows a velocity, drives to a pose, or stands."""

    standing_speed: float = 1e-3
    """Speed in m/s of a reference below which it is a pose to come to."""
    reached_distance: float = 0.02
    """Distance in m from a pose at which the pose is reached."""
    departed_distance: float = 0.10
    """Distance in m from a reached pose from which on the robot drives to it again."""


UNICYCLE_LIMITS = UnicycleLimits()


class UnicycleVelocityCtrl:
    """Computes (v, w) for a velocity u of the point q = p + l (cos psi, sin psi).

        v = u_x cos psi + u_y sin psi,   w = (u_y cos psi - u_x sin psi) / l

    The point q obeys u exactly: q' = u. The axle itself may be steered by u(p) too. With
    u = k (g - p) and the heading h, the distance |p - g| never grows:

        (p - g)'p' = -k ((p - g)'h)^2

    The axle turns until |p - g| falls.

    ahead: m, l
    v_max: m/s
    w_max: rad/s. Both limits cut (v, w) by one factor, so that the path stays the same.
    """

    def __init__(
        self, ahead: float = 0.1, v_max: float = 1.0, w_max: float = 4.0
    ) -> None:
        self.ahead = ahead
        self.v_max = v_max
        self.w_max = w_max

    def input(self, yaw: float, u: Vec) -> Vec:
        """Return (2,): v m/s, w rad/s.

        yaw: rad
        u: (2,) m/s, world
        """
        c = math.cos(yaw)
        s = math.sin(yaw)
        v = float(u[0] * c + u[1] * s)
        w = float(u[1] * c - u[0] * s) / self.ahead
        cut = max(1.0, abs(v) / self.v_max, abs(w) / self.w_max)
        return np.array([v / cut, w / cut])


class UnicyclePoseCtrl:
    """A smooth path to a place and a heading, forwards only.

        r, alpha: distance and direction of the goal,  delta = psi - alpha,  theta = psi_g - alpha
        r' = -v cos delta,  theta' = (v / r) sin delta,  delta' = (v / r) sin delta + w
        w = -(v / r) [ k2 (delta - delta*) + (1 + k1 / (1 + (k1 theta)^2)) sin delta ]
        delta* = atan(-k1 theta)
        v = min(v_max / (1 + beta |kappa|^lambda), k3 r),  kappa = w / v

    delta* leads theta to zero with r, and delta - delta* decays as exp(-k2 s) over the path s / r.

    v_max: m/s
    k1: 1
    k2: 1
    k3: 1/s
    beta: m^lambda
    exponent: 1, lambda
    w_max: rad/s
    Source: Park & Kuipers 2011, A smooth control law for graceful motion of differential wheeled
        mobile robots in 2D environment, IEEE ICRA, 4896-4902.
    """

    def __init__(
        self,
        v_max: float = 1.0,
        k1: float = 2.0,
        k2: float = 3.0,
        k3: float = 1.5,
        beta: float = 0.1,
        exponent: float = 2.0,
        w_max: float = 4.0,
    ) -> None:
        self.v_max = v_max
        self.k1 = k1
        self.k2 = k2
        self.k3 = k3
        self.beta = beta
        self.exponent = exponent
        self.w_max = w_max

    def curvature(self, r: float, theta: float, delta: float) -> float:
        """Return kappa, 1/m."""
        lead = math.atan(-self.k1 * theta)
        bend = 1.0 + self.k1 / (1.0 + (self.k1 * theta) ** 2)
        return -(self.k2 * (delta - lead) + bend * math.sin(delta)) / r

    def input(self, p: Vec, yaw: float, goal: Vec, goal_yaw: float) -> Vec:
        """Return (2,): v m/s, w rad/s; not defined at the goal.

        p: (2,) m
        yaw: rad
        goal: (2,) m
        goal_yaw: rad
        """
        x, y = (goal - p).tolist()
        r = math.hypot(x, y)
        alpha = math.atan2(y, x)
        kappa = self.curvature(r, wrap_angle(goal_yaw - alpha), wrap_angle(yaw - alpha))
        v = min(
            self.v_max / (1.0 + self.beta * abs(kappa) ** self.exponent), self.k3 * r
        )
        return np.array([v, clip(kappa * v, -self.w_max, self.w_max)])


class UnicycleCtrl:
    """Follows a moving reference by a velocity, and drives to the pose of a standing reference.

        moving: u = v_d + k (p_d - p),  |u| <= v_max, to UnicycleVelocityCtrl
        standing: UnicyclePoseCtrl

    The robot stops when it is within UNICYCLE_LIMITS.reached_distance of a pose. It drives again when
    it is farther than UNICYCLE_LIMITS.departed_distance from the pose.

    k: 1/s
    v_max: m/s
    """

    def __init__(self, k: float = 1.5, v_max: float = 1.0) -> None:
        self.k = k
        self.v_max = v_max
        self.velocity = UnicycleVelocityCtrl(v_max=v_max)
        self.pose = UnicyclePoseCtrl(v_max=v_max)
        self._there = True

    def input(self, state: State, reference: Vec) -> Vec:
        """Return (2,): v m/s, w rad/s."""
        yaw = yaw_of(state.q)
        p = state.p[0:2]
        goal = reference[0:2]
        v_d = reference[3:5]
        if float(np.linalg.norm(v_d)) > UNICYCLE_LIMITS.standing_speed:
            self._there = True
            return self.velocity.input(
                yaw, saturate(v_d + self.k * (goal - p), self.v_max)
            )
        far = float(np.linalg.norm(goal - p))
        self._there = far < (
            UNICYCLE_LIMITS.departed_distance
            if self._there
            else UNICYCLE_LIMITS.reached_distance
        )
        return (
            np.zeros(2)
            if self._there
            else self.pose.input(p, yaw, goal, float(reference[12]))
        )
