"""The collision filter of one drone: its record for the stage *avoid*, and states from others."""

import numpy as np

from crazychoir.config.tables import CollisionTable
from crazychoir.safety.airspace.neighbours import Neighbours
from crazychoir.safety.airspace.relayed_states import RelayedStates
from crazychoir.safety.collision.deadlock import reset_side
from crazychoir.safety.rules.guard import Fence
from crazychoir.types import Records


class CollisionFilter:
    """Writes the figures of a drone into its record, and holds the states that others relay to it.

    The stage `avoid_drones` of a tick reads the record, and `avoid_row` computes the safe
    acceleration.

    settings: [collision]
    traffic: what this drone knows of the others
    fence: from the floor upwards
    a_max: m/s2, with which the drone brakes
    v_max: m/s, largest speed of the others
    ground: m, height of the ground
    row: (1,) AVOID_ROW of this drone, part of the rows of its process
    """

    def __init__(
        self,
        settings: CollisionTable,
        traffic: Neighbours,
        fence: Fence,
        a_max: float,
        v_max: float,
        ground: float,
        row: Records,
    ) -> None:
        self.traffic = traffic
        self.hearsay = RelayedStates(traffic)
        """The states that other drones relay to this one."""
        box = np.array([*fence.low, *fence.high])
        row["box"] = box + np.repeat([1.0, -1.0], 3) * settings.margin
        row["largest_horizontal"] = 1.5 * a_max
        row["largest_vertical"] = a_max
        row["v_max"] = v_max
        row["silent_gap"] = traffic.airspace.rules["silent_gap"][0]
        row["ground"] = ground
        row["listener"] = traffic.listener
        row["gives_way_to"] = -1
        _write_settings(row, settings)
        reset_side(row, traffic.port.address)


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
