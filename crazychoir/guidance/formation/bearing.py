"""Checks of a bearing formation before the flight: rigidity, convergence rate and stability."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from crazychoir.control.gains import AGILE_GAINS, FORMATION_GAINS
from crazychoir.control.margin import REQUIRED_DELAY_MARGIN
from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance.formation.modes import (
    LEAST_HORIZONTAL_PART,
    AccelerationChain,
    compute_age_margin,
    compute_mode_margin,
    compute_slowest_mode,
    compute_slowest_normalised_mode,
)
from crazychoir.guidance.formation.shapes import Shape
from crazychoir.numerics.math3d import projector
from crazychoir.types import Mat, Point, Vec

Neighbors = Mapping[int, Collection[int]]
"""By drone: the ids that it hears."""
Law = Literal["paper", "normalised"]
"""The paper's law, or the normalised law."""


@dataclass(frozen=True, slots=True)
class BearingGains:
    """Gains of the bearing laws: of the paper's law for its example, of the same law for drones
    with rate loops on board, and of the normalised law.
    """

    kp: float = 1.6
    """1/s2: gain of the paper's law for the paper's example.

    The example has four drones, edges 01 03 12 13 23 and leaders 0 and 1. Its body rates may be as late
    as RATE_LAG.
    """
    kv: float = 4.6
    """1/s: velocity gain of the paper's law for the same example."""
    kp_on_motors: float = 4.0
    """1/s2: `kp` for drones with rate loops on board."""
    kv_on_motors: float = 6.0
    """1/s: `kv` for drones with rate loops on board."""
    height_share: float = 0.5
    """Share of the paper's gains that holds the height.

    Thrust follows later than attitude. If all drones fly at one height, all their edges hold that
    height, so its modes are faster.
    """
    kp_normalised: float = 8.0
    """1/s2: gain of the normalised law, for any graph."""
    kv_normalised: float = 4.5
    """1/s: velocity gain of the normalised law, for any graph."""


BEARING_GAINS = BearingGains()


@dataclass(frozen=True, slots=True)
class BearingLaw:
    """A law of the followers, and its gains.

    The modes of the paper's law are s^2 + kv l s + kp l, with l an eigenvalue of B_ff. All modes of
    the normalised law are s^2 + kv s + kp, on any graph. Therefore it is the default.

    The normalised law uses the accelerations that neighbours commanded in the tick before. It
    therefore takes their positions and velocities from that tick too, and holds all three together
    when messages are lost. Equal delays cancel out, while unequal delays delay the modes of a large
    graph. If leaders move, equal delays would add up with each neighbour on the way. Then the law
    takes the newest positions and velocities.
    """

    kind: Law = "normalised"
    """The paper's law, or the normalised law."""
    kp: float = BEARING_GAINS.kp_normalised
    """1/s2."""
    kv: float = BEARING_GAINS.kv_normalised
    """1/s."""
    in_height: float = 1.0
    """Share of kp and kv in height, for the paper's law."""


NORMALISED_LAW = BearingLaw()
"""The normalised law with its default gains."""


SLOWEST_DECAY_RATE = 0.02
"""1/s: a slower formation needs minutes, and flies only with `force`."""
ZERO_EIGENVALUE_SHARE = 1e-9
"""Share of the largest eigenvalue below which an eigenvalue counts as zero."""


def build_bearing_laplacian(
    shape: Shape, neighbors: Neighbors, leaders: Collection[int]
) -> tuple[Mat, Mat, list[int]]:
    """Return the rows of the bearing Laplacian that belong to the followers.

        [B]_ij = - P_ij,   [B]_ii = sum_j P_ij,   j in N_i
        P_ij = I - g_ij g_ij^T,   g_ij along shape_j - shape_i

    shape: {id: (3,) m}.
    neighbors: {id: ids that it hears}.
    leaders: ids of the leaders.
    Returns B_ff (3 F, 3 F), B_fl (3 F, 3 L), both in ascending ids, and the ids of the followers.
    Raises ConfigError for a neighbour that is not in the shape, or at the same place.
    Source: Zhao & Zelazo 2017, IEEE TCNS 4(3).
    """
    ids = sorted(shape)
    at = {i: np.asarray(shape[i], dtype=float) for i in ids}
    row = {i: slice(3 * n, 3 * n + 3) for n, i in enumerate(ids)}
    b = np.zeros((3 * len(ids), 3 * len(ids)))
    for i in ids:
        for j in sorted(neighbors.get(i, ())):
            if j not in at or np.allclose(at[i], at[j]):
                raise ConfigError(
                    f"neighbors of drone {i}",
                    j,
                    f"a drone of the shape at another place; it has {ids}",
                )
            p = projector(at[j] - at[i])
            b[row[i], row[i]] += p
            b[row[i], row[j]] -= p
    followers = [i for i in ids if i not in leaders]
    f = _list_indices(row, followers)
    return (
        b[np.ix_(f, f)],
        b[np.ix_(f, _list_indices(row, [i for i in ids if i in leaders]))],
        followers,
    )


