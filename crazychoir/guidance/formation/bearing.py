"""Checks of a bearing formation before the flight: rigidity, convergence rate and stability."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import splu

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
from crazychoir.guidance.formation.spectrum import (
    SparseMatrix,
    Spectrum,
    find_all,
    find_extremes,
    is_symmetric,
)
from crazychoir.numerics.math3d import projector
from crazychoir.types import Mat, Point, Vec

Neighbors = Mapping[int, Collection[int]]
"""By drone: the ids that it hears."""
Indices = npt.NDArray[np.int64]
"""Rows of drones or of their coordinates."""
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
) -> tuple[SparseMatrix, SparseMatrix, list[int]]:
    """Return the rows of the bearing Laplacian that belong to the followers.

        [B]_ij = - P_ij,   [B]_ii = sum_j P_ij,   j in N_i
        P_ij = I - g_ij g_ij^T,   g_ij along shape_j - shape_i

    shape: {id: (3,) m}.
    neighbors: {id: ids that it hears}.
    leaders: ids of the leaders.
    Returns B_ff (3 F, 3 F), B_fl (3 F, 3 L), both sparse and in ascending ids, and the ids of the
    followers.
    Raises ConfigError for a neighbour that is not in the shape, or at the same place.
    Source: Zhao & Zelazo 2017, IEEE TCNS 4(3).
    """
    ids = sorted(shape)
    row = {i: n for n, i in enumerate(ids)}
    arcs = _list_arcs(shape, neighbors, row)
    at = np.array([shape[i] for i in ids], dtype=float)
    d = at[arcs[:, 1]] - at[arcs[:, 0]]
    p = np.eye(3) - d[:, :, None] * d[:, None, :] / (d * d).sum(axis=1)[:, None, None]
    diagonal = np.zeros((len(ids), 3, 3))
    np.add.at(diagonal, arcs[:, 0], p)
    own = np.arange(len(ids))
    b = _join_blocks(
        np.concatenate([diagonal, -p]),
        np.concatenate([own, arcs[:, 0]]),
        np.concatenate([own, arcs[:, 1]]),
        len(ids),
    )
    followers = [i for i in ids if i not in leaders]
    rows = b[_list_coordinates(row, followers)]
    return (
        rows[:, _list_coordinates(row, followers)],
        rows[:, _list_coordinates(row, [i for i in ids if i in leaders])],
        followers,
    )


def _list_arcs(shape: Shape, neighbors: Neighbors, row: Mapping[int, int]) -> Indices:
    """Return (E, 2): the rows of each drone and of a drone that it hears.

    Raises ConfigError for a neighbour that is not in the shape, or at the same place.
    """
    pairs = [(i, j) for i in row for j in sorted(neighbors.get(i, ()))]
    for i, j in pairs:
        if j not in row or all(map(_is_close, shape[i], shape[j])):
            raise ConfigError(
                f"neighbors of drone {i}",
                j,
                f"a drone of the shape at another place; it has {list(row)}",
            )
    arcs = [(row[i], row[j]) for i, j in pairs]
    return np.array(arcs, dtype=np.int64).reshape(-1, 2)


def _is_close(a: float, b: float) -> bool:
    """Return whether two coordinates in m are the same, as np.allclose judges."""
    return abs(a - b) <= 1e-8 + 1e-5 * abs(b)


def _join_blocks(
    blocks: Mat, rows: Indices, columns: Indices, size: int
) -> SparseMatrix:
    """Return the (3 size, 3 size) matrix of these (3, 3) blocks, each at a place of its own."""
    inside = np.arange(3)
    down = 3 * rows[:, None, None] + inside[None, :, None] + 0 * inside[None, None, :]
    across = 3 * columns[:, None, None] + 0 * inside[None, :, None] + inside
    entries = (blocks.ravel(), (down.ravel(), across.ravel()))
    return sparse.coo_array(entries, shape=(3 * size, 3 * size)).tocsr()


def _list_coordinates(row: Mapping[int, int], ids: Sequence[int]) -> list[int]:
    """Return the rows of the coordinates of these drones."""
    return [3 * row[i] + axis for i in ids for axis in range(3)]


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


def list_diagonal_blocks(b_ff: SparseMatrix, followers: Sequence[int]) -> Mat:
    """Return (F, 3, 3): the blocks K_i = sum_j P_ij on the diagonal of B_ff.

    Raises Refused, with the drones, if K_i has no inverse: all bearings of i are parallel, and
    nothing holds the drone along them.
    """
    own = 3 * np.arange(len(followers))[:, None]
    corner = np.arange(3)
    down = np.repeat(own + corner, 3, axis=1)
    across = np.tile(own + corner, 3)
    blocks: Mat = np.asarray(b_ff[down.ravel(), across.ravel()]).reshape(-1, 3, 3)
    least = np.linalg.eigvalsh(blocks)[:, 0]
    alone = [
        i
        for i, value in zip(followers, least, strict=True)
        if value < ZERO_EIGENVALUE_SHARE
    ]
    if alone:
        raise Refused("bearing formation", _explain_parallel(alone))
    return blocks


def normalise_laplacian(b_ff: SparseMatrix, followers: Sequence[int]) -> SparseMatrix:
    """Return K^-1 B_ff (3 F, 3 F), with the blocks K_i = sum_j P_ij on the diagonal of B_ff.

    An eigenvalue l is the share of a mode that depends on leaders. 1 - l of it comes from other
    followers.
    Raises Refused as `list_diagonal_blocks` does.
    """
    inverse = np.linalg.inv(list_diagonal_blocks(b_ff, followers)).astype(np.float64)
    return _place_on_diagonal(inverse) @ b_ff


def _place_on_diagonal(blocks: Mat) -> SparseMatrix:
    """Return the matrix with these (F, 3, 3) blocks on its diagonal."""
    own = np.arange(len(blocks))
    return _join_blocks(blocks, own, own, len(blocks))


def analyse_normalised_law(
    b_ff: SparseMatrix, followers: Sequence[int], every: bool
) -> Spectrum:
    """Return the eigenvalues of K^-1 B_ff.

        K^-1 B_ff = K^-1/2 ( K^-1/2 B_ff K^-1/2 ) K^1/2

    If all followers hear each other the matrix in the brackets is symmetric, so they are real, and
    none is above 2, because |x_i - x_j|^2 <= 2 |x_i|^2 + 2 |x_j|^2.

    every: return all; else the smallest and the largest suffice.
    Raises Refused as `list_diagonal_blocks` does.
    """
    if not is_symmetric(b_ff):
        return find_all(normalise_laplacian(b_ff, followers))
    size, axes = np.linalg.eigh(list_diagonal_blocks(b_ff, followers))
    halves: Mat = (axes / np.sqrt(size)[:, None, :]) @ axes.mT
    root = _place_on_diagonal(halves)
    similar = root @ b_ff @ root
    similar = 0.5 * (similar + similar.T)
    found = find_all(similar) if every else find_extremes(similar, 2.0)
    return _transform_vectors(root, found)


def analyse_paper_law(
    b_ff: SparseMatrix, followers: Sequence[int], in_height: float
) -> Spectrum:
    """Return all eigenvalues of D B_ff, with D = diag(1, 1, in_height) for each drone.

    If all followers hear each other they are those of the symmetric D^1/2 B_ff D^1/2.
    Raises Refused as `list_diagonal_blocks` does.
    """
    list_diagonal_blocks(b_ff, followers)
    share = np.tile([1.0, 1.0, in_height], len(followers))
    if not is_symmetric(b_ff):
        return find_all(sparse.diags_array(share).tocsr() @ b_ff)
    root = sparse.diags_array(np.sqrt(share)).tocsr()
    return _transform_vectors(root, find_all(root @ b_ff @ root))


def _transform_vectors(root: SparseMatrix, found: Spectrum) -> Spectrum:
    """Return the spectrum of root S root^-1 from the spectrum of S, with unit eigenvectors."""
    vectors = root @ found.vectors
    return Spectrum(found.values, vectors / np.linalg.norm(vectors, axis=0))


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
    pulls = b_fl @ np.concatenate([*led.values()])
    p = -splu(b_ff.tocsc()).solve(pulls).reshape(-1, 3)
    return led | dict(zip(followers, p, strict=True))


def find_distortion(
    shape: Shape, neighbors: Neighbors, places: Mapping[int, Vec]
) -> tuple[float, int, int]:
    """Return the largest angle between a bearing of the formation and that of the shape, and its drones i, j.

    The angle is in rad, from drone i to its neighbour j. Formations that are moved or scaled have none.

    shape: {id: (3,) m}.
    neighbors: {id: ids that it hears}.
    places: {id: (3,) m}, the formation.
    """
    angles = []
    for i, heard in neighbors.items():
        for j in heard:
            wanted = np.subtract(shape[j], shape[i])
            found = places[j] - places[i]
            sine = float(np.linalg.norm(np.cross(wanted, found)))
            angles.append((math.atan2(sine, float(wanted @ found)), i, j))
    return max(angles, default=(0.0, 0, 0))


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
    modes = (
        analyse_normalised_law(b_ff, followers, every=moving)
        if is_normalised
        else analyse_paper_law(b_ff, followers, law.in_height)
    )
    values = modes.values
    size = np.abs(values)
    if size.min() <= ZERO_EIGENVALUE_SHARE * max(size.max(), 1.0):
        raise Refused(
            "bearing formation",
            _explain_flexible(modes.softest, followers, sorted(leaders)),
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
            np.abs(modes.vectors.reshape(-1, 3, len(values))[:, :2]).max(axis=(0, 1))
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
