"""The problems that agents solve together: each agent models its own part with cvxpy."""

from collections.abc import Sequence
from functools import cached_property
from math import inf
from typing import Any

import cvxpy as cp
import numpy as np
from numpy.typing import ArrayLike

from crazychoir.errors import ConfigError, SolverError
from crazychoir.optimization.problems import diagnosis
from crazychoir.optimization.problems import expressions as ex
from crazychoir.optimization.problems.conic import ConicProgram
from crazychoir.optimization.problems.expressions import Quadratic
from crazychoir.optimization.problems.mixed_integer import MixedIntegerBlock
from crazychoir.optimization.problems.quadratic import Polyhedron
from crazychoir.optimization.problems.solver_choice import (
    CompiledProgram,
    DecidedProgram,
    choose_fast_program,
    compile_problem,
)
from crazychoir.optimization.rounds.arrays import copy_numbers, copy_vector, is_number
from crazychoir.types import Mat, Vec

MOST_PENALTIES = 8
"""Number of compiled variants of one problem that are kept: one for each penalty rho."""


class CostCoupled:
    """One agent's part of  min sum_i f_i(x)  s.t.  x in the intersection of the X_i.

    agent: id of the agent, for error messages
    x: cvxpy variable, a scalar or a vector (n,)
    objective: f_i, convex
    constraints: X_i, convex sets

    The objective and the constraints may contain parameters and further variables that only this
    agent uses.

    The structure of the problem decides the solver (see `solver`):

    - f quadratic, X given by equalities: a closed form.
    - f strictly convex quadratic, X a polyhedron: the active-set method.
    - f linear, X a polyhedron: HiGHS.
    - All other problems: Clarabel.

    Each solver stops after a number of steps and returns the same bits in every run.
    Raises ConfigError if the model is not convex, not finite or of a wrong shape.
    Raises SolverError when an infeasible or unbounded model is solved.
    Both errors name the agent, the constraint and its row.
    """

    def __init__(
        self,
        agent: int,
        x: cp.Variable,
        objective: Any,
        constraints: Sequence[cp.Constraint] = (),
    ) -> None:
        self.agent = agent
        self.x = x
        self.where = f"agent {agent}"
        self.n = ex.require_decision_variable(x, self.where)
        self.objective = ex.require_convex(objective, f"{self.where}: objective")
        self.constraints = [
            *ex.list_constraints(constraints, self.where),
            *ex.list_domain_constraints(x, self.where),
        ]
        ex.require_continuous([self.objective, *self.constraints], self.where)
        self._programs: dict[tuple[float, bool], CompiledProgram] = {}

    def refresh(self) -> None:
        """Read the parameters of the model again, after their values have changed."""
        self._programs.clear()
        for name in ("form", "over"):
            self.__dict__.pop(name, None)

    @cached_property
    def form(self) -> Quadratic | None:
        """f_i as a quadratic function of x, or None if it is not quadratic."""
        found = ex.decompose_quadratics(self.objective, self.x)
        return None if found is None else found[0]

    @cached_property
    def over(self) -> Polyhedron | None:
        """X_i as a polyhedron, or None if X_i is another set or involves further variables."""
        return ex.build_polyhedron(self.constraints, self.x)

    # Values -----------------------------------------------------------------------------

    def value(self, x: Vec) -> float:
        """Return f_i(x), or inf outside the domain of f_i."""
        point = self._vector(x, "x")
        if self.form is not None:
            return self.form.value(point)
        found = float(ex.evaluate_at(self._own("value"), self.x, point)[0])
        return found if np.isfinite(found) else inf

    def gradient(self, x: Vec) -> Vec:
        """Return a (sub)gradient (n,) of f_i at x."""
        point = self._vector(x, "x")
        if self.form is not None:
            return self.form.gradient(point)
        found: Vec = ex.compute_slope(self._own("gradient"), self.x, point)[0]
        if not np.isfinite(found).all():
            raise SolverError(
                f"{self.where}: gradient of the objective at {x}",
                "not finite: outside of its domain",
            )
        return found

    def _own(self, what: str) -> cp.Expression:
        if not ex.is_function_of(self.objective, self.x):
            names = [variable.name() for variable in self.objective.variables()]
            raise ConfigError(
                f"{self.where}: {what} of the objective",
                f"variables {names}",
                f"{self.x.name()} alone",
            )
        return self.objective

    # Solving ----------------------------------------------------------------------------

    def argmin(
        self, linear: Vec | None = None, center: Vec | None = None, penalty: float = 0.0
    ) -> Vec:
        """Return argmin f_i(x) + p'x + rho/2 |x - z|^2 over X_i.

        If there are several minimisers, one is returned.

        linear: p (n,); None means 0
        center: z (n,); None means 0
        penalty: rho >= 0; each new value is compiled once
        """
        p = np.zeros(self.n) if linear is None else self._vector(linear, "linear term")
        if center is not None:
            p = p - penalty * self._vector(center, "center")
        return self._solved(self._program(penalty), p)

    def project(self, z: Vec) -> Vec:
        """Return the point of X_i nearest to z."""
        return self._solved(self._program(1.0, cost=False), -self._vector(z, "point"))

    def solver(self, penalty: float = 0.0) -> str:
        """Return the solver of `argmin`: "closed form", "active set", "HiGHS" or "Clarabel"."""
        return self._program(penalty).name

    def is_fast(self, penalty: float = 0.0) -> bool:
        """Return True if `argmin` takes microseconds, so that it may run in the event loop."""
        return self.solver(penalty) in ("closed form", "active set")

    def _solved(self, program: CompiledProgram, p: Vec) -> Vec:
        found = program.solve(p)
        if isinstance(found, str):
            raise SolverError(f"{self.where}: local problem", self.why(found, p))
        return found

    def why(self, status: str, p: Vec) -> str:
        """Explain a solver's status: name the constraint and its row, or the entry and value."""
        if status == "not finite":
            k = int(np.argmin(np.isfinite(p)))
            return f"not finite: entry {k} of what was heard or asked for is {p[k]}"
        if status == "unbounded":
            return diagnosis.explain_unbounded(
                self.x,
                self.objective + p.reshape(self.x.shape) @ self.x,
                self.constraints,
            )
        return diagnosis.explain_no_point(status, self.constraints, self.x)

    def _program(self, penalty: float, cost: bool = True) -> CompiledProgram:
        """Return the compiled problem for this penalty rho, with or without the objective."""
        if not is_number(penalty) or not 0.0 <= penalty < inf:
            raise ConfigError(
                f"{self.where}: penalty", f"{penalty}", "a finite number >= 0"
            )
        found = self._programs.get((penalty, cost))
        if found is not None:
            return found
        if len(self._programs) >= MOST_PENALTIES:
            self._programs.clear()
        objective, form = (
            (self.objective, self.form)
            if cost
            else (cp.Constant(0.0), Quadratic.zero(self.n))
        )
        made = self._programs[penalty, cost] = compile_problem(
            form, self.over, self.x, objective, self.constraints, penalty
        )
        return made

    def _vector(self, value: Vec, name: str) -> Vec:
        found: Vec = copy_numbers(value, self.where, name)
        if found.shape != (self.n,):
            raise ConfigError(
                f"{self.where}: {name}",
                f"shape {found.shape}",
                f"shape ({self.n},), as {self.x.name()}",
            )
        return found