def build_edge_weights(
    i: int, shape: Shape, neighbors: Sequence[int], law: BearingLaw
) -> dict[int, Mat]:
    """Return the weights W_ij of the law of follower i.

        u_i = sum_j W_ij [ kp (p_j - p_i) + kv (v_j - v_i) + a_j ]
        paper: W_ij = D P_ij, without a_j;   normalised: W_ij = K_i^-1 P_ij,   K_i = sum_j P_ij

    D = diag(1, 1, in_height).

    shape: {id: (3,) m}, from which the bearings follow.
    neighbors: ids that drone i hears.
    Returns {j: W_ij (3, 3)}.
    """
    weights: dict[int, Mat] = {
        j: projector(np.subtract(shape[j], shape[i])) for j in neighbors
    }
    if law.kind == "normalised":
        total = np.sum(list(weights.values()), axis=0)
        return {j: np.linalg.solve(total, p) for j, p in weights.items()}
    share: Mat = np.array([[1.0], [1.0], [law.in_height]])
    return {j: share * p for j, p in weights.items()}


def _list_indices(row: Mapping[int, slice], ids: Sequence[int]) -> list[int]:
    """Return the rows of the coordinates of these drones."""
    return [n for i in ids for n in range(row[i].start, row[i].stop)]


def normalise_laplacian(b_ff: Mat, followers: Sequence[int]) -> Mat:
    """Return K^-1 B_ff (3 F, 3 F), with the blocks K_i = sum_j P_ij on the diagonal of B_ff.

    An eigenvalue l is the share of a mode that depends on leaders. 1 - l of it comes from other
    followers.
    Raises Refused, with the drones, if K_i has no inverse: all bearings of i are parallel, and
    nothing holds the drone along them.
    """
    blocks = [b_ff[k : k + 3, k : k + 3] for k in range(0, len(b_ff), 3)]
    alone = [
        i
        for i, k in zip(followers, blocks, strict=True)
        if np.linalg.eigvalsh(k)[0] < ZERO_EIGENVALUE_SHARE
    ]
    if alone:
        raise Refused("bearing formation", _explain_parallel(alone))
    return np.vstack(
        [np.linalg.solve(k, b_ff[3 * n : 3 * n + 3]) for n, k in enumerate(blocks)]
    )


def compute_equilibrium(
    shape: Shape, neighbors: Neighbors, leaders: Mapping[int, Point]
) -> dict[int, Vec]:
    """Return where each drone is when the followers are at rest and the leaders at these places.

        p_f = - B_ff^-1 B_fl p_l

    It is the shape itself, moved and scaled as its leaders are. It is distorted if the leaders'
    bearings are not those of the shape.

    shape: {id: (3,) m}.
    neighbors: {id: ids that it hears}.
    leaders: {id: (3,) m}.
    """
    b_ff, b_fl, followers = build_bearing_laplacian(shape, neighbors, leaders)
    led = {i: np.array(leaders[i], dtype=float) for i in sorted(leaders)}
    p = -np.linalg.solve(b_ff, b_fl @ np.concatenate([*led.values()])).reshape(-1, 3)
    return led | dict(zip(followers, p, strict=True))


@dataclass(frozen=True)
class FormationReport:
    """How a bearing formation will behave."""

    lambda_min: float
    """Smallest eigenvalue of B_ff, or of K^-1 B_ff for the normalised law."""
    lambda_max: float
    """Largest eigenvalue of the same matrix."""
    slowest: float
    """1/s: decay rate of the slowest mode."""
    margin: float
    """s: smallest delay margin of all modes."""
    warnings: tuple[str, ...] = ()
    """What the user should look at."""


