"""A tally of what became of the references of a law, for the result of its drone."""

from typing import Any

import numpy as np
import numpy.typing as npt

from crazychoir.guidance.decision.law_rows import TALLY_ROW
from crazychoir.types import Acceleration, FullState, Goto, Velocity


class LawTally:
    """Counts the steps of a law, and keeps why its last refused reference cannot be flown.

    drone: id of the drone.
    rows: (1,) of TALLY_ROW, which holds the counts; None: its own.
    """

    def __init__(self, drone: int, rows: npt.NDArray[Any] | None = None) -> None:
        self.drone = drone
        self.rows = np.zeros(1, TALLY_ROW) if rows is None else rows
        self.refusal = ""
        """Why the last of the refused references cannot be flown."""
        self.refused_step = 0
        """Number of the step that gave it."""

    @property
    def steps(self) -> int:
        """Steps of the law."""
        return int(self.rows["steps"][0])

    @property
    def hovered(self) -> int:
        """Steps in which the law returned None."""
        return int(self.rows["hovered"][0])

    @property
    def refused(self) -> int:
        """Steps with a reference that cannot be flown."""
        return int(self.rows["refused"][0])

    @property
    def usable(self) -> int:
        """Number of references that could be flown."""
        return self.steps - self.hovered - self.refused

    def count(self, reference: object) -> None:
        """Count a step by hand, and its return value."""
        self.rows["steps"] += 1
        self.rows["hovered"] += reference is None

    def refuse(self, why: str) -> None:
        """Count a reference that cannot be flown."""
        self.rows["refused"] += 1
        self.refusal = why
        self.refused_step = self.steps

    def list_faults(self) -> dict[str, Any]:
        """Return the entries of the drone's result about refused references; none if all is well.

        refused_references: how many could not be flown.
        refused: why, if these are most of them.
        success: False, and the `reason`, if none of them could be flown.
        """
        if not self.refused:
            return {}
        faults: dict[str, Any] = {"refused_references": self.refused}
        if self.refused > self.usable:
            faults["refused"] = self.explain_refusals()
        if not self.usable:
            faults["success"] = False
            faults["reason"] = self.explain_refusals()
        return faults

    def explain_refusals(self) -> str:
        """Return in how many steps the law gave what cannot be flown, and why the last cannot."""
        where = f"drone {self.drone}: the law gave no usable reference in {self.refused} of {self.steps} steps"
        others = self.steps - self.refused
        if others > 0 and self.hovered == others:
            where += " (None in the others)"
        return f"{where}: {self.refusal}"


def explain_wrong_return(reference: object) -> str:
    """Return why a return value of a law can never be flown."""
    numbers: list[Any]
    match reference:
        case Acceleration():
            numbers = [reference.a, reference.yaw]
            size = 3
        case FullState():
            numbers = [reference.flat]
            size = 14
        case Velocity():
            numbers = [reference.v, reference.yaw]
            size = 3
        case Goto():
            numbers = [reference.p, reference.yaw, reference.duration]
            size = 3
        case _:
            of = f" {reference.shape}" if isinstance(reference, np.ndarray) else ""
            found = f"{type(reference).__name__}{of}"
            kinds = (
                "Acceleration(...), Velocity(...), FullState(...), Goto(...) or None"
            )
            return f"step() must return {kinds}; found {found}"
    kind = type(reference).__name__
    found = " ".join(f"{numbers}"[1:-1].split())
    return f"step() must return finite numbers, {kind} of ({size},); found {kind}({found:.80})"
