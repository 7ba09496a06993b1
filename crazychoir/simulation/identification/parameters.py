"""The parameters of a plant that flights identify, and the sets that were found."""

from dataclasses import dataclass, replace

from crazychoir.platforms import BodyEffects, Platform

ANY_REQUEST = 1.0
"""Thrust in N that no motor makes: with it as the firmware's greatest thrust, recorded duty cycles are not cut."""


@dataclass(frozen=True, slots=True)
class PlantParameters:
    """What of a plant is identified; all effects are given as accelerations, because the mass is not observable.

    Thrust and motor imbalance are no parameters: they differ from flight to flight and are trims.
    """

    lag: float
    """s: lag of the rotors."""
    delay: float
    """s: lag in series with it, see `platforms.BodyEffects`."""
    torque_gain: float
    """Angular acceleration for the same thrusts, as a share of the platform's."""
    roll_moment: float
    """rad/s2 per m/s: roll acceleration that speed along y makes."""
    pitch_moment: float
    """rad/s2 per m/s: pitch acceleration, upwards, that speed along x makes."""
    damping: float
    """1/s: damping of the roll and pitch rates."""
    yaw_damping: float
    """1/s: damping of the yaw rate."""
    drag: float
    """1/s: drag along x and y over the mass."""
    vertical_drag: float
    """1/s: drag along z over the mass."""

    def apply(self, platform: Platform) -> Platform:
        """Return the platform with these parameters, for recorded duty cycles.

        The duty cycles lie behind the firmware's limit of the thrust, so the platform has none.
        """
        x, y, z = (inertia / self.torque_gain for inertia in platform.inertia)
        return replace(
            remove_request_limit(platform),
            inertia=(x, y, z),
            rotor=replace(platform.rotor, lag=self.lag),
            drag=(
                self.drag * platform.mass,
                self.drag * platform.mass,
                self.vertical_drag * platform.mass,
            ),
            effects=BodyEffects(
                speed_moment=(self.roll_moment * x, self.pitch_moment * y),
                rate_damping=(self.damping * x, self.damping * y, self.yaw_damping * z),
                delay=self.delay,
            ),
        )


def remove_request_limit(platform: Platform) -> Platform:
    """Return the platform with a firmware that asks its motors for any thrust.

    The firmware limits the duty cycle behind the compensation of the battery, so the recorded ones are limited already.
    """
    return replace(
        platform, firmware=replace(platform.firmware, thrust_max=ANY_REQUEST)
    )


PHYSICAL_PARAMETERS = PlantParameters(
    lag=0.060,
    delay=0.012,
    torque_gain=0.86,
    roll_moment=33.0,
    pitch_moment=35.0,
    damping=3.0,
    yaw_damping=3.0,
    drag=0.385,
    vertical_drag=0.50,
)
"""Parameters with a physical meaning each, one set for all flights of one drone.

The drone is NanoBench's Crazyflie 2.1, with an assumed mass of 31.9 g. Lag and gain: single strong
events. Drag: accelerometer against speed. Moments: mean torques against speed. Damping: the value with
the least open-loop errors. In a closed loop the motors mostly answer disturbances, so least squares
would shrink the gain.
Source: an analysis of 77 flights of NanoBench (arXiv 2603.09908); ten of them are in the tests.
"""
FITTED_PARAMETERS = PlantParameters(
    lag=0.0554,
    delay=0.0177,
    torque_gain=0.153,
    roll_moment=6.93,
    pitch_moment=7.21,
    damping=7.91,
    yaw_damping=4.90,
    drag=0.409,
    vertical_drag=0.0,
)
"""Parameters with the least open-loop errors in ten flights of NanoBench: the result of `fit_parameters`.

They predict best, but the gain is not physical, see PHYSICAL_PARAMETERS: closed loops want the physical set.
"""
