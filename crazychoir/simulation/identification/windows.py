"""Choose the windows of recorded flights that models predict open loop."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.simulation.identification.flights import RealFlight
from crazychoir.types import Bools, Ints, Mat


class WindowRules(NamedTuple):
    """Rows of a window; a row is 10 ms."""

    spacing_rows: int = 50
    """Rows from the start of a window to the next start in the same flight."""
    history_rows: int = 36
    """Rows before the start that trims may use."""
    predicted_rows: int = 50
    """Rows after the start that are predicted."""
    first_rows: int = 300
    """Rows after take-off that the trims of a whole flight may use."""


WINDOW_RULES = WindowRules()


@dataclass(frozen=True, slots=True)
class FlightWindows:
    """Windows of several flights, all outside the gaps of the telemetry."""

    flights: tuple[RealFlight, ...]
    """The f flights."""
    states: Mat
    """(f, n, 13): p, v, q, w of each flight; a shorter flight repeats its last row."""
    flight: Ints
    """(w,): number of each window's flight."""
    start: Ints
    """(w,): row of its flight at which each window starts."""

    @property
    def starts(self) -> Mat:
        """(w, 13): states at the starts."""
        return np.asarray(self.states[self.flight, self.start])

    @property
    def rows(self) -> Ints:
        """(w, predicted_rows): rows of its flight that each window gets its inputs from."""
        return self.start[:, None] + np.arange(WINDOW_RULES.predicted_rows)

    def recorded(self, ahead: int) -> Mat:
        """Return the recorded states (w, 13), `ahead` rows after the starts."""
        return np.asarray(self.states[self.flight, self.start + ahead])

    def choose(self, chosen: Bools) -> "FlightWindows":
        """Return the chosen windows (w,) of the same flights."""
        return FlightWindows(
            self.flights, self.states, self.flight[chosen], self.start[chosen]
        )


def find_windows(flights: Sequence[RealFlight]) -> FlightWindows:
    """Return a window each 0.5 s in the air where history and prediction lie outside of gaps.

    Raises ConfigError if there is none.
    """
    found: list[tuple[int, int]] = []
    before = WINDOW_RULES.history_rows
    after = WINDOW_RULES.predicted_rows
    for number, flight in enumerate(flights):
        a, b = flight.airborne
        found += [
            (number, row)
            for row in range(a, b - after, WINDOW_RULES.spacing_rows)
            if row - before >= a
            and flight.is_known[row - before : row + after + 1].all()
        ]
    if not found:
        names = ", ".join(flight.name for flight in flights) or "no flight"
        raise ConfigError(
            names,
            "no 0.86 s in the air without a gap in the telemetry",
            "flights with at least one such part",
        )
    longest = max(len(flight.t) for flight in flights)
    states = np.stack(
        [
            np.pad(flight.states, ((0, longest - len(flight.t)), (0, 0)), mode="edge")
            for flight in flights
        ]
    )
    return FlightWindows(
        flights=tuple(flights),
        states=states,
        flight=np.array([number for number, _ in found]),
        start=np.array([row for _, row in found]),
    )
