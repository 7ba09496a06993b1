"""What a typical drone has and a perfect one lacks: uneven motors, moments of speed, unrest, vibration.

The figures come from 77 flights of a Crazyflie 2.1 with markers (NanoBench, Ullah & Baca,
arXiv 2603.09908; ten of them are in the tests) and are used for all platforms.
"""

from dataclasses import dataclass, replace

from crazychoir.platforms import BodyEffects, Platform
from crazychoir.simulation.common.draws import (
    RANDOM_STREAMS,
    derive_stream_key,
    draw_uniform,
)

LARGEST_IMBALANCE = 0.5
"""Largest share by which motors may differ: a motor never pushes down."""


@dataclass(frozen=True, slots=True)
class Imperfections:
    """Effects that make a drone typical; the defaults are a perfect drone."""

    speed_moment: float = 0.0
    """rad/s2 per m/s: angular acceleration that speed makes; it lifts the side that flies ahead.

    Source: 31 about x and 35 about y in all flights, with 94 % of the variance explained.
    """
    rate_damping: float = 0.0
    """1/s: damping of the roll and pitch rates.

    Source: 3 to 7, with low confidence, because it was found in a closed loop.
    """
    imbalance: float = 0.0
    """Largest share by which the thrust of a motor differs from that of the platform.

    Source: constant angular accelerations of -41 to 48 rad/s2. One motor with 0.1 more thrust makes
    15 rad/s2.
    """

    def apply(self, platform: Platform, seed: int, drone: int) -> Platform:
        """Return the body of a drone with these imperfections.

        What is known of the drone stays. The motors differ, but together they have the platform's thrust.
        seed: of the factors of the motors, which are functions of (seed, drone)
        """
        key = derive_stream_key(seed, RANDOM_STREAMS.motor_factors, drone)
        drawn = [1.0 + self.imbalance * draw_uniform(key, motor) for motor in range(4)]
        first, second, third, fourth = (4.0 * one / sum(drawn) for one in drawn)
        x, y, _ = platform.inertia
        return replace(
            platform,
            effects=platform.effects.filled(
                BodyEffects(
                    speed_moment=(self.speed_moment * x, self.speed_moment * y),
                    motor_factors=(first, second, third, fourth),
                    rate_damping=(self.rate_damping * x, self.rate_damping * y, 0.0),
                )
            ),
        )
