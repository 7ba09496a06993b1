"""Runs of the comparison: which cases there are, the step of each algorithm, and its errors."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

import numpy as np

from crazychoir.bench.convergence.contenders import Contender, make_setting
from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.optimization.problems.shared_problem import (
    PROBLEM_SHAPE,
    make_problem,
    relative_error,
)
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import Graph, graph_from_name
from crazychoir.types import Mat, Vec

STEP_SCALES: Final = tuple(2.0**power for power in range(2, -9, -1))
"""Scales of the step that are tried: 4, 2, 1, 1/2, ..., 1/256."""
WORSE_SCALES: Final = 2
"""Scales in a row that are worse than the best before smaller ones are not tried."""
TUNING_SEEDS: Final = (1_000_001, 1_000_002)
"""Seeds of the problems on which the step is chosen; no picture shows these problems."""
LEAST_ERROR: Final = 1e-12
"""Errors below this count as this in the choice of the step: the rest is rounding."""
HIGHEST_ERROR: Final = 10.0
"""Errors above this count as this in the choice of the step."""
Say = Callable[[str], None]


@dataclass(frozen=True)
class Case:
    """A team and its network."""

    agents: int
    """Number of agents."""
    graph: str
    """Name of the communication graph."""
    loss: float
    """Share of messages that is lost."""

    def __str__(self) -> str:
        return f"{self.agents} agents, {self.graph}, {self.loss:.0%} lost"

    def make_graph(self, seed: int) -> Graph:
        """Return the graph; raise ConfigError if its name does not fit."""
        try:
            return graph_from_name(self.graph, self.agents, seed)
        except ConfigError as error:
            raise ConfigError("--graph", error.found, error.allowed, error.do) from None


@dataclass(frozen=True)
class StudyRequest:
    """What is compared, and how."""

    problem: str
    """Name of the problem."""
    rounds: int
    """Rounds of each run."""
    seeds: int
    """Number of problems for each case."""
    accuracy: float
    """Relative error that an algorithm must reach."""


@dataclass(frozen=True)
class Curve:
    """One run: errors and traffic after each round."""

    error: Vec
    """(K+1,) relative error of the team."""
    messages: Vec
    """(K+1,) messages that an agent had sent, in the mean."""
    sent_bytes: Vec
    """(K+1,) bytes that an agent had sent, in the mean."""
    failure: str = ""
    """Why the run failed; empty if it did not."""

    def find_effort(self, accuracy: float) -> dict[str, float]:
        """Return rounds, messages and bytes of an agent until the error stays below the accuracy.

        All are inf if it does not.
        """
        above = np.flatnonzero(~(self.error <= accuracy))
        first = int(above[-1]) + 1 if len(above) else 0
        if first == len(self.error):
            return dict.fromkeys(EFFORT_NAMES, np.inf)
        effort = (first, self.messages[first], self.sent_bytes[first])
        return dict(zip(EFFORT_NAMES, map(float, effort), strict=True))


EFFORT_NAMES: Final = ("rounds", "messages_an_agent", "bytes_an_agent")
"""Names of the figures of an effort."""


def list_cases(
    agents: Sequence[int], graphs: Sequence[str], losses: Sequence[float]
) -> list[Case]:
    """Return the cases: the first value of each, and then each other value alone."""
    base = Case(agents[0], graphs[0], losses[0])
    cases = [
        base,
        *(Case(base.agents, base.graph, loss) for loss in losses[1:]),
        *(Case(base.agents, graph, base.loss) for graph in graphs[1:]),
        *(Case(n, base.graph, base.loss) for n in agents[1:]),
    ]
    return list(dict.fromkeys(cases))


def run_once(
    contender: Contender, case: Case, request: StudyRequest, scale: float, seed: int
) -> Curve:
    """Run an algorithm on one random problem.

    scale: scale of the step
    seed: seed of the problem, the graph and the losses
    Raises the error of an agent, such as of a step that is too large.
    """
    problem = make_problem(request.problem, case.agents, seed)
    graph = case.make_graph(seed)
    team = contender.make_team(make_setting(problem, graph, scale, seed))
    # A run with too large a step overflows before its error names the step.
    with np.errstate(all="ignore"):
        history = simulate(
            team,
            graph,
            loss=case.loss,
            seed=seed,
            rounds=request.rounds,
            record=("x",),
        )
    x = [_fill_up(values["x"], request.rounds) for values in history.values.values()]
    for i, series in enumerate(x):
        if series.shape[1:] != (PROBLEM_SHAPE.entries,):
            allowed = f"shape ({PROBLEM_SHAPE.entries},)"
            where = f"{contender.name}: x of agent {i}"
            raise ConfigError(where, f"shape {series.shape[1:]}", allowed)
    traffic = np.mean(
        [_fill_up(sent, request.rounds) for sent in history.traffic.values()], axis=0
    )
    with np.errstate(over="ignore"):
        error = relative_error(np.array(x), problem.optimum)
    return Curve(error, traffic[:, 0], traffic[:, 1])


def _fill_up(series: Mat, rounds: int) -> Mat:
    """Return the series (rounds + 1, ...); the last value stays if an algorithm ends before."""
    missing = rounds + 1 - len(series)
    return np.concatenate([series, np.repeat(series[-1:], missing, axis=0)])


def choose_scale(contender: Contender, case: Case, request: StudyRequest) -> float:
    """Return the scale of STEP_SCALES with the least score, from the largest scale on.

    The score is the mean over the rounds of the logarithm of the error, on the worse one of the
    tuning problems, without loss. With too large a step an algorithm fails.
    Raises the last error if the algorithm fails with each scale.
    """
    lossless = Case(case.agents, case.graph, 0.0)
    best = 0.0
    least = np.inf
    worse = 0
    failure: CrazyChoirError | None = None
    for scale in STEP_SCALES:
        try:
            score = max(
                _score(run_once(contender, lossless, request, scale, seed))
                for seed in TUNING_SEEDS
            )
        except CrazyChoirError as error:
            failure = error
            continue
        if score < least:
            best = scale
            least = score
            worse = 0
        else:
            worse += 1
            if worse == WORSE_SCALES:
                break
    if not best and failure is not None:
        raise failure
    return best


def _score(curve: Curve) -> float:
    """Return the mean of the logarithm of the error, within the limits of the choice."""
    error = np.nan_to_num(curve.error, nan=HIGHEST_ERROR)
    return float(np.log10(np.clip(error, LEAST_ERROR, HIGHEST_ERROR)).mean())


@dataclass(frozen=True)
class CaseResult:
    """All runs of an algorithm in one case."""

    contender: Contender
    """The algorithm."""
    case: Case
    """The case."""
    scale: float
    """Scale of its step."""
    curves: dict[int, Curve]
    """Its runs by seed."""

    def summarise(self, accuracy: float) -> dict[str, Any]:
        """Return a row: the case, and median and quartiles of the efforts and of the last error."""
        efforts = [curve.find_effort(accuracy) for curve in self.curves.values()]
        row = {"algorithm": self.contender.name} | asdict(self.case)
        row["step_scale"] = self.scale
        row["seeds"] = len(self.curves)
        row["failed"] = sum(not np.isfinite(c.error[-1]) for c in self.curves.values())
        failures = (curve.failure for curve in self.curves.values() if curve.failure)
        row["failure"] = next(failures, "")
        for name in EFFORT_NAMES:
            row |= _quartiles(name, [effort[name] for effort in efforts])
        last = [float(curve.error[-1]) for curve in self.curves.values()]
        return row | _quartiles("last_error", last)

    def list_runs(self, accuracy: float) -> list[dict[str, Any]]:
        """Return one row for each run."""
        return [
            {"algorithm": self.contender.name}
            | asdict(self.case)
            | {"seed": seed, "step_scale": self.scale}
            | {name: _finite(v) for name, v in curve.find_effort(accuracy).items()}
            | {"last_error": _finite(float(curve.error[-1]))}
            for seed, curve in self.curves.items()
        ]

    def list_rounds(self) -> list[dict[str, Any]]:
        """Return one row for each round, with the quartiles of the error over the seeds."""
        lower, median, upper = self.error_quartiles()
        messages = np.median([c.messages for c in self.curves.values()], axis=0)
        sent = np.median([c.sent_bytes for c in self.curves.values()], axis=0)
        return [
            {"algorithm": self.contender.name}
            | asdict(self.case)
            | {
                "round": k,
                "messages_an_agent": float(messages[k]),
                "bytes_an_agent": float(sent[k]),
                "error_median": float(median[k]),
                "error_lower": float(lower[k]),
                "error_upper": float(upper[k]),
            }
            for k in range(len(median))
        ]

    def error_quartiles(self) -> Mat:
        """Return the quartiles (3, K+1) of the error over the seeds: lower, median, upper."""
        errors = [curve.error for curve in self.curves.values()]
        return np.quantile(errors, (0.25, 0.5, 0.75), axis=0)


def run_cases(
    contenders: Sequence[Contender],
    cases: Sequence[Case],
    request: StudyRequest,
    say: Say,
) -> list[CaseResult]:
    """Run each algorithm in each case.

    say: called with a text that says what is being computed
    """
    results = []
    scales: dict[tuple[str, int, str], float] = {}
    for number, case in enumerate(cases):
        for contender in contenders:
            say(f"{number + 1}/{len(cases)}: {case}: {contender.label}")
            key = (contender.name, case.agents, case.graph)
            if key not in scales:
                scales[key] = choose_scale(contender, case, request)
            curves = {
                seed: _run_or_fail(contender, case, request, scales[key], seed)
                for seed in range(1, request.seeds + 1)
            }
            results.append(CaseResult(contender, case, scales[key], curves))
    return results


def _run_or_fail(
    contender: Contender, case: Case, request: StudyRequest, scale: float, seed: int
) -> Curve:
    """Return a run; if it fails, such as by a step that is too large for this one problem, its errors are inf."""
    try:
        return run_once(contender, case, request, scale, seed)
    except CrazyChoirError as error:
        nothing = np.zeros(request.rounds + 1)
        endless = np.full(request.rounds + 1, np.inf)
        return Curve(endless, nothing, nothing, str(error))


def _quartiles(name: str, values: Sequence[float]) -> dict[str, float | None]:
    """Return median and quartiles; each is one of the values, and None for inf."""
    places = {"median": 0.5, "lower": 0.25, "upper": 0.75}
    found = {
        place: float(np.quantile(values, share, method="inverted_cdf"))
        for place, share in places.items()
    }
    return {f"{name}_{place}": _finite(value) for place, value in found.items()}


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
