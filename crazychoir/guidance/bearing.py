"""Bearing formations before they fly: is the formation rigid, how slow is it, does the attitude loop bear it?"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crazychoir.control.gains import FORMATION, HOLD, Gains
from crazychoir.control.margin import (
    RATE_LAG,
    REQUIRED,
    Inner,
    command_loop,
    delay_margin,
    guidance_loop,
    vertical_loop,
)
from crazychoir.errors import ConfigError, Refused
from crazychoir.math3d import Mat, projector
from crazychoir.types import Point

Shape = Mapping[int, Point]
Neighbors = Mapping[int, Collection[int]]
# The paper's example, four drones, edges 01 03 12 13 23, leaders 0 and 1, behind FORMATION: 1 cm in 13 s.
KP, KV = 1.6, 4.6
SLOWEST = 0.02  # 1/s, a formation slower than this needs minutes and is flown only if that is wanted
FLEXIBLE = 1e-9  # of the largest eigenvalue: below this an eigenvalue is taken for zero
LEVEL = 1e-6  # a mode with a smaller horizontal part moves in height only


def bearing_laplacian(shape: Shape, neighbors: Neighbors, leaders: Collection[int]) -> tuple[Mat, Mat, list[int]]:
    """Rows of the bearing Laplacian that belong to the followers.

        [B]_ij = - P_ij,  [B]_ii = sum_j P_ij,  j in N_i,  P_ij = I - g_ij g_ij^T,  g_ij along shape_j - shape_i

    shape: {id: (3,) m};  neighbors: {id: those that id hears}.
    Returns B_ff (3 F, 3 F), B_fl (3 F, 3 L), both in ascending ids, and the followers.
    Source: Zhao & Zelazo 2017, IEEE TCNS 4(3).
    """
    ids = sorted(shape)
    at = {i: np.asarray(shape[i], dtype=float) for i in ids}
    row = {i: slice(3 * n, 3 * n + 3) for n, i in enumerate(ids)}
    b = np.zeros((3 * len(ids), 3 * len(ids)))
    for i in ids:
        for j in sorted(neighbors.get(i, ())):
            if j not in at or np.allclose(at[i], at[j]):
                raise ConfigError(f"neighbors of drone {i}", j, f"a drone of the shape at another place; it has {ids}")
            p = projector(at[j] - at[i])
            b[row[i], row[i]] += p
            b[row[i], row[j]] -= p
    followers = [i for i in ids if i not in leaders]
    f = _indices(row, followers)
    return b[np.ix_(f, f)], b[np.ix_(f, _indices(row, [i for i in ids if i in leaders]))], followers


def _indices(row: Mapping[int, slice], ids: Sequence[int]) -> list[int]:
    """Rows of the coordinates of these drones."""
    return [n for i in ids for n in range(row[i].start, row[i].stop)]


def slowest_mode(eigenvalues: Sequence[complex], kp: float, kv: float) -> float:
    """Rate in 1/s at which the slowest mode decays: the smallest -Re s over s^2 + kv l s + kp l = 0."""
    return float(min(-np.roots([1.0, kv * e, kp * e]).real.max() for e in eigenvalues))


@dataclass(frozen=True)
class FormationReport:
    """What a bearing formation will do.

    lambda_min, lambda_max: of B_ff;  slowest: 1/s, the rate of the slowest mode;
    margin: s, the delay that the most delicate mode bears;  warnings: what to look at.
    """

    lambda_min: float
    lambda_max: float
    slowest: float
    margin: float
    warnings: tuple[str, ...] = ()


def check_formation(
    shape: Shape,
    neighbors: Neighbors,
    leaders: Collection[int],
    kp: float,
    kv: float,
    *,
    gains: Gains = FORMATION,
    lag: float = RATE_LAG,
    force: bool = False,
) -> FormationReport:
    """What the bearing law with these gains will do on this graph; Refused if it cannot work.

    kp: 1/s2;  kv: 1/s;  gains: of the controller;  lag: s, of the body rates;  force: fly it though very slow.
    Refused: not bearing-rigid; slower than 0.02 1/s without force; unstable behind the attitude loop.
    """
    b_ff, _, followers = bearing_laplacian(shape, neighbors, leaders)
    if not followers:
        raise Refused("bearing formation", "every drone is a leader. Name only those that are to stand still.")
    values, vectors = np.linalg.eig(b_ff)
    size = np.abs(values)
    if size.min() <= FLEXIBLE * max(size.max(), 1.0):
        raise Refused("bearing formation", _flexible(vectors[:, size.argmin()], followers, sorted(leaders)))
    slowest = slowest_mode(values.tolist(), kp, kv)
    if slowest < SLOWEST and not force:
        raise Refused("bearing formation", _slow(float(size.min()), slowest))
    horizontal = np.abs(vectors.reshape(-1, 3, len(values))[:, :2]).max(axis=(0, 1)) > LEVEL
    fastest = float(size.max())
    margin = mode_margin(size.tolist(), horizontal.tolist(), kp, kv, gains, lag)
    if margin <= 0.0:
        raise Refused("bearing formation", _fast(kv * fastest, "unstable", gains, lag))
    warnings = [_slow(float(size.min()), slowest)] if slowest < SLOWEST else []
    if margin < REQUIRED:
        warnings.append(_fast(kv * fastest, f"left with {1e3 * margin:.0f} ms of delay margin", gains, lag))
    return FormationReport(float(size.min()), fastest, slowest, margin, tuple(warnings))


def mode_margin(
    eigenvalues: Sequence[float],
    horizontal: Sequence[bool],
    kp: float,
    kv: float,
    gains: Gains = FORMATION,
    lag: float = RATE_LAG,
) -> float:
    """Smallest delay margin in s over the modes l, each with the gains kp l, kv l.

    A horizontal mode acts through the attitude; its delay may enter with the neighbours' data (guidance_loop) or with
    everything (command_loop). A mode in height alone acts through the thrust, of the same lag. Half a tick of 100 Hz
    is spent already; velocities come through a filter of 50 rad/s.
    """
    inner = Inner(min(gains.kr[:2]), lag, lead=gains.lead, lead_cutoff=gains.lead_cutoff)
    loops = []
    for e, tilts in zip(eigenvalues, horizontal, strict=True):
        if tilts:
            loops += [command_loop(kp * e, kv * e, inner), guidance_loop(kp * e, kv * e, inner)]
        else:
            loops.append(vertical_loop(kp * e, kv * e, lag))
    return max(min(map(delay_margin, loops), default=math.inf) - HOLD, 0.0)


def _flexible(mode: Mat, followers: list[int], leaders: list[int]) -> str:
    """Why a graph that is not bearing-rigid is refused, naming the drones that nothing holds."""
    loose = [i for i, part in zip(followers, np.abs(mode).reshape(-1, 3).max(axis=1), strict=True) if part > 1e-3]
    return (
        f"the graph is not bearing-rigid with leaders {leaders}: drones {loose} can move without changing a bearing "
        "(the smallest eigenvalue of B_ff is 0). Add a diagonal neighbour, or take other or more leaders."
    )


def _slow(lambda_min: float, slowest: float) -> str:
    return (
        f"its slowest mode decays at {slowest:.4f} 1/s (time constant {1.0 / slowest:.0f} s; smallest eigenvalue "
        f"{lambda_min:.4f}), below {SLOWEST} 1/s. Add diagonals, take leaders at opposite corners, or force it."
    )


def _fast(speed: float, found: str, gains: Gains, lag: float) -> str:
    return (
        f"kv * lambda_max = {speed:.1f} 1/s is {found} behind an attitude loop of KR = {gains.kr[0]:g} 1/s "
        f"and {1e3 * lag:.0f} ms of lag; {1e3 * REQUIRED:.0f} ms are required. Lower kv, or remove neighbours."
    )