def require_problem(problem: Any, kind: type, algorithm: str) -> None:
    """Raise ConfigError unless the problem is of the kind that the algorithm solves."""
    if not isinstance(problem, kind):
        do = (
            "Model the agent's part with it: crazychoir.optimization.problems.problems."
        )
        raise ConfigError(
            f"{algorithm}: problem", type(problem).__name__, f"a {kind.__name__}", do
        )


class CommonCost(CostCoupled):
    """One agent's part of  min f(x)  s.t.  x in the intersection of the X_i.

    All agents know f. Each agent knows only its own constraints X_i.
    f must be quadratic or linear, and X_i must be a polyhedron. Otherwise raises ConfigError that
    names the objective or the constraint at fault.
    """

    def __init__(
        self,
        agent: int,
        x: cp.Variable,
        objective: Any,
        constraints: Sequence[cp.Constraint] = (),
    ) -> None:
        super().__init__(agent, x, objective, constraints)
        if self.form is None:
            allowed = f"a quadratic function of {x.name()}"
            raise ConfigError(f"{self.where}: objective", str(self.objective), allowed)
        ex.require_polyhedral(self.constraints, x, self.where)
        self.cost: Quadratic = self.form
        self.polyhedron = Polyhedron.of(*ex.decompose_rows(self.constraints, x))


