"""The floor z = 0 under the drones of a block: standing, lifting off, touching down; no bounce.

A drone that stands slips about its z axis alone, when its rotors turn it harder than its feet hold it.
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
"""s, in which a drone that has touched down tips onto its feet, or onto its back."""
FRICTION = 0.3
"""Chosen: of feet on a floor, force a force that presses them on it."""
STUCK = 5e-4
"""N m, chosen: a smaller torque turns nobody, however light he is: so a drone that lifts off keeps its heading."""


@kernel()
def _turned(m: Vec, k: int, spin: float, h: float) -> float:
    """rad/s about z of a drone that stands, after h s.

    |TZ| > max(FRICTION (m g - LIFT) arm, STUCK):  it turns by what is more; else it is stopped
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
    """Turn a drone that stands until its z axis is normal to what it stands on, its heading kept but for a spin.

        w = (z_b x d) / SETTLING + spin z_b,  d = n for an upright drone and -n for one on its back

    Its specific force is what carries its weight: R^T g e3.
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
    """Does what pulls a standing drone up outweigh it? One on its back pushes itself down."""
    upright = 1.0 - 2.0 * (m[QX + k] ** 2 + m[QY + k] ** 2)
    lift: float = near_floor(0.0, m[GROUND + k]) * m[LIFT + k] * upright + m[EZ + k]
    return lift > GRAVITY * float(m[MASS + k])


@kernel()
def stand(m: Vec, normal: Triple, h: float) -> None:
    """What the floor does to the drones of a block in h s.

    normal: of what is under each, a unit vector, world;  (0, 0, 0): there is no floor, or it is somebody else's.
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
