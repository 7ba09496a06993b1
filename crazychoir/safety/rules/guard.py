"""The watchdog of one drone: a table of rules decides what to do about stale data and positions."""

import math
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from crazychoir.config.checks import SWARM_LIMITS
from crazychoir.config.flight_room import EDGE_MARGIN as EDGE_MARGIN
from crazychoir.config.flight_room import flight_room
from crazychoir.errors import ConfigError
from crazychoir.numerics.kernels import (
    Record,
    kernel,
    matrix,
    memory,
    real,
    rows_of,
    vector,
)
from crazychoir.planning.point_to_point import STOP_DISTANCE
from crazychoir.runtime.throttle import Throttle as Throttle
from crazychoir.types import Mat, Point, State, Vec


class Action(IntEnum):
    """Actions of the drone. A larger value is a stronger action."""

    NOMINAL = 0  # fly the reference
    BRAKE = 1  # come to rest and stay, on the prediction if there is no pose
    LAND = 2  # descend where it is
    CUT = 3  # stop the motors


FENCE_INSET = 0.1
"""Distance from the sides of the fence, m, at which a drone that would leave it comes to rest."""
ACTION_TEXTS = {
    Action.BRAKE: "braking",
    Action.LAND: "landing",
    Action.CUT: "motors cut",
}
"""Text of each action in error messages."""


@dataclass(frozen=True)
class SafetyRule:
    """One row of the safety table."""

    measure: str
    """Name of the quantity that the rule watches:

    "pose": s since the last pose
    "reference": s since the last reference
    "fence": m outside the fence
    "stop": m outside the fence, now or where the drone comes to rest if it brakes now; the larger
    "limit area": m outside the limit area
    "broken": 1 if the state is not finite
    or a measure that the guard receives by `tell`, see REPORTED_MEASURES.
    """
    limit: float
    """The rule starts to act when the measure exceeds this."""
    action: Action
    """Action of the drone while the rule acts."""
    clear: float = 0.0
    """The rule acts until the measure has been at or below this for `settle` seconds."""
    settle: float = 0.5
    """Seconds at or below `clear` before the rule stops acting."""
    latched: bool = False
    """True: once the rule has acted, it acts for good."""


# Poses: 0.10 s is ten missed poses at 100 Hz, or 0.1 m at 1 m/s. After 0.50 s a prediction is
# worth little. After 2.00 s without commands the firmware cuts the motors by itself.
# Fence: the drone brakes while it can still stop inside, and lands if it does not stop there.
# The space beyond the limit area is the keep-out zone of the paper: shut down at once.
SAFETY_TABLE = (
    SafetyRule("pose", 0.10, Action.BRAKE, clear=0.05),
    SafetyRule("pose", 0.50, Action.LAND, clear=0.05, settle=1.0),
    SafetyRule("pose", 2.00, Action.CUT, latched=True),
    SafetyRule("reference", 0.30, Action.BRAKE, clear=0.15),
    SafetyRule("reference", 5.00, Action.LAND, clear=0.15, settle=1.0),
    SafetyRule("stop", 0.00, Action.BRAKE, clear=-0.05),
    SafetyRule("fence", 0.25, Action.LAND, latched=True),
    SafetyRule("limit area", 0.00, Action.CUT, latched=True),
    SafetyRule("broken", 0.00, Action.CUT, latched=True),
    SafetyRule("link", 0.50, Action.BRAKE, clear=0.30),
    SafetyRule("link", 4.00, Action.LAND, latched=True),
    SafetyRule("battery", 5.00, Action.LAND, latched=True),
    SafetyRule("empty", 0.00, Action.LAND, latched=True),
    SafetyRule("tumbled", 0.00, Action.CUT, latched=True),
    SafetyRule("body", 0.00, Action.CUT, latched=True),
    SafetyRule("gone", 0.00, Action.CUT, latched=True),
    SafetyRule("astray", 0.00, Action.LAND, latched=True),
    SafetyRule("astray", 1.00, Action.CUT, latched=True),
)
RADIO_SAFETY_TABLE = tuple(
    SafetyRule("pose", 20.0, Action.CUT, latched=True)
    if r.measure == "pose" and r.latched
    else r
    for r in SAFETY_TABLE
)
"""The table of a drone that is reached by a radio.

Without poses, its firmware lands it by its own sensors.
"""
ON_BOARD_SAFETY_TABLE = tuple(
    rule
    for rule in RADIO_SAFETY_TABLE
    if rule.measure != "link" or rule.action is not Action.BRAKE
)
"""The table of a drone that is reached by a radio and has its planner on board.

When its radio is silent it continues its plan, because no command to brake could reach it.
"""
REPORTED_MEASURES = ("link", "battery", "empty", "tumbled", "body", "astray", "gone")
"""Measures that a drone behind a radio reports by `tell`:

link: s since its last packet
battery: s since its battery voltage has been low, by the firmware of its platform
empty: V below the critical battery voltage, by the firmware of its platform
tumbled: 1 if it lies on its back, has crashed, or is locked by its firmware
body: 1 if the body that the cameras take for it does not rise when it takes off
astray: 1 if that body does not move as the drone does, 2 if the drone may not land either
gone: m outside the limit area where a body is seen for some time that is not believed to be its own
"""