class ConstraintCoupled:
    """One agent's part of  min sum_i f_i(x_i)  s.t.  sum_i g_i(x_i) <= sum_i b_i,  x_i in X_i.

    agent: id of the agent, for error messages
    x: cvxpy variable x_i, a scalar or a vector (n,)
    objective: f_i, convex
    coupling: g_i, (S,) convex expressions of x_i, a vector or a list
    constraints: X_i, convex sets
    share: b_i (S,); None means 0. With a common bound b, each of N agents may take b/N

    The attribute `local` is the CostCoupled problem of f_i and X_i alone.
    """

    def __init__(
        self,
        agent: int,
        x: cp.Variable,
        objective: Any,
        coupling: Any,
        constraints: Sequence[cp.Constraint] = (),
        share: ArrayLike | None = None,
    ) -> None:
        self.local = CostCoupled(agent, x, objective, constraints)
        self.agent = agent
        self.x = x
        self.n = self.local.n
        self.where = self.local.where
        self.coupling = ex.build_coupling(coupling, f"{self.where}: coupling")
        if not ex.is_function_of(self.coupling, x):
            names = [variable.name() for variable in self.coupling.variables()]
            raise ConfigError(
                f"{self.where}: coupling", f"variables {names}", f"{x.name()} alone"
            )
        self.S = int(self.coupling.size)
        self.share = _read_share(share, self.S, self.where)

    @cached_property
    def _affine(self) -> tuple[Mat, Vec] | None:
        return (
            ex.decompose_affine(self.coupling, self.x)
            if self.coupling.is_affine()
            else None
        )

    @cached_property
    def _priced(self) -> "_PricedProgram":
        return _PricedProgram(self)

    def excess(self, x: Vec) -> Vec:
        """Return g_i(x) - b_i (S,): what the agent uses beyond its share."""
        if self._affine is not None:
            G, h = self._affine
            return G @ x + h - self.share
        return ex.evaluate_at(self.coupling, self.x, np.asarray(x, float)) - self.share

    def jacobian(self, x: Vec) -> Mat:
        """Return the (sub)gradients (S, n) of g_i at x."""
        return (
            ex.compute_slope(self.coupling, self.x, np.asarray(x, float))
            if self._affine is None
            else self._affine[0]
        )

    def is_fast(self) -> bool:
        """Return True if `argmin` takes microseconds, so that it may run in the event loop."""
        return self._affine is not None and self.local.is_fast()

    def argmin(self, prices: Vec) -> Vec:
        """Return argmin f_i(x) + mu'g_i(x) over X_i.

        prices: mu (S,) >= 0
        """
        mu = self._prices(prices)
        if self._affine is not None:
            return self.local.argmin(self._affine[0].T @ mu)
        found = self._priced.solve(mu)
        if isinstance(found, str):
            raise SolverError(
                f"{self.where}: local problem", self.local.why(found, np.zeros(self.n))
            )
        return found

    def _prices(self, value: Vec) -> Vec:
        found: Vec = copy_numbers(value, self.where, "prices")
        if found.shape != (self.S,):
            raise ConfigError(
                f"{self.where}: prices",
                f"shape {found.shape}",
                f"shape ({self.S},), as the coupling",
            )
        if not np.isfinite(found).all():
            s = int(np.argmin(np.isfinite(found)))
            raise SolverError(f"{self.where}: prices[{s}] = {found[s]}", "not finite")
        return found


