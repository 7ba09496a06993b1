"""The algorithms of the comparison, each with one number that scales its step."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.guidance.user_hook import Hook
from crazychoir.optimization.algorithms.admm import ADMM
from crazychoir.optimization.algorithms.compressed.choco import ChocoSGD, ChocoSteps
from crazychoir.optimization.algorithms.compressed.compressors import (
    Compressor,
    Quantised,
    TopK,
)
from crazychoir.optimization.algorithms.exact_gradient.exact_diffusion import (
    ExactDiffusion,
)
from crazychoir.optimization.algorithms.exact_gradient.extra import EXTRA
from crazychoir.optimization.algorithms.exact_gradient.linearised_admm import (
    LinearisedADMM,
)
from crazychoir.optimization.algorithms.exact_gradient.nids import NIDS
from crazychoir.optimization.algorithms.exact_gradient.prox_skip import (
    LEAST_CHANCE,
    ProxSkip,
    SharedCoin,
)
from crazychoir.optimization.algorithms.exact_gradient.relaxed_admm import RelaxedADMM
from crazychoir.optimization.algorithms.gradient_tracking import GradientTracking
from crazychoir.optimization.algorithms.stochastic.gt_adam import GTAdam, Momentum
from crazychoir.optimization.algorithms.stochastic.gt_saga import GTSAGA
from crazychoir.optimization.algorithms.subgradient import SubgradientMethod
from crazychoir.optimization.problems.composite import CompositeCost
from crazychoir.optimization.problems.gradient import Gradient, Samples
from crazychoir.optimization.problems.shared_problem import PROBLEM_SHAPE, SharedProblem
from crazychoir.optimization.rounds.step_size import Diminishing
from crazychoir.runtime.user_module import import_from_file
from crazychoir.team.graph import Graph, Weights, metropolis
from crazychoir.types import Vec

COARSE_QUANTISER: Final = Quantised(bits=4)
"""Compressor of `choco-quantised`."""
KEPT_ENTRIES: Final = TopK(k=3)
"""Compressor of `choco-top`."""
CONSENSUS_STEP: Final = {COARSE_QUANTISER: 0.6, KEPT_ENTRIES: 0.2}
"""gamma of CHOCO for each compressor."""
ADAM_MOMENTS: Final = Momentum(epsilon=0.1)
"""Moments of `gt-adam`; with a small epsilon it jumps near the optimum."""
OWN_ARGUMENTS: Final = ("i", "x", "weights", "gradient", "step")
"""Arguments of a user's algorithm, as those of `EXTRA`."""


@dataclass(frozen=True)
class Setting:
    """What the agents of one team are made from."""

    problem: SharedProblem
    """The problem."""
    graph: Graph
    """Communication graph."""
    weights: Weights
    """Its Metropolis weights."""
    scale: float
    """s, scale of the step: s / L for gradient methods, s L for penalties."""
    seed: int
    """Seed of an algorithm that draws."""

    @property
    def smoothness(self) -> float:
        """L, the largest L_i."""
        return float(self.problem.smoothness.max())

    @property
    def step(self) -> float:
        """s / L."""
        return self.scale / self.smoothness

    @property
    def penalty(self) -> float:
        """s L."""
        return self.scale * self.smoothness

    def gradient(self, i: int) -> Gradient:
        """Return grad f_i."""
        return partial(self.problem.gradient, i)

    def samples(self, i: int) -> Samples:
        """Return the losses of the samples of agent i; each round draws one of them."""
        gradient = partial(self.problem.sample_gradient, i)
        return Samples(i, gradient, range(PROBLEM_SHAPE.samples), seed=self.seed)


@dataclass(frozen=True)
class Contender:
    """An algorithm of the comparison."""

    name: str
    """Name on the command line."""
    label: str
    """Name in the legend."""
    make: Callable[[int, Setting], Any]
    """Makes agent i; the agent starts at x = 0 and has no end of its own."""
    slow_problems: tuple[str, ...] = ()
    """Problems on which a step takes long, so that the default choice leaves it out."""

    def make_team(self, setting: Setting) -> dict[int, Any]:
        """Return the agents of a team."""
        return {i: self.make(i, setting) for i in setting.graph.ids}


def make_setting(
    problem: SharedProblem, graph: Graph, scale: float, seed: int
) -> Setting:
    """Return a setting with the Metropolis weights of the graph."""
    return Setting(problem, graph, metropolis(graph), scale, seed)


def _origin() -> Vec:
    return np.zeros(PROBLEM_SHAPE.entries)


def _make_mixing(kind: Callable[..., Any], i: int, of: Setting) -> Any:
    """Return an agent with the arguments of EXTRA."""
    return kind(i, _origin(), of.weights[i], of.gradient(i), of.step)


def _make_subgradient(i: int, of: Setting) -> SubgradientMethod:
    steps = Diminishing(of.step, 0.5)
    return SubgradientMethod(i, _origin(), of.weights[i], of.gradient(i), steps)


def _make_nids(i: int, of: Setting) -> NIDS:
    """Return an agent with a step of its own, s / L_i."""
    steps = of.scale / of.problem.smoothness
    coupling = 0.5 / float(steps.max())
    cost = CompositeCost(of.gradient(i))
    return NIDS(i, _origin(), of.weights[i], cost, float(steps[i]), coupling)


