"""Trajectory handlers: they read one kind of reference, and can be exchanged at run time."""

from typing import Protocol

import numpy as np

from crazychoir.numerics.math3d import yaw_of
from crazychoir.types import Acceleration, FullState, Reference, State, Vec

_STATE_AT_ORIGIN = State.at((0.0, 0.0, 0.0))


def _make_resting_reference(state: State, last: Vec | None) -> Vec:
    """Return the reference (14,) that stays at the place of `last`, or at the state without one."""
    at = np.zeros(14)
    at[0:3] = state.p if last is None else last[0:3]
    at[12] = yaw_of(state.q) if last is None else last[12]
    return at


class TrajectoryHandler(Protocol):
    """Reads one kind of reference from its topic."""

    topic: str
    """Name of the topic."""

    def read(self, reference: Reference) -> Vec | None:
        """Return the reference as (14,), as FullState.flat.

        Returns None if it is of another kind or shape.
        """
        ...

    def hold(self, state: State, last: Vec | None) -> Vec:
        """Return the reference (14,) that the drone flies while no usable reference arrives.

        state: of the drone, to rest at if there is no `last`
        last: (14,), last usable reference, None if there was none
        """
        ...


class FullStateTraj:
    """Reads position, velocity, acceleration, jerk and yaw, for FlatnessPositionCtrl."""

    topic = "fullstate"

    def read(self, reference: Reference) -> Vec | None:
        """Return the numbers of a FullState, not copied."""
        if (
            isinstance(reference, FullState)
            and reference.flat.shape == (14,)
            and reference.flat.dtype == np.float64
        ):
            return reference.flat
        return None

    def hold(self, state: State, last: Vec | None) -> Vec:
        """Stay at the place and heading of the last reference, or of the state."""
        return _make_resting_reference(state, last)


class PositionTraj:
    """Reads only place and yaw of a FullState, so that the drone comes to rest there."""

    topic = "position"

    def read(self, reference: Reference) -> Vec | None:
        """Return place and heading, without velocity and acceleration to feed forward."""
        if not isinstance(reference, FullState) or reference.flat.shape != (14,):
            return None
        return self.hold(_STATE_AT_ORIGIN, reference.flat)

    def hold(self, state: State, last: Vec | None) -> Vec:
        """Stay at the place and heading of the last reference, or of the state."""
        return _make_resting_reference(state, last)


class AccelerationTraj:
    """Reads acceleration and yaw of a double-integrator law, for FlatnessAccelerationCtrl."""

    topic = "acceleration"

    def __init__(self) -> None:
        frames = np.zeros(14), np.zeros(14)
        self._next, self._other = [(flat, flat[6:9]) for flat in frames]

    def read(self, reference: Reference) -> Vec | None:
        """Return a reference (14,) with acceleration and yaw; all else is zero.

        The array belongs to this handler. It is valid until the second next call.
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
        """Return a reference (14,) without acceleration, with the last heading or that of the state."""
        level = np.zeros(14)
        level[12] = yaw_of(state.q) if last is None else last[12]
        return level