def _read_share(given: ArrayLike | None, S: int, where: str) -> Vec:
    """Return the share b_i (S,), or zeros if `given` is None.

    Raises ConfigError that names the wrong entry.
    """
    return copy_vector(np.zeros(S) if given is None else given, where, "share", S)


class MixedIntegerConstraintCoupled(MixedIntegerBlock):
    """One agent's part of a mixed-integer linear program, modelled with cvxpy.

        min sum_i c_i'x_i  s.t.  sum_i A_i x_i <= sum_i b_i,  x_i in X_i

    agent: id of the agent, for error messages
    x: cvxpy variable (n,), with the attributes integer and boolean for all entries or for some
    objective: c_i'x_i, linear; its constant is ignored
    coupling: A_i x_i, (S,) linear; a constant in it reduces the share
    constraints: linear constraints; together they bound x
    share: b_i (S,); None means 0

    Use MixedIntegerBlock directly if you have arrays and no expressions.
    Raises ConfigError that names the row of a constraint that is not linear.
    """

    def __init__(
        self,
        agent: int,
        x: cp.Variable,
        objective: Any,
        coupling: Any,
        constraints: Sequence[cp.Constraint] = (),
        share: ArrayLike | None = None,
    ) -> None:
        where = f"agent {agent}"
        n, (integer, binary) = (
            ex.require_decision_variable(x, where),
            ex.find_integer_entries(x),
        )
        own = [
            *ex.list_constraints(constraints, where),
            *ex.list_domain_constraints(x, where, whole=True),
        ]
        ex.require_polyhedral(own, x, where)
        cost = ex.decompose_linear(
            ex.require_convex(objective, f"{where}: objective"),
            x,
            f"{where}: objective",
        )[0][0]
        G, h = ex.decompose_linear(
            ex.build_coupling(coupling, f"{where}: coupling"), x, f"{where}: coupling"
        )
        A, b, E, e = ex.decompose_rows(own, x)
        low = np.full(n, -inf)
        high = np.full(n, inf)
        low[binary] = 0.0
        high[binary] = 1.0
        rows = (np.vstack([A, E, -E]), np.concatenate([b, e, -e]))
        left = _read_share(share, len(h), where) - h
        super().__init__(
            agent, cost, G, left, rows=rows, bounds=(low, high), integer=integer
        )
        self.x = x


class _PricedProgram:
    """Minimise f + mu'g over X for many mu, where g is not affine.

    If f and g are quadratic, the Hessian is computed for each mu. Otherwise mu is a DPP parameter.
    """

    def __init__(self, problem: ConstraintCoupled) -> None:
        self._local = problem.local
        self._coupling = problem.coupling
        self._forms = ex.decompose_quadratics(problem.coupling, problem.x)
        self._mu = cp.Parameter(problem.S, nonneg=True, value=np.zeros(problem.S))
        self._zero = np.zeros(problem.n)

    @cached_property
    def _conic(self) -> ConicProgram:
        objective = self._local.objective + self._mu @ self._coupling
        return ConicProgram(self._local.x, objective, self._local.constraints)

    def solve(self, mu: Vec) -> Vec | str:
        """Return the solution x (n,), or the reason why there is none."""
        form = self._local.form
        if form is not None and self._forms is not None:
            for g, m in zip(self._forms, mu.tolist(), strict=True):
                form = form + g.times(m)
            if program := choose_fast_program(form, self._local.over):
                return DecidedProgram(program, lambda: self._at(mu)).solve(self._zero)
        return self._at(mu).solve(self._zero)

    def _at(self, mu: Vec) -> ConicProgram:
        """Return the compiled program with the prices mu (S,)."""
        self._mu.value = mu
        self._conic.refresh()
        return self._conic