MEASURE_TEXTS = {
    "pose": "pose {value:.2f} s old, limit {limit:.2f} s: {doing}",
    "reference": "reference {value:.2f} s old, limit {limit:.2f} s: {doing}",
    "fence": "{value:.2f} m outside the fence, limit {limit:.2f} m: {doing}",
    "stop": "comes to rest {value:.2f} m outside the fence, limit {limit:.2f} m: {doing}",
    "limit area": "{value:.2f} m outside the limit area, in the keep-out zone: {doing}",
    "broken": "state is not finite: {doing}",
    "link": "its radio is silent for {value:.2f} s, limit {limit:.2f} s: {doing}",
    "battery": "battery below {said} V for {value:.1f} s, limit {limit:.1f} s: {doing}",
    "empty": "battery {value:.2f} V below {said} V: {doing}",
    "body": "its body does not rise as it takes off: another drone's, or too little thrust: {doing}",
    "astray": "{said}: {doing}",
    "gone": "its body, or another, is seen {value:.2f} m outside the limit area: {doing}",
    "tumbled": "{said}tumbled, crashed or locked, as its firmware says: {doing}",
}
FENCE_EDGE_TEXT = "can just come to rest inside the fence: {doing}"


@dataclass(frozen=True)
class Fence:
    """The box in which a drone may fly."""

    low: tuple[float, float, float]
    """Lower corner: (3,) m, world."""
    high: tuple[float, float, float]
    """Upper corner: (3,) m, world."""

    @classmethod
    def box(cls, low: Point, high: Point) -> "Fence":
        """Return the box between two corners.

        low: (3,) m, world: lower corner
        high: (3,) m, world: upper corner
        Raises ConfigError unless the first corner is below the second in all three coordinates.
        """
        corners = np.array([low, high], dtype=float)
        if corners.shape != (2, 3) or not np.all(corners[0] < corners[1]):
            raise ConfigError(
                "Fence.box",
                [list(low), list(high)],
                "two corners (3,) m, the first below the second",
            )
        (a, b, c), (d, e, f) = corners.tolist()
        return cls((a, b, c), (d, e, f))

    def with_floor(self, z: float) -> "Fence":
        """Return this box with its floor at the height z in m."""
        return Fence.box((*self.low[:2], z), self.high)

    def grown(self, margin: float) -> "Fence":
        """Return this box with its sides moved outwards by `margin` m."""
        return Fence.box(
            [x - margin for x in self.low], [x + margin for x in self.high]
        )

    def outside(self, x: float, y: float, z: float) -> float:
        """Return by how many m a position is outside: the largest over the six sides.

        Negative inside.
        """
        a = self.low
        b = self.high
        return max(a[0] - x, x - b[0], a[1] - y, y - b[1], a[2] - z, z - b[2])

    def nearest(self, p: Vec, inset: float = FENCE_INSET) -> Vec:
        """Return the place inside, `inset` m from the sides, that is nearest to p.

        p: (3,) m, world
        Returns (3,) m: where a drone at p is held.
        """
        return np.clip(p, np.array(self.low) + inset, np.array(self.high) - inset)


FENCE_BELOW_GROUND = 0.2
"""Depth in m below the ground where the fence of a drone that takes off or lands begins.

Cameras and floors are not exact.
"""
REACTION_TIME = 0.1
"""Seconds that a drone flies on at its speed after the command to brake.

These are the delays of filter, commands and attitude.
"""
DEFAULT_FENCE = Fence.box((-3.0, -3.0, -0.2), (3.0, 3.0, 2.5))
"""Default fence."""


@dataclass(frozen=True)
class SafetyVerdict:
    """The action of the drone, and its reason."""

    action: Action
    """Action of the drone."""
    reason: str = ""
    """Text of the rule that acts; empty when all is well."""
    measure: str = ""
    """Name of the measure of the rule that acts; empty when all is well."""