def _make_prox_skip(i: int, of: Setting) -> ProxSkip:
    p = max(LEAST_CHANCE, float(np.sqrt(of.problem.modulus / of.smoothness)))
    coin = SharedCoin(p, of.seed)
    return ProxSkip(i, _origin(), of.weights[i], of.gradient(i), of.step, coin)


def _make_linearised_admm(i: int, of: Setting) -> LinearisedADMM:
    neighbors = of.graph.neighbors(i)
    proximity = float(of.problem.smoothness[i])
    return LinearisedADMM(
        i, _origin(), neighbors, of.gradient(i), of.penalty, proximity
    )


def _make_admm(i: int, of: Setting) -> ADMM:
    return ADMM(of.problem.local(i), of.graph.neighbors(i), of.penalty)


def _make_relaxed_admm(i: int, of: Setting) -> RelaxedADMM:
    neighbors = of.graph.neighbors(i)
    return RelaxedADMM(of.problem.local(i), neighbors, of.penalty)


def _make_choco(compressor: Compressor, i: int, of: Setting) -> ChocoSGD:
    gamma = CONSENSUS_STEP[compressor]
    steps = ChocoSteps(gamma, of.step)
    return ChocoSGD(i, _origin(), of.weights[i], of.gradient(i), compressor, steps)


def _make_saga(i: int, of: Setting) -> GTSAGA:
    return GTSAGA(i, _origin(), of.weights[i], of.samples(i), of.step)


def _make_adam(i: int, of: Setting) -> GTAdam:
    row = of.weights[i]
    return GTAdam(i, _origin(), row, of.gradient(i), of.step, ADAM_MOMENTS)


ALL_CONTENDERS: Final = {
    contender.name: contender
    for contender in (
        Contender(
            "gradient-tracking",
            "gradient tracking",
            partial(_make_mixing, GradientTracking),
        ),
        Contender("extra", "EXTRA", partial(_make_mixing, EXTRA)),
        Contender("nids", "NIDS", _make_nids),
        Contender(
            "exact-diffusion", "exact diffusion", partial(_make_mixing, ExactDiffusion)
        ),
        Contender("prox-skip", "ProxSkip", _make_prox_skip),
        Contender("linearised-admm", "linearised ADMM", _make_linearised_admm),
        Contender("admm", "ADMM", _make_admm, ("logistic",)),
        Contender("relaxed-admm", "relaxed ADMM", _make_relaxed_admm, ("logistic",)),
        Contender(
            "choco-quantised", "CHOCO, 4 bits", partial(_make_choco, COARSE_QUANTISER)
        ),
        Contender("choco-top", "CHOCO, top 3", partial(_make_choco, KEPT_ENTRIES)),
        Contender("subgradient", "sub-gradient", _make_subgradient),
        Contender("gt-saga", "GT-SAGA", _make_saga),
        Contender("gt-adam", "GT-Adam", _make_adam),
    )
}
"""All algorithms by name."""
DEFAULT_CHOICE: Final = (
    "gradient-tracking",
    "extra",
    "nids",
    "exact-diffusion",
    "prox-skip",
    "linearised-admm",
    "admm",
    "relaxed-admm",
    "choco-quantised",
)
"""Algorithms that are compared without a choice."""


def choose_contenders(names: Sequence[str] | None, problem: str) -> list[Contender]:
    """Return the algorithms with these names.

    names: names of ALL_CONTENDERS, or FILE.py:NAME of a user's algorithm; None for the default choice
    problem: name of the problem
    Raises ConfigError for an unknown name, a name that is given twice, or a file without the
    algorithm.
    """
    if names is None:
        default = [ALL_CONTENDERS[name] for name in DEFAULT_CHOICE]
        return [one for one in default if problem not in one.slow_problems]
    if not names:
        raise ConfigError("--algorithms", "no name", ", ".join(ALL_CONTENDERS))
    for place, name in enumerate(names):
        if name in names[:place]:
            raise ConfigError("--algorithms", f"{name} twice", "each name once")
    return [_choose(name) for name in names]


def _choose(name: str) -> Contender:
    if name in ALL_CONTENDERS:
        return ALL_CONTENDERS[name]
    file, colon, kind = name.rpartition(":")
    if not (colon and file.endswith(".py")):
        allowed = (
            f"{', '.join(ALL_CONTENDERS)}, or FILE.py:NAME of an algorithm of yours"
        )
        raise ConfigError("--algorithms", name, allowed)
    module = import_from_file(Path(file), "algorithm")
    if not hasattr(module, kind):
        defined = [
            word
            for word, value in vars(module).items()
            if callable(value) and getattr(value, "__module__", "") == module.__name__
        ]
        allowed = f"a name that {file} defines: {', '.join(defined) or 'it has none'}"
        raise ConfigError("--algorithms", name, allowed)
    returns = "an agent: message(), step(heard), done"
    where = str(module.__file__)
    hook = Hook(where, kind, getattr(module, kind), OWN_ARGUMENTS, returns, "algorithm")
    hook.check()
    return Contender(name, kind, partial(_make_own, hook))


def _make_own(hook: Hook, i: int, of: Setting) -> Any:
    """Return an agent of a user's algorithm."""
    return hook.make_agent(i, _origin(), of.weights[i], of.gradient(i), of.step)
