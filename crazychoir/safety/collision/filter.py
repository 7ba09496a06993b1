"""The collision filter: the safe acceleration that is nearest to the wanted one."""

import numpy as np

from crazychoir.config.tables import CollisionTable
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.airspace.relayed_states import RelayedStates
from crazychoir.safety.collision.avoidance import (
    AVOID_ROW,
    avoid_rows,
    make_nearest,
    make_planes,
)
from crazychoir.safety.collision.deadlock import reset_side
from crazychoir.safety.rules.guard import Fence
from crazychoir.types import Records, State, Vec


class CollisionFilter:
    """Turns a wanted acceleration into a safe one, by the states of this drone and the others.

        min |u - u_n|^2   s.t.   n_ij . S u >= share b_ij  for each other drone j in range,
                                 |u_c| <= most,  the fence
        |S (p_i - p_j)| >= D,   S = diag(1, s_x / s_y, s_x / s_z),   D = 2 s_x + margin

    s: semi-axes of the ellipsoid around each drone
    b_ij: of `compute_barrier_acceleration`, or of `compute_cell_acceleration` for another drone that gives way as well
    u_n: what is wanted, turned to the side where another drone is in the way

    Places and velocities are those of `predict_late_motion`, so that the lag of the drones counts. Constraints
    that cannot all be met are relaxed by the least violation: the fence first, the nearest drone
    last, the floor never. Drones on the floor are balls of COLLISION_DISTANCES.standing_drone m; a drone that takes
    off ignores them.

    A drone brakes if another drone that may be near has been silent for NEIGHBOUR_AGES.usable s, or if more than
    half of the other drones that flew have been silent for NEIGHBOUR_AGES.silent s. It does not brake for this
    while it lands. It keeps clear of the place where the silent drone is if that drone brakes too.
    After the same silence a drone on the floor may have taken off: this one keeps beside its place, at any
    height.

    settings: [collision]
    traffic: what this drone knows of the others
    fence: from the floor upwards
    a_max: m/s2, with which the drone brakes
    v_max: m/s, largest speed of the others
    ground: m, height of the ground
    row: (1,) AVOID_ROW of this drone, part of the rows of its process; None: a row of its own
    """

    def __init__(
        self,
        settings: CollisionTable,
        traffic: Neighbours,
        fence: Fence,
        a_max: float,
        v_max: float,
        ground: float,
        row: Records | None = None,
    ) -> None:
        self.traffic = traffic
        self.hearsay = RelayedStates(traffic)
        self.row = np.zeros(1, AVOID_ROW) if row is None else row
        """(1,) AVOID_ROW."""
        self._planes = make_planes()
        self._near = make_nearest()
        box = np.array([*fence.low, *fence.high])
        self.row["box"] = box + np.repeat([1.0, -1.0], 3) * settings.margin
        self.row["largest_horizontal"] = 1.5 * a_max
        self.row["largest_vertical"] = a_max
        self.row["v_max"] = v_max
        self.row["silent_gap"] = traffic.airspace.rules["silent_gap"][0]
        self.row["ground"] = ground
        self.row["listener"] = traffic.listener
        self.row["gives_way_to"] = -1
        _write_settings(self.row, settings)
        reset_side(self.row, traffic.port.address)

    def full_state(
        self, state: State, reference: Vec, gains: Vec, now: float, lands: bool = False
    ) -> Vec | None:
        """Return the safe acceleration, (3,) m/s2, of a drone that follows a full state.

        state: of the drone
        reference: (14,), as FullState.flat
        gains: (13,), as Gains.position
        now: s
        lands: whether the drone is landing
        Returns None if the drone may fly as it wants.
        """
        self.row["reference"] = reference
        self.row["follows"] = 1
        self.row["lands"] = lands
        return self._run(state, gains, now)

    def acceleration(self, state: State, a: Vec, gains: Vec, now: float) -> Vec | None:
        """Return the safe acceleration, (3,) m/s2, of a drone that follows an acceleration.

        state: of the drone
        a: (3,) m/s2: what it wants
        gains: (13,), as Gains.position
        now: s
        Returns None if the drone may fly as it wants.
        """
        self.row["reference"][0, 6:9] = a
        self.row["follows"] = 0
        self.row["lands"] = 0
        return self._run(state, gains, now)

    def _run(self, state: State, gains: Vec, now: float) -> Vec | None:
        """Return the safe acceleration, (3,) m/s2, or None; what is wanted stands in the row."""
        row = self.row
        row["state"] = state.flat
        row["acceleration"] = state.a
        row["gains"] = gains
        row["is_asked"] = 1
        airspace = self.traffic.airspace
        avoid_rows(
            row,
            airspace.near.listeners,
            airspace.near.motions,
            now,
            self._planes,
            self._near,
        )
        row["is_asked"] = 0
        return row["safe"][0].copy() if row["acts"][0] else None

    @property
    def cut_off(self) -> bool:
        """Whether the drone hears at most half of all flying drones, itself included."""
        return bool(self.row["is_cut_off"][0])

    @property
    def gives_way_to(self) -> int | None:
        """Id of the nearest drone that this one last gave way to; None if it braked."""
        other = int(self.row["gives_way_to"][0])
        return None if other < 0 else other


def _write_settings(row: Records, settings: CollisionTable) -> None:
    """Write the figures of [collision] to a row of AVOID_ROW, (1,)."""
    sx, sy, sz = settings.semi_axes
    row["lag"] = settings.lag
    row["delay"] = settings.delay
    row["scale"] = (1.0, sx / sy, sx / sz)
    row["width"] = 2.0 * sx + settings.margin
    row["least_width"] = 2.0 * sx
    row["brake"] = settings.brake
    row["gamma"] = settings.gamma
    row["stiffness"] = settings.stiff
    row["turn"] = settings.turn
    row["range"] = settings.range
    row["unsure"] = settings.unsure
    row["has_cells"] = settings.method == "cells"
