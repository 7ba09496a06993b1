"""The controllers on board, the firmware's and a user's own, fly the circle of the senders with whole drones."""

import math

import numpy as np
import pytest

from crazychoir.control.handlers import FullStateTraj
from crazychoir.control.senders import XYZSender
from crazychoir.control.velocity import WaypointController
from crazychoir.mocap.simulated import SimulatedMocap
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    flat_attitude,
    rotation,
    wrap_angle,
    yaw_of,
)
from crazychoir.planning.figure import circle
from crazychoir.platforms import CRAZYFLIE_21, CRAZYFLIE_21_BRUSHLESS, PLATFORM_BY_NAME
from crazychoir.simulation.motor_level.crazyflies import CrazyflieWorld
from crazychoir.simulation.motor_level.motors import MotorConditions
from crazychoir.simulation.onboard.laws import ForceTorque
from crazychoir.simulation.owner import DelayedLink
from crazychoir.types import XYZ

YAW, HEIGHT, DELAY_STEPS = math.radians(137.0), 0.6, 2
FULL = slice(600, 1000)
"""Ticks of the circle at its full rate, after the first second of it."""


class Flown:
    """Drones in one world, seen by cameras; each gets its set-points 20 ms late."""

    def __init__(self, platforms):
        n = len(platforms)
        self.home = np.array([[1.5 * k, 0.0, 0.0] for k in range(n)])
        self.world = CrazyflieWorld(
            range(n),
            self.home,
            np.full(n, YAW),
            platforms,
            conditions=MotorConditions(has_downwash=False),
            seed=1,
        )
        self.boards = list(self.world.onboard.values())
        self.cameras = SimulatedMocap(range(n), 1)
        self.links = [
            DelayedLink(self.world.link(k, "fullstate"), DELAY_STEPS) for k in range(n)
        ]
        start = [(x - 0.4, y, HEIGHT) for x, y, _ in self.home]
        self.figures = [circle(p, 0.4, 10.0, 1.0, yaw=YAW, yaw_rate=1.0) for p in start]

    def step(self, times=1):
        for _ in range(times):
            for link in self.links:
                link.advance()
            self.world.step()
            frame = self.cameras.sample(self.world.states, self.world.tick)
            self.world.see_frame(frame.flat, frame.seen)

    def take_off(self):
        self.step(50)
        for board in self.boards:
            board.arm()
        self.step(100)
        assert [board.planner.take_off(HEIGHT, 2.0) for board in self.boards] == [
            0
        ] * len(self.boards)
        self.step(300)

    def circles(self, send):
        """Errors (ticks, drones, 4) of places in m and of yaws in degrees; send(k, reference, t)."""
        errors = []
        for tick in range(round(self.figures[0].duration / 0.01)):
            row = []
            for k, figure in enumerate(self.figures):
                x, reference = self.world.states[k], figure.sample(0.01 * tick)
                row.append(
                    (
                        *(x[:3] - reference.p),
                        math.degrees(wrap_angle(yaw_of(x[6:10]) - reference.yaw)),
                    )
                )
                send(k, reference, 0.01 * tick)
            errors.append(row)
            self.step()
        return np.array(errors)

    def land(self):
        for link, figure in zip(self.links, self.figures, strict=True):
            link.send(
                XYZ("land", np.array([0.0, 0.0, 0.0, figure.sample(math.inf).yaw, 2.0]))
            )
        self.step(350)
        assert [float(np.sum(board.record["motors"])) for board in self.boards] == [
            0.0
        ] * len(self.boards)
        assert self.world.crashed == []
        assert all(self.world.resting(i) for i in self.world.ids)


# The firmware's -------------------------------------------------------------------------------------------------------

ROWS = [
    (platform, law)
    for platform in ("cf21", "cf21plus", "cf21bl")
    for law in ("pid", "mellinger", "lee")
]


