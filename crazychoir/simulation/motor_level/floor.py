"""The floor z = 0 under the drones of a block: standing, lift-off and touch-down without bounce.

A drone that stands can only turn about the vertical axis, when its rotors turn it with a larger
torque than its feet can hold.
"""

import math
from typing import NamedTuple

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    Triple,
    dot,
    quaternion_product,
    rotation_columns,
    rotation_exponential,
)
from crazychoir.simulation.motor_level.body import compute_ground_effect
from crazychoir.types import Vec

# isort: off
from crazychoir.simulation.motor_level.lanes import (
    ARM_LENGTH,
    EXTERNAL_FORCE_Z,
    AIRBORNE_FLAG,
    GROUND_EFFECT_AREA,
    INVERSE_INERTIA_Z,
    IMPACT_SPEED,
    LANE_COUNT,
    TOTAL_LIFT,
    BODY_MASS,
    POSITION_Z,
    QUATERNION_W,
    QUATERNION_X,
    QUATERNION_Y,
    QUATERNION_Z,
    SPECIFIC_FORCE_X,
    SPECIFIC_FORCE_Y,
    SPECIFIC_FORCE_Z,
    ROTOR_TORQUE_Z,
    VELOCITY_X,
    VELOCITY_Y,
    VELOCITY_Z,
    RATE_X,
    RATE_Y,
    RATE_Z,
)
# isort: on


class FloorContact(NamedTuple):
    """How the floor holds a drone that stands on it."""

    settling_time: float = 0.03
    """Seconds in which a drone that has touched down tips onto its feet or onto its back."""
    friction: float = 0.3
    """Friction coefficient between the feet and the floor; chosen."""
    least_holding_torque: float = 5e-4
    """Torque in N m that always holds a standing drone, however light it is; chosen.

    Therefore a drone that lifts off keeps its heading.
    """


FLOOR_CONTACT = FloorContact()


@kernel()
def _turn_on_floor(m: Vec, k: int, spin: float, h: float) -> float:
    """Return the rate in rad/s about z of a standing drone after h s.

        |TZ| > max(FLOOR_CONTACT.friction (m g - TOTAL_LIFT) arm, FLOOR_CONTACT.least_holding_torque)

    If this holds, the excess torque turns the drone; otherwise friction stops it.
    """
    torque: float = m[ROTOR_TORQUE_Z + k]
    held = max(
        FLOOR_CONTACT.friction
        * (STANDARD_GRAVITY * m[BODY_MASS + k] - m[TOTAL_LIFT + k])
        * m[ARM_LENGTH + k],
        FLOOR_CONTACT.least_holding_torque,
    )
    if spin == 0.0 and abs(torque) <= held:
        return 0.0
    along = spin if spin != 0.0 else torque
    after = spin + h * m[INVERSE_INERTIA_Z + k] * (torque - math.copysign(held, along))
    return 0.0 if after * along < 0.0 else after


@kernel()
def _settle(m: Vec, k: int, normal: Triple, h: float, spin: float) -> None:
    """Turn a standing drone until its z axis is normal to the surface below it.

        w = (z_b x d) / FLOOR_CONTACT.settling_time + spin z_b

    with d = n for an upright drone and d = -n for a drone on its back.
    The heading stays as it is, apart from the spin. The specific force carries the weight: R^T g
    e3.
    """
    q = (
        m[QUATERNION_X + k],
        m[QUATERNION_Y + k],
        m[QUATERNION_Z + k],
        m[QUATERNION_W + k],
    )
    bx, by, bz = rotation_columns(q)
    a = (1.0 if dot(bz, normal) >= 0.0 else -1.0) / FLOOR_CONTACT.settling_time
    w = (
        a * (bz[1] * normal[2] - bz[2] * normal[1]),
        a * (bz[2] * normal[0] - bz[0] * normal[2]),
        a * (bz[0] * normal[1] - bz[1] * normal[0]),
    )
    if spin != 0.0:
        w = (w[0] + spin * bz[0], w[1] + spin * bz[1], w[2] + spin * bz[2])
    q = quaternion_product(rotation_exponential(h * w[0], h * w[1], h * w[2]), q)
    (
        m[QUATERNION_X + k],
        m[QUATERNION_Y + k],
        m[QUATERNION_Z + k],
        m[QUATERNION_W + k],
    ) = q
    m[RATE_X + k] = dot(bx, w)
    m[RATE_Y + k] = dot(by, w)
    m[RATE_Z + k] = dot(bz, w)
    m[SPECIFIC_FORCE_X + k] = STANDARD_GRAVITY * bx[2]
    m[SPECIFIC_FORCE_Y + k] = STANDARD_GRAVITY * by[2]
    m[SPECIFIC_FORCE_Z + k] = STANDARD_GRAVITY * bz[2]


@kernel()
def _is_lifting_off(m: Vec, k: int) -> bool:
    """Return True if the upward forces on a standing drone exceed its weight.

    The rotors of a drone on its back push it down.
    """
    upright = 1.0 - 2.0 * (m[QUATERNION_X + k] ** 2 + m[QUATERNION_Y + k] ** 2)
    lift: float = (
        compute_ground_effect(0.0, m[GROUND_EFFECT_AREA + k])
        * m[TOTAL_LIFT + k]
        * upright
        + m[EXTERNAL_FORCE_Z + k]
    )
    return lift > STANDARD_GRAVITY * float(m[BODY_MASS + k])


@kernel()
def apply_floor(m: Vec, normal: Triple, h: float) -> None:
    """Apply the floor to the drones of a block for h s.

    normal: unit vector, world: normal of the surface below each drone; (0, 0, 0) if there is no
        floor
        or another part of the simulation computes it
    """
    if normal[2] == 0.0:
        return
    for k in range(LANE_COUNT):
        if m[AIRBORNE_FLAG + k] == 0.0:
            if _is_lifting_off(m, k):
                m[AIRBORNE_FLAG + k] = 1.0
                m[RATE_X + k] = 0.0
                m[RATE_Y + k] = 0.0
                m[RATE_Z + k] = 0.0
            else:
                _settle(m, k, normal, h, _turn_on_floor(m, k, m[RATE_Z + k], h))
        elif m[POSITION_Z + k] < 0.0:
            m[IMPACT_SPEED + k] = max(m[IMPACT_SPEED + k], -m[VELOCITY_Z + k])
            m[AIRBORNE_FLAG + k] = 0.0
            m[POSITION_Z + k] = 0.0
            m[VELOCITY_X + k] = 0.0
            m[VELOCITY_Y + k] = 0.0
            m[VELOCITY_Z + k] = 0.0
            _settle(m, k, normal, h, 0.0)
