"""What a controller listens to: trajectory handlers, chosen at run time."""

from typing import Protocol

import numpy as np

from crazychoir.numerics.math3d import yaw_of
from crazychoir.types import Acceleration, FullState, Reference, State, Vec

_NOWHERE = State.at((0.0, 0.0, 0.0))


def _at_rest(state: State, last: Vec | None) -> Vec:
    """The reference (14,) of staying where `last` is, else where the state is."""
    at = np.zeros(14)
    at[0:3] = state.p if last is None else last[0:3]
    at[12] = yaw_of(state.q) if last is None else last[12]
    return at


class TrajectoryHandler(Protocol):
    """Reads one kind of reference from its topic."""

    topic: str

    def read(self, reference: Reference) -> Vec | None:
        """The reference as (14,), laid out as FullState.flat; None if it is not of this handler's kind and shape."""
        ...

    def hold(self, state: State, last: Vec | None) -> Vec:
        """The reference (14,) to fly on when no usable one comes: `last` brought to rest, or the state."""
        ...


class FullStateTraj:
    """Position, velocity, acceleration, jerk and yaw: for FlatnessPositionCtrl."""

    topic = "fullstate"

    def read(self, reference: Reference) -> Vec | None:
        """Its numbers, not copied."""
        if (
            isinstance(reference, FullState)
            and reference.flat.shape == (14,)
            and reference.flat.dtype == np.float64
        ):
            return reference.flat
        return None

    def hold(self, state: State, last: Vec | None) -> Vec:
        """Stay at the last reference's place and heading, or at the state's."""
        return _at_rest(state, last)


class PositionTraj:
    """A position alone, to come to at rest: its place, and no velocity. Reads every FullState so."""

    topic = "position"

    def read(self, reference: Reference) -> Vec | None:
        """Its place and heading, without what its velocity and acceleration would be fed forward as."""
        if not isinstance(reference, FullState) or reference.flat.shape != (14,):
            return None
        return self.hold(_NOWHERE, reference.flat)

    def hold(self, state: State, last: Vec | None) -> Vec:
        """Stay at the last reference's place and heading, or at the state's."""
        return _at_rest(state, last)


class AccelerationTraj:
    """An acceleration and a yaw, from a double-integrator law: for FlatnessAccelerationCtrl."""

    topic = "acceleration"

    def __init__(self) -> None:
        frames = np.zeros(14), np.zeros(14)
        self._next, self._other = [(flat, flat[6:9]) for flat in frames]

    def read(self, reference: Reference) -> Vec | None:
        """Acceleration and yaw; position and velocity are left at zero, nothing follows them.

        The array is this handler's own, good until its next but one.
        """
        if not isinstance(reference, Acceleration):
            return None
        a = np.asarray(reference.a)
        if a.shape != (3,):
            return None
        flat, acceleration = self._next
        self._next, self._other = self._other, self._next
        acceleration[...] = a
        flat[12] = reference.yaw
        return flat

    def hold(self, state: State, last: Vec | None) -> Vec:
        """No acceleration; the last heading, or the state's."""
        level = np.zeros(14)
        level[12] = yaw_of(state.q) if last is None else last[12]
        return level