def check_formation(
    shape: Shape,
    neighbors: Neighbors,
    leaders: Collection[int],
    law: BearingLaw,
    *,
    moving: bool = False,
    chain: AccelerationChain | None = None,
    force: bool = False,
) -> FormationReport:
    """Return how the law of the followers will behave on this graph.

    shape: {id: (3,) m}.
    neighbors: {id: ids that it hears}.
    leaders: ids of the leaders.
    law: the law of the followers, with its gains.
    moving: the leaders move, see age_margin.
    chain: what lies between law and drone. None: the slowest body rates behind the gains of the
        law.
    force: fly a formation that is very slow.
    Raises Refused if all bearings of a follower are parallel, if the graph is not bearing-rigid, if
    the formation is slower than 0.02 1/s without force, or if it is unstable.
    """
    b_ff, _, followers = build_bearing_laplacian(shape, neighbors, leaders)
    if not followers:
        raise Refused(
            "bearing formation",
            "every drone is a leader. Name only the drones that shall stand still.",
        )
    kp = law.kp
    kv = law.kv
    is_normalised = law.kind == "normalised"
    scaled = normalise_laplacian(b_ff, followers)
    matrix = (
        scaled
        if is_normalised
        else np.tile([1.0, 1.0, law.in_height], len(followers))[:, None] * b_ff
    )
    values, vectors = np.linalg.eig(matrix)
    size = np.abs(values)
    if size.min() <= ZERO_EIGENVALUE_SHARE * max(size.max(), 1.0):
        raise Refused(
            "bearing formation",
            _explain_flexible(vectors[:, size.argmin()], followers, sorted(leaders)),
        )
    least = float(size.min())
    slowest = (
        compute_slowest_normalised_mode if is_normalised else compute_slowest_mode
    )(values.tolist(), kp, kv)
    if slowest < SLOWEST_DECAY_RATE and not force:
        raise Refused("bearing formation", _explain_slow(least, slowest))
    if is_normalised:
        chain = chain or AccelerationChain(AGILE_GAINS)
        alike = compute_mode_margin([1.0, 1.0], [True, False], kp, kv, chain)
        margin = min(alike, compute_age_margin(values.tolist(), kp, kv, chain, moving))
        what = f"kp = {kp:g} 1/s2, kv = {kv:g} 1/s with a smallest eigenvalue of {least:.4f}"
    else:
        chain = chain or AccelerationChain(FORMATION_GAINS)
        horizontal = (
            np.abs(vectors.reshape(-1, 3, len(values))[:, :2]).max(axis=(0, 1))
            > LEAST_HORIZONTAL_PART
        )
        margin = compute_mode_margin(size.tolist(), horizontal.tolist(), kp, kv, chain)
        what = f"kv * lambda_max = {kv * float(size.max()):.1f} 1/s"
    if margin <= 0.0:
        raise Refused("bearing formation", _explain_fast(what, "unstable", chain))
    warnings = [_explain_slow(least, slowest)] if slowest < SLOWEST_DECAY_RATE else []
    if margin < REQUIRED_DELAY_MARGIN:
        warnings.append(
            _explain_fast(
                what, f"left with {1e3 * margin:.0f} ms of delay margin", chain
            )
        )
    return FormationReport(least, float(size.max()), slowest, margin, tuple(warnings))


def _explain_flexible(mode: Mat, followers: list[int], leaders: list[int]) -> str:
    """Return why a graph is not bearing-rigid, with the drones that nothing holds."""
    loose = [
        i
        for i, part in zip(
            followers, np.abs(mode).reshape(-1, 3).max(axis=1), strict=True
        )
        if part > 1e-3
    ]
    return (
        f"the graph is not bearing-rigid with leaders {leaders}: drones {loose} can move without changing a bearing "
        "(the smallest eigenvalue of B_ff is 0). Add a diagonal neighbour, or take other or more leaders."
    )


def _explain_slow(lambda_min: float, slowest: float) -> str:
    return (
        f"its slowest mode decays at {slowest:.4f} 1/s (time constant {1.0 / slowest:.0f} s; smallest eigenvalue "
        f"{lambda_min:.4f}), below {SLOWEST_DECAY_RATE} 1/s. Add diagonals, take leaders at "
        "opposite corners, or force it."
    )


def _explain_parallel(alone: Sequence[int]) -> str:
    drones = (
        f"drone {alone[0]}" if len(alone) == 1 else f"each of the drones {list(alone)}"
    )
    return (
        f"all bearings of {drones} are parallel: nothing holds it along them, and sum_j P_ij has no inverse. "
        "Add a neighbour in another direction, or make it a leader."
    )


def _explain_fast(what: str, found: str, chain: AccelerationChain) -> str:
    behind = (
        f"{1e3 * chain.lag:.0f} ms of lag"
        if chain.rates is None
        else "the rate loop of its motors"
    )
    return (
        f"{what} is {found} behind an attitude loop of KR = {chain.gains.kr[0]:g} 1/s and {behind}; "
        f"{1e3 * REQUIRED_DELAY_MARGIN:.0f} ms are required. Lower kv, or remove neighbours."
    )
