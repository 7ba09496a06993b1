"""The floor z = 0 under the drones of a block: standing, lift-off and touch-down without bounce.

A drone that stands can only turn about the vertical axis, when its rotors turn it with a larger
torque than its feet can hold.
"""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import (
    GRAVITY,
    Triple,
    columns,
    dot,
    exponential,
    product,
)
from crazychoir.simulation.motor_level.body import near_floor
from crazychoir.types import Vec

# isort: off
from crazychoir.simulation.motor_level.lanes import (
    ARM,
    EZ,
    FREE,
    GROUND,
    IJZ,
    IMPACT,
    LANES,
    LIFT,
    MASS,
    PZ,
    QW,
    QX,
    QY,
    QZ,
    SX,
    SY,
    SZ,
    TZ,
    VX,
    VY,
    VZ,
    WX,
    WY,
    WZ,
)
# isort: on

SETTLING = 0.03
"""Seconds in which a drone that has touched down tips onto its feet or onto its back."""
FRICTION = 0.3
"""Friction coefficient between the feet and the floor; chosen."""
STUCK = 5e-4
"""Torque in N m that always holds a standing drone, however light it is; chosen.

Therefore a drone that lifts off keeps its heading.
"""


@kernel()
def _turned(m: Vec, k: int, spin: float, h: float) -> float:
    """Return the rate in rad/s about z of a standing drone after h s.

        |TZ| > max(FRICTION (m g - LIFT) arm, STUCK)

    If this holds, the excess torque turns the drone; otherwise friction stops it.
    """
    torque: float = m[TZ + k]
    held = max(FRICTION * (GRAVITY * m[MASS + k] - m[LIFT + k]) * m[ARM + k], STUCK)
    if spin == 0.0 and abs(torque) <= held:
        return 0.0
    along = spin if spin != 0.0 else torque
    after = spin + h * m[IJZ + k] * (torque - math.copysign(held, along))
    return 0.0 if after * along < 0.0 else after


@kernel()
def _settle(m: Vec, k: int, normal: Triple, h: float, spin: float) -> None:
    """Turn a standing drone until its z axis is normal to the surface below it.

        w = (z_b x d) / SETTLING + spin z_b

    with d = n for an upright drone and d = -n for a drone on its back.
    The heading stays as it is, apart from the spin. The specific force carries the weight: R^T g
    e3.
    """
    q = (m[QX + k], m[QY + k], m[QZ + k], m[QW + k])
    bx, by, bz = columns(q)
    a = (1.0 if dot(bz, normal) >= 0.0 else -1.0) / SETTLING
    w = (
        a * (bz[1] * normal[2] - bz[2] * normal[1]),
        a * (bz[2] * normal[0] - bz[0] * normal[2]),
        a * (bz[0] * normal[1] - bz[1] * normal[0]),
    )
    if spin != 0.0:
        w = (w[0] + spin * bz[0], w[1] + spin * bz[1], w[2] + spin * bz[2])
    q = product(exponential(h * w[0], h * w[1], h * w[2]), q)
    m[QX + k], m[QY + k], m[QZ + k], m[QW + k] = q
    m[WX + k], m[WY + k], m[WZ + k] = dot(bx, w), dot(by, w), dot(bz, w)
    m[SX + k] = GRAVITY * bx[2]
    m[SY + k] = GRAVITY * by[2]
    m[SZ + k] = GRAVITY * bz[2]


@kernel()
def _lifts_off(m: Vec, k: int) -> bool:
    """Return True if the upward forces on a standing drone exceed its weight.

    The rotors of a drone on its back push it down.
    """
    upright = 1.0 - 2.0 * (m[QX + k] ** 2 + m[QY + k] ** 2)
    lift: float = near_floor(0.0, m[GROUND + k]) * m[LIFT + k] * upright + m[EZ + k]
    return lift > GRAVITY * float(m[MASS + k])


@kernel()
def stand(m: Vec, normal: Triple, h: float) -> None:
    """Apply the floor to the drones of a block for h s.

    normal: unit vector, world: normal of the surface below each drone; (0, 0, 0) if there is no
        floor
        or another part of the simulation computes it
    """
    if normal[2] == 0.0:
        return
    for k in range(LANES):
        if m[FREE + k] == 0.0:
            if _lifts_off(m, k):
                m[FREE + k] = 1.0
                m[WX + k] = 0.0
                m[WY + k] = 0.0
                m[WZ + k] = 0.0
            else:
                _settle(m, k, normal, h, _turned(m, k, m[WZ + k], h))
        elif m[PZ + k] < 0.0:
            m[IMPACT + k] = max(m[IMPACT + k], -m[VZ + k])
            m[FREE + k] = 0.0
            m[PZ + k] = 0.0
            m[VX + k] = 0.0
            m[VY + k] = 0.0
            m[VZ + k] = 0.0
            _settle(m, k, normal, h, 0.0)