ALL_WELL = SafetyVerdict(Action.NOMINAL)

GUARD_ROW = np.dtype(
    [
        (
            "is_alert",
            np.int64,
        ),  # 1: a rule acts, or a reported measure is beyond a limit
        ("pose_limit", np.float64),  # s, least limit of "pose"
        ("reference_limit", np.float64),  # s, least limit of "reference"
        ("stop_limit", np.float64),  # m, least limit of "stop", "fence", "limit area"
        ("reach", np.float64),  # s2/m, of `_compute_overshoot`
        ("flying_box", np.float64, (6,)),  # m, lower corner, then upper corner
        ("low_box", np.float64, (6,)),  # m, the same while it takes off or lands
    ]
)
"""The limits of a guard beyond which a rule of its table may act."""

GuardRows = npt.NDArray[np.void]
"""(n,) records of GUARD_ROW."""


@kernel(vector, vector, real)
def _compute_overshoot(x: Vec, box: Vec, reach: float) -> float:
    """Return the measure "stop": m outside the box, now or where the drone comes to rest.

        p + (reach |v| + REACTION_TIME) v

    x: (13,): state of the drone
    box: (6,) m: lower corner, then upper corner
    reach: s2/m, 0 if the drone flies a plan of its own that ends inside
    Returns a negative number inside, and a number that is not finite if x is not finite.
    """
    far = (
        reach * math.sqrt(x[3] * x[3] + x[4] * x[4] + x[5] * x[5]) + REACTION_TIME
        if reach > 0.0
        else 0.0
    )
    furthest = -math.inf
    finite = 0.0
    for c in range(3):
        ahead = far * x[3 + c]
        furthest = max(
            furthest,
            max(box[c] - x[c] - min(ahead, 0.0), x[c] + max(ahead, 0.0) - box[3 + c]),
        )
    for c in range(13):
        finite += 0.0 * x[c]
    return furthest + finite


@kernel()
def compute_stop_overshoot(
    row: Record, x: Vec, follows_reference: bool, is_low: bool
) -> float:
    """Return the measure "stop" of a drone, m.

    row: of GUARD_ROW
    x: (13,): state of the drone
    follows_reference: whether it follows a reference; else it flies a plan that ends inside
    is_low: whether it takes off or lands
    """
    reach = row.reach if follows_reference else 0.0
    if is_low:
        return float(_compute_overshoot(x, row.low_box[:], reach))
    return float(_compute_overshoot(x, row.flying_box[:], reach))


@kernel()
def is_quiet(
    row: Record, x: Vec, pose_age: float, reference_age: float, is_low: bool
) -> bool:
    """Return whether no rule of the table acts, or may begin to act.

    row: of GUARD_ROW
    x: (13,): state of the drone
    pose_age: s
    reference_age: s, negative for a drone that needs no reference
    is_low: whether the drone takes off or lands
    """
    stop = compute_stop_overshoot(row, x, reference_age >= 0.0, is_low)
    return bool(
        row.is_alert == 0
        and pose_age <= row.pose_limit
        and reference_age <= row.reference_limit
        and stop <= row.stop_limit
    )


@kernel(rows_of(GUARD_ROW), vector, real, real, real, memory)
def _check_row(
    rows: GuardRows,
    x: Vec,
    pose_age: float,
    reference_age: float,
    low: float,
    out: Vec,
) -> bool:
    """Apply `is_quiet` to the only record of `rows`, and write the measure "stop" to out[0]."""
    out[0] = compute_stop_overshoot(rows[0], x, reference_age >= 0.0, low > 0.0)
    return bool(is_quiet(rows[0], x, pose_age, reference_age, low > 0.0))


@kernel(matrix, vector, memory)
def _fill_overshoots(rows: Mat, box: Vec, out: Vec) -> None:
    """Compute the measure "stop" of each set-point of a path that brakes by itself.

    rows: (n, 6 or more): p and v of each set-point
    box: (6,) m: lower corner, then upper corner
    out: (n,) m: the result
    """
    for k in range(rows.shape[0]):
        out[k] = _compute_overshoot(rows[k], box, 0.0)


