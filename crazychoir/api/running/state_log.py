"""The states of a drone as they arrive."""

from typing import TYPE_CHECKING

import numpy as np

from crazychoir.runtime.clock import Clock
from crazychoir.types import Mat, State

if TYPE_CHECKING:
    import pandas as pd

STATE_COLUMNS = (
    "t",
    *("x", "y", "z"),
    *("vx", "vy", "vz"),
    *("qx", "qy", "qz", "qw"),
    *("wx", "wy", "wz"),
)
"""Columns of a log: s since its start; m; m/s; attitude; rad/s in the body frame."""


class StateLog:
    """Collects the states of a drone from now on.

    clock: clock of this process
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._began = clock.now()
        self._rows: list[list[float]] = []
        self._is_on = True

    def add(self, state: State, age: float) -> None:
        """Add a state that has arrived with this age in s."""
        if self._is_on:
            t = self._clock.now() - age - self._began
            self._rows.append([t, *state.flat.tolist()])

    def stop(self) -> None:
        """Collect no more."""
        self._is_on = False

    @property
    def rows(self) -> Mat:
        """(n, 14): the states until now, with the columns of STATE_COLUMNS."""
        return np.array(self._rows, dtype=float).reshape(-1, len(STATE_COLUMNS))

    def frame(self) -> "pd.DataFrame":
        """Return the states until now as a pandas table."""
        import pandas as pd

        return pd.DataFrame(self.rows, columns=list(STATE_COLUMNS))
