"""The battery under load: charge, voltage, and the largest thrust that it still allows."""

import math

from crazychoir.numerics.kernels import kernel
from crazychoir.numerics.math3d import clip
from crazychoir.types import Vec

# isort: off
from crazychoir.simulation.motor_level.lanes import (
    VOLTAGE_CURVE_0,
    VOLTAGE_CURVE_1,
    VOLTAGE_CURVE_2,
    VOLTAGE_CURVE_3,
    CELL_CAPACITY,
    THRUST_CEILING,
    CELL_EMPTY_VOLTAGE,
    CELL_FULL_VOLTAGE,
    BATTERY_CHARGE,
    ROTOR_THRUST_1,
    IDLE_CURRENT,
    LANE_COUNT,
    POWER_FACTOR,
    CELL_RESISTANCE,
    BATTERY_VOLTAGE,
)
# isort: on

OPEN_CIRCUIT_CURVE = (
    0.0,
    0.65,
    0.6917,
    0.725,
    0.7417,
    0.7667,
    0.8,
    0.8333,
    0.8667,
    0.9167,
    1.0,
)
"""Voltage at rest between empty (0) and full (1), for each tenth of the charge.

The values are the firmware's table for a lithium polymer cell,
3.00 3.78 3.83 3.87 3.89 3.92 3.96 4.00 4.04 4.10 V (crazyflie-firmware, pm_stm32f4.c),
and 4.2 V for a full cell.
"""


@kernel()
def interpolate_open_circuit(charge: float) -> float:
    """Return the voltage at rest between empty (0) and full (1) for a charge from 0 to 1.

    The table is interpolated by straight lines.
    """
    x = 10.0 * clip(charge, 0.0, 1.0)
    n = min(int(x), 9)
    low: float = OPEN_CIRCUIT_CURVE[n]
    return low + (x - n) * (OPEN_CIRCUIT_CURVE[n + 1] - low)


@kernel()
def drain_batteries(m: Vec, dt: float) -> None:
    """Load the batteries of a block for dt s.

        P = a sum_n f_n^1.5,   V = E - R I,   I = P / V + I_idle,   Q' = -I

    and therefore V = (b + sqrt(b^2 - 4 R P)) / 2 with b = E - R I_idle. P is the power of an ideal
    rotor (momentum theory); a is chosen such that P in hover is the platform's hover power. The
    protection of a cell switches it off when it is empty: V = 0. THRUST_CEILING is the thrust of the
    platform's curve c0 + c1 V + c2 V^2 + c3 V^3 at full duty cycle.
    """
    for k in range(LANE_COUNT):
        power = 0.0
        for n in range(0, 4 * LANE_COUNT, LANE_COUNT):
            power += m[ROTOR_THRUST_1 + n + k] * math.sqrt(m[ROTOR_THRUST_1 + n + k])
        power *= m[POWER_FACTOR + k]
        rest = m[CELL_EMPTY_VOLTAGE + k] + (
            m[CELL_FULL_VOLTAGE + k] - m[CELL_EMPTY_VOLTAGE + k]
        ) * interpolate_open_circuit(m[BATTERY_CHARGE + k])
        b = rest - m[CELL_RESISTANCE + k] * m[IDLE_CURRENT + k]
        v = 0.5 * (
            b + math.sqrt(max(b * b - 4.0 * m[CELL_RESISTANCE + k] * power, 0.0))
        )
        m[BATTERY_CHARGE + k] = max(
            m[BATTERY_CHARGE + k]
            - dt * (power / v + m[IDLE_CURRENT + k]) / m[CELL_CAPACITY + k],
            0.0,
        )
        v = v if m[BATTERY_CHARGE + k] > 0.0 else 0.0
        m[BATTERY_VOLTAGE + k] = v
        m[THRUST_CEILING + k] = max(
            m[VOLTAGE_CURVE_0 + k]
            + v
            * (
                m[VOLTAGE_CURVE_1 + k]
                + v * (m[VOLTAGE_CURVE_2 + k] + v * m[VOLTAGE_CURVE_3 + k])
            ),
            0.0,
        )
