"""What a reference may ask for: the limits of [flight] hold whatever guidance wants, and wherever it wants to be."""

import math

import numpy as np

from crazychoir.control.gains import Gains
from crazychoir.math3d import Triple, Vec, kernel, memory, real, saturate, vector
from crazychoir.swarm.tables import Flight
from crazychoir.types import Acceleration, FullState, State


@kernel()
def _share(a: Triple, limit: float) -> float:
    """The factor, at most 1, that shortens a to the length `limit`."""
    length = math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    return limit / length if length > limit else 1.0


@kernel(vector, vector, vector, real, real, memory)
def _cut(x: Vec, ref: Vec, gains: Vec, v_max: float, a_max: float, out: Vec) -> bool:
    """The law of ReferenceLimits for a reference (14,), into out (14,); False, and out is no good: nothing to cut."""
    speed = _share((ref[3], ref[4], ref[5]), v_max)
    lead = _share((ref[6], ref[7], ref[8]), a_max) if speed == 1.0 else 0.0
    e = (ref[0] - x[0], ref[1] - x[1], ref[2] - x[2])
    far = _share((gains[0] / gains[3] * e[0], gains[1] / gains[4] * e[1], gains[2] / gains[5] * e[2]), v_max)
    pull = (
        gains[0] * far * e[0] + gains[3] * (speed * ref[3] - x[3]),
        gains[1] * far * e[1] + gains[4] * (speed * ref[4] - x[4]),
        gains[2] * far * e[2] + gains[5] * (speed * ref[5] - x[5]),
    )
    hard = _share(pull, a_max)
    for c in range(3):
        out[c] = x[c] + hard * far * e[c]
        out[3 + c] = x[3 + c] + hard * (speed * ref[3 + c] - x[3 + c])
        out[6 + c] = lead * ref[6 + c]
        out[9 + c] = ref[9 + c] if lead == 1.0 else 0.0
    out[12], out[13] = ref[12], ref[13]
    return min(speed, lead, far, hard) < 1.0


class ReferenceLimits:
    """Cuts a reference to v_max, a_max of [flight]; one that keeps them stays as it is, to the bit.

        Acceleration:  |a| <= a_max
        FullState:     |v_d| <= v_max (a cut one without acceleration),  |a_d| <= a_max (a cut one without jerk),
                       |(kp / kv) (p_d - p)| <= v_max,  |kp (p_d - p) + kv (v_d - v)| <= a_max

    So a far place is flown to at v_max, a reference that runs away is followed at 2 v_max, and none, however it jumps,
    asks for more than 2 a_max.
    kp 1/s2, kv 1/s: of the controller that flies FullStates.
    """

    def __init__(self, flight: Flight, gains: Gains) -> None:
        self.v_max, self.a_max = flight.speed_limit, flight.acceleration_limit
        self._a_max_squared = self.a_max**2
        self._gains = gains.position

    def acceleration(self, reference: Acceleration) -> Acceleration:
        """At most a_max, in the same direction."""
        wanted = np.asarray(reference.a)
        x, y, z = wanted.tolist()
        if x * x + y * y + z * z <= self._a_max_squared:
            return reference
        return Acceleration(saturate(wanted, self.a_max), reference.yaw)

    def full_state(self, reference: FullState, state: State) -> FullState:
        """A reference that pulls the drone in `state` no harder than the limits allow."""
        out = np.empty(14)
        hard = _cut(state.flat, reference.flat, self._gains, self.v_max, self.a_max, out)
        return FullState(out) if hard else reference