@pytest.fixture(scope="module")
def firmware():
    """By row: the errors of the circle.

    Mellinger's and Lee's fly full states. The PIDs heed neither velocities nor rates of full states, and would lag by
    0.6 s and 9 degrees; they fly places and yaws that WaypointController leads for them.
    """
    flown = Flown([PLATFORM_BY_NAME[platform] for platform, _ in ROWS])
    for board, (_, law) in zip(flown.boards, ROWS, strict=True):
        board.set("stabilizer.controller", law)
        # The firmware's constant is that of the Crazyflie: a brushless one would hover 8 cm too high, and land so.
        if board.platform is CRAZYFLIE_21_BRUSHLESS:
            board.set("ctrlMel.massThrust", 65535.0 / (4.0 * board.firmware.thrust_max))
    ahead = [
        WaypointController(XYZSender(), FullStateTraj(), every=0.0, ahead=0.0)
        for _ in ROWS
    ]

    def send(k, reference, t):
        if ROWS[k][1] == "pid":
            line = ahead[k].law(flown.world.state(k), reference.flat, t)
            flown.boards[k].setpoints.position(line[:3], line[3])
        else:
            flown.links[k].send(reference)

    flown.take_off()
    errors = flown.circles(send)
    flown.land()
    return {row: errors[:, k] for k, row in enumerate(ROWS)}


MOST = {"pid": (0.05, 0.05), "mellinger": (0.07, 0.12), "lee": (0.07, 0.20)}
"""m from the reference, horizontally and in height, with what the firmware assumes: a mass of 29 or 39 g, where the
drones have 32 and 43 g. Lee's has no integral to speak of in height: it sags by g (m - m_0) / (7 m_0), 0.14 m."""


@pytest.mark.parametrize("row", ROWS, ids="-".join)
def test_a_controller_on_board_turns_with_its_set_points_across_pi(firmware, row):
    """With its own gains and masses. Measured: 1.9 degrees of the PIDs, 1.3 of Mellinger's and Lee's, 20 ms late."""
    errors = firmware[row]
    assert np.max(np.abs(errors[FULL, 3])) <= 3.0
    assert np.max(np.abs(errors[100:, 3])) <= 3.0
    sideways, up = MOST[row[1]]
    assert np.max(np.linalg.norm(errors[FULL, :2], axis=1)) <= sideways
    assert np.max(np.abs(errors[FULL, 2])) <= up


def test_a_step_of_the_yaw_is_turned_by_every_controller_without_a_fall():
    """By 0.9 rad at once, also behind the slow rotors of the cf21, with the firmware's gains and masses."""
    flown = Flown([PLATFORM_BY_NAME[platform] for platform, _ in ROWS])
    for board, (_, law) in zip(flown.boards, ROWS, strict=True):
        board.set("stabilizer.controller", law)
    flown.take_off()
    for _ in range(400):
        for board, place in zip(flown.boards, flown.home, strict=True):
            board.setpoints.position((*place[:2], HEIGHT), YAW + 0.9)
        flown.step()
    for x, place in zip(flown.world.states, flown.home, strict=True):
        assert abs(math.degrees(wrap_angle(yaw_of(x[6:10]) - YAW - 0.9))) <= 3.0
        assert np.linalg.norm(x[:3] - [*place[:2], HEIGHT]) < 0.2
    assert flown.world.crashed == []


# A user's own ---------------------------------------------------------------------------------------------------------


def geometric(setpoint, estimate, gyro, dt):
    """F = m (a + 7 e_p + 4 e_v + g e3), tau = J (-k_R e_R - k_w (w - w_d)): a law that a user may write."""
    if setpoint.modes.z == 0:
        return ForceTorque(0.0, 0.0, 0.0, 0.0)
    force = (
        setpoint.a
        + 7.0 * (setpoint.p - estimate.p)
        + 4.0 * (setpoint.v - estimate.v)
        + [0.0, 0.0, STANDARD_GRAVITY]
    )
    force *= CRAZYFLIE_21.mass
    r, d = rotation(estimate.q), np.array(flat_attitude(tuple(force), setpoint.yaw)).T
    e = d.T @ r - r.T @ d
    e_r = 0.5 * np.array([e[2, 1], e[0, 2], e[1, 0]])
    turn = -np.array([400.0, 400.0, 270.0]) * e_r - 70.0 * (gyro - setpoint.w)
    return ForceTorque(float(force @ r[:, 2]), *(np.array(CRAZYFLIE_21.inertia) * turn))


def test_a_users_law_takes_off_flies_the_circle_and_lands():
    flown = Flown([CRAZYFLIE_21])
    (board,) = flown.boards
    board.register("mine", geometric)
    board.set("stabilizer.controller", "mine")
    flown.take_off()
    assert flown.world.states[0, :3] == pytest.approx([0.0, 0.0, HEIGHT], abs=0.05)
    errors = flown.circles(lambda k, reference, t: flown.links[k].send(reference))[:, 0]
    assert np.max(np.abs(errors[FULL, 3])) <= 3.0
    assert np.max(np.linalg.norm(errors[FULL, :3], axis=1)) <= 0.06
    flown.land()