class Guard:
    """Judges one drone in every tick: all acting rules of the table compete, the worst action wins.

    A rule starts to act when its measure exceeds its limit. It stops after `settle` seconds at or
    below `clear`. A latched rule never stops: an operator looks at the drone and starts its agent
    again.

    A drone that follows references brakes at the distance STOP_DISTANCE |v|^2 / a_max from the fence that
    `stopping` needs, REACTION_TIME s earlier, and so comes to rest at the fence. A drone that flies a
    plan of its own, which ends inside, brakes at the fence itself.

    fence: where the drone flies
    table: the rules
    a_max: m/s2: acceleration with which the drone brakes
    ground: m: height of the ground. To take off and to land, the drone leaves the fence downwards.
        Until then no rule but "stop" knows the floor of the fence.
    limit: area outside which the motors are cut, None for SWARM_LIMITS.limit_area_margin m around the fence
    rows: (1,) record of GUARD_ROW in the batch of the drone, None for a record of its own
    Raises ConfigError for a table with an unknown measure, or with `clear` above `limit`.
    """

    def __init__(
        self,
        fence: Fence = DEFAULT_FENCE,
        table: tuple[SafetyRule, ...] = SAFETY_TABLE,
        a_max: float = 2.0,
        ground: float = 0.0,
        limit: Fence | None = None,
        rows: GuardRows | None = None,
    ) -> None:
        for rule in table:
            if rule.measure not in MEASURE_TEXTS or (
                rule.clear > rule.limit and not rule.latched
            ):
                raise ConfigError(
                    "Guard: table",
                    rule,
                    f"a measure of {', '.join(MEASURE_TEXTS)}; clear at or below limit",
                )
        self.table = self._own = table
        # The rules that act, and since when the measure of each has been clear.
        self._acting: dict[SafetyRule, float] = {}
        self._found: dict[
            SafetyRule, float
        ] = {}  # The last value for which a rule acted.
        self._latched: dict[
            SafetyRule, str
        ] = {}  # The latched rules that have acted, and the text of each.
        least = {
            m: min((r.limit for r in table if r.measure == m), default=math.inf)
            for m in MEASURE_TEXTS
        }
        self._least = least
        self._told: dict[str, float] = dict.fromkeys(REPORTED_MEASURES, -math.inf)
        self._said: dict[str, str] = {}
        self._told_well = True
        self._whole = fence.with_floor(min(fence.low[2], ground - FENCE_BELOW_GROUND))
        limit = (
            self._whole.grown(SWARM_LIMITS.limit_area_margin)
            if limit is None
            else limit
        )
        self._limit = limit.with_floor(
            min(limit.low[2], self._whole.low[2] - SWARM_LIMITS.limit_area_margin)
        )
        self._rows: GuardRows = np.zeros(1, GUARD_ROW) if rows is None else rows
        row = self._rows[0]
        row["pose_limit"] = least["pose"]
        row["reference_limit"] = least["reference"]
        row["stop_limit"] = min(least["fence"], least["stop"], least["limit area"])
        row["reach"] = STOP_DISTANCE / a_max
        row["flying_box"] = (*fence.low, *fence.high)
        row["low_box"] = (*self._whole.low, *self._whole.high)
        self._stop = np.empty(1)
        drives = fence.low[2] < ground
        self.room = Fence(
            *flight_room(fence.low, fence.high, None if drives else ground)
        )
        """The box into which a drone may be sent: nowhere inside does this guard brake it."""

    @property
    def latched(self) -> str:
        """The reason of the first latched rule that acted; empty if none has.

        While it is not empty, this drone must not fly again.
        """
        return next(iter(self._latched.values()), "")

    def check(
        self,
        now: float,
        state: State | None,
        pose_age: float,
        reference_age: float | None = None,
        low: bool = False,
    ) -> SafetyVerdict:
        """Return the verdict at the time `now`.

        now: s
        state: None if the drone was never seen
        pose_age: s
        reference_age: s, None if the drone needs no reference
        low: whether the drone takes off or lands
        """
        if state is None:
            age = 0.0 if reference_age is None else reference_age
            return self._judge(now, self._measured(state, pose_age, age, -math.inf))
        age = -1.0 if reference_age is None else max(reference_age, 0.0)
        if _check_row(self._rows, state.flat, pose_age, age, float(low), self._stop):
            return ALL_WELL
        stop = float(self._stop[0])
        return self._judge(now, self._measured(state, pose_age, max(age, 0.0), stop))

    def leaves_room(self, path: Mat) -> Vec:
        """Return how far outside `room` each set-point of a path is.

        This is the measure "stop" of the table for a drone on its own plan, which ends inside, so that
        no braking distance is added.

        path: (n, 14), rows as FullState.flat
        Returns (n,) m, negative inside.
        """
        out = np.empty(len(path))
        _fill_overshoots(
            np.ascontiguousarray(path), np.array([*self.room.low, *self.room.high]), out
        )
        return out

    def tell(self, measure: str, value: float, said: str = "") -> None:
        """Set the current value of a measure of REPORTED_MEASURES.

        measure: one of REPORTED_MEASURES
        value: in the unit of the measure
        said: text for the place {said} in the reason that its rule reports
        """
        self._told[measure] = value
        self._said[measure] = said
        self._told_well = all(
            value <= self._least[m] for m, value in self._told.items()
        )
        self._note_alert()

    def _note_alert(self) -> None:
        """Write to the record whether a rule may act without a change of state or age."""
        self._rows[0]["is_alert"] = bool(self._acting) or not self._told_well

    def told(self, measure: str) -> float:
        """Return the current value of a measure of REPORTED_MEASURES."""
        return self._told[measure]

    def beyond(self, p: Vec) -> float:
        """Return by how many m the position p, (3,) m, is outside the limit area."""
        return self._limit.outside(*p.tolist())

    @property
    def acts(self) -> bool:
        """Whether a rule acts, or has not settled yet."""
        return bool(self._acting)

    def excuse(self, measure: str) -> None:
        """Stop the rules of a measure that no longer matters; latched rules stay."""
        self._acting = {
            rule: since
            for rule, since in self._acting.items()
            if rule.measure != measure or rule.latched
        }
        self._note_alert()

    def forget(self) -> None:
        """Stop all rules except the latched ones, because a flight begins or is over."""
        self._acting = {
            rule: since for rule, since in self._acting.items() if rule.latched
        }
        self.table = self._own
        self._note_alert()

    def bear_unseen(self, seconds: float) -> None:
        """Do not cut the motors of an unseen drone before `seconds` s without a pose.

        This holds until the drone has landed.
        """
        cuts = ("pose", Action.CUT)
        self.table = tuple(
            replace(rule, limit=max(rule.limit, seconds))
            if (rule.measure, rule.action) == cuts
            else rule
            for rule in self._own
        )

    def _measured(
        self, state: State | None, pose_age: float, reference_age: float, stop: float
    ) -> dict[str, float]:
        """Return the value of each measure of the table."""
        outside = -math.inf
        beyond = -math.inf
        broken = 0.0
        if state is not None:
            x, y, z, *rest = state.flat.tolist()
            outside = self._whole.outside(x, y, z)
            beyond = self._limit.outside(x, y, z)
            broken = 0.0 if math.isfinite(x + y + z + sum(rest)) else 1.0
        return {
            "pose": pose_age,
            "reference": reference_age,
            "fence": outside,
            "stop": stop,
            "limit area": beyond,
            "broken": broken,
            **self._told,
        }

    def _judge(self, now: float, values: dict[str, float]) -> SafetyVerdict:
        """Start and stop rules, then return the verdict of the worst acting rule."""
        for rule in self.table:
            value = values[rule.measure]
            if not value <= rule.limit:  # a NaN is beyond every limit
                self._acting[rule] = math.inf
                self._found[rule] = value
                if rule.latched:
                    self._latched.setdefault(
                        rule,
                        _describe_reason(rule, value, self._said.get(rule.measure, "")),
                    )
            elif rule in self._acting:
                self._settle(rule, value, now)
        self._note_alert()
        worst = max(self._acting, key=lambda rule: rule.action, default=None)
        if worst is None:
            return ALL_WELL
        return SafetyVerdict(
            worst.action,
            self._latched.get(worst) or _describe_reason(worst, self._found[worst]),
            worst.measure,
        )

    def _settle(self, rule: SafetyRule, value: float, now: float) -> None:
        """Stop a rule when its measure has been clear for long enough."""
        if rule.latched:
            return
        since = min(self._acting[rule], now) if value <= rule.clear else math.inf
        self._acting[rule] = since
        if now - since >= rule.settle:
            del self._acting[rule]


def _describe_reason(rule: SafetyRule, value: float, said: str = "") -> str:
    """Return the text of a rule: what was found, the limit, and what is done."""
    at_edge = rule.measure == "stop" and abs(value) < EDGE_MARGIN
    text = (FENCE_EDGE_TEXT if at_edge else MEASURE_TEXTS[rule.measure]).format(
        value=value, limit=rule.limit, doing=ACTION_TEXTS[rule.action], said=said
    )
    return f"{text}, for good" if rule.latched else text
