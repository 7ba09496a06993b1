"""The lightweight world: the paper's quadrotor model, integrated by Runge-Kutta of order 4."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from crazychoir.numerics.kernels import (
    kernel,
    matrix,
    memory,
    real,
    table,
    vector,
    wholes,
)
from crazychoir.numerics.math3d import (
    STANDARD_GRAVITY,
    Triple,
    clip,
    dot,
    rotation_columns,
)
from crazychoir.platforms import PAPER_PLATFORM, Platform
from crazychoir.simulation.common.links import (
    EulerRatesLink,
    SimulatedLink,
    convert_to_euler_rates,
)
from crazychoir.simulation.common.logs import LIGHTWEIGHT_LOG_READERS
from crazychoir.simulation.common.truth import Truth
from crazychoir.simulation.common.world import make_unsupported_kind_error
from crazychoir.types import Ints, Mat, Vec


class IntegratorColumns(NamedTuple):
    """Columns of the commands and of Platform.flat that the integrator reads by name."""

    thrust: int = 0
    """Column of a command with the thrust."""
    max_thrust: int = 4
    """Column of Platform.flat with the largest thrust; the largest rates follow."""
    mass: int = 0
    """Column of Platform.flat with the mass."""


INTEGRATOR_COLUMNS = IntegratorColumns()


LIGHTWEIGHT_COMMAND_TIMEOUT = 0.5
"""Seconds without a command before a drone has no thrust; no firmware levels it first."""


@kernel()
def _convert_to_body_rates(z_row: Triple, u: Vec, euler: bool) -> Triple:
    """Return the body rates for the inputs u[1:4], which are body rates or Euler-angle rates eta'.

    Body rates are returned unchanged. Euler-angle rates are converted:

        p = phi' - psi' sin(theta)
        q = theta' cos(phi) + psi' sin(phi) cos(theta)
        r = psi' cos(phi) cos(theta) - theta' sin(phi)

    z_row: last row of R = (-sin theta, sin phi cos theta, cos phi cos theta)
    euler: True if the inputs are Euler-angle rates
    """
    if not euler:
        return u[1], u[2], u[3]
    phi = math.atan2(z_row[1], z_row[2])
    c = math.cos(phi)
    s = math.sin(phi)
    return (
        u[1] + u[3] * z_row[0],
        u[2] * c + u[3] * z_row[1],
        u[3] * z_row[2] - u[2] * s,
    )


@kernel()
def _write_slope(y: Vec, u: Vec, platform: Vec, euler: bool, out: Vec) -> None:
    """Write the slope y' of the paper's dynamics to out: z up, quaternion attitude.

        p' = v,  v' = -g e3 + (u_1 / m) R e3 - (1/m) R A R^T v,  q' = 1/2 q (w, 0)

    y: (10,): p m, v m/s, q
    u: (4,): thrust N, rates rad/s
    platform: Platform.flat, with m in kg and the diagonal of A in kg/s
    euler: True if the rates are Euler-angle rates
    """
    q = (y[6], y[7], y[8], y[9])
    bx, by, bz = rotation_columns(q)
    v = (y[3], y[4], y[5])
    m = platform[INTEGRATOR_COLUMNS.mass]
    ax = -platform[1] * dot(bx, v) / m
    ay = -platform[2] * dot(by, v) / m
    az = (u[INTEGRATOR_COLUMNS.thrust] - platform[3] * dot(bz, v)) / m
    w = _convert_to_body_rates((bx[2], by[2], bz[2]), u, euler)
    for c in range(3):
        out[c] = v[c]
        out[3 + c] = ax * bx[c] + ay * by[c] + az * bz[c]
    out[5] -= STANDARD_GRAVITY
    out[6] = 0.5 * (q[3] * w[0] + q[1] * w[2] - q[2] * w[1])
    out[7] = 0.5 * (q[3] * w[1] + q[2] * w[0] - q[0] * w[2])
    out[8] = 0.5 * (q[3] * w[2] + q[0] * w[1] - q[1] * w[0])
    out[9] = -0.5 * (q[0] * w[0] + q[1] * w[1] + q[2] * w[2])


@kernel()
def _write_lagged_inputs(
    start: Vec, target: Vec, t: float, lags: Vec, out: Vec
) -> None:
    """Write the inputs after a first-order lag to out, exactly.

        u(t) = target + (start - target) exp(-t / lag),   lag 0 follows at once

    lags: (2,) s: of the thrust and of the rates
    """
    for c in range(4):
        lag = lags[0] if c == INTEGRATOR_COLUMNS.thrust else lags[1]
        decay = math.exp(-t / lag) if lag > 0.0 else 0.0
        out[c] = target[c] + (start[c] - target[c]) * decay


@kernel()
def _step_runge_kutta(
    y: Vec, u: Mat, h: float, platform: Vec, euler: bool, k: Mat
) -> None:
    """Make one step of the classical Runge-Kutta method of order 4; y is replaced.

    y: (10,): state as in _slope
    u: (3, 4): inputs at the beginning, the middle and the end of the step
    h: s: length of the step
    k: (5, 10): work space for the slopes
    """
    stage = k[4]
    _write_slope(y, u[0], platform, euler, k[0])
    for c in range(10):
        stage[c] = y[c] + 0.5 * h * k[0, c]
    _write_slope(stage, u[1], platform, euler, k[1])
    for c in range(10):
        stage[c] = y[c] + 0.5 * h * k[1, c]
    _write_slope(stage, u[1], platform, euler, k[2])
    for c in range(10):
        stage[c] = y[c] + h * k[2, c]
    _write_slope(stage, u[2], platform, euler, k[3])
    for c in range(10):
        y[c] += h / 6.0 * (k[0, c] + 2.0 * k[1, c] + 2.0 * k[2, c] + k[3, c])
    n = 1.0 / math.sqrt(y[6] * y[6] + y[7] * y[7] + y[8] * y[8] + y[9] * y[9])
    for c in range(6, 10):
        y[c] *= n


@kernel()
def _is_held_by_weight(y: Vec, u: Vec, platform: Vec) -> bool:
    """Return True if the weight of a drone on the floor is at least its upward thrust."""
    upright = 1.0 - 2.0 * (y[6] * y[6] + y[7] * y[7])
    lift: float = u[INTEGRATOR_COLUMNS.thrust] * upright
    return lift <= float(platform[INTEGRATOR_COLUMNS.mass]) * STANDARD_GRAVITY


@kernel()
def _put_down(x: Vec) -> None:
    """Stop a drone on the floor without slip or bounce.

    An upright drone then stands level; a drone on its back stays on its back.
    """
    x[2] = 0.0
    for c in range(3):
        x[3 + c] = 0.0
        x[10 + c] = 0.0
    if x[6] * x[6] + x[7] * x[7] < 0.5:
        n = math.sqrt(x[8] * x[8] + x[9] * x[9])
        x[6] = 0.0
        x[7] = 0.0
        x[8] = x[8] / n
        x[9] = x[9] / n


@kernel(matrix, matrix, table, table, memory)
def _clip_commands(
    commands: Mat, platforms: Mat, accepted: Mat, previous: Mat, counts: Vec
) -> None:
    """Clip commands to the limits of the platforms and count the clipped ones.

    A command with a NaN repeats the previous command and is counted too.
    commands: (N, 4): commands as sent
    platforms: (N, 9): rows of Platform.flat
    accepted: (N, 4): result
    previous: (N, 4): accepted commands of the step before
    counts: (N,): counters of limited commands
    """
    for i in range(commands.shape[0]):
        for c in range(4):
            value = commands[i, c]
            limit = platforms[i, INTEGRATOR_COLUMNS.max_thrust + c]
            if not math.isfinite(value):
                accepted[i] = previous[i]
                counts[i] += 1.0
                break
            accepted[i, c] = clip(
                value, 0.0 if c == INTEGRATOR_COLUMNS.thrust else -limit, limit
            )
        else:
            counts[i] += 1.0 if np.any(accepted[i] != commands[i]) else 0.0


@kernel(matrix, wholes, matrix, real, table)
def _take_commands(
    inputs: Mat, is_new: Ints, x: Mat, euler: float, commands: Mat
) -> None:
    """Write the commands that follow from new inputs.

    inputs: (N, 4): thrusts N, body rates rad/s
    is_new: (N,): 1 for a drone with a new input
    x: (N, 13): states
    euler: above 0 if the commands have Euler-angle rates
    commands: (N, 4): thrusts N, rates rad/s
    """
    for i in range(inputs.shape[0]):
        if is_new[i] == 0:
            continue
        if euler > 0.0:
            convert_to_euler_rates(x[i, 6:10], inputs[i], commands[i])
        else:
            for c in range(4):
                commands[i, c] = inputs[i, c]


@kernel(table, table, matrix, real, matrix, vector, memory, memory, memory, real)
def _advance(
    x: Mat,
    actual: Mat,
    target: Mat,
    h: float,
    platforms: Mat,
    lags: Vec,
    alive: Vec,
    resting: Vec,
    impact: Vec,
    euler: float,
) -> None:
    """Advance all drones by h with the held commands `target`.

    x: (N, 13): states, replaced
    actual: (N, 4): inputs after the lag, replaced
    target: (N, 4): commands
    h: s: length of the step
    platforms: (N, 9): rows of Platform.flat
    lags: (2,) s: of the thrust and of the rates
    alive: (N,): 1 until the motors are cut, then 0
    resting: (N,): 1 on the floor, else 0
    impact: (N,) m/s: fastest touch-down
    euler: above 0 if the rates are Euler-angle rates
    """
    k = np.empty((5, 10))
    u = np.empty((3, 4))
    y = np.empty(10)
    goal = np.empty(4)
    platform = np.empty(platforms.shape[1])
    for i in range(x.shape[0]):
        for c in range(platforms.shape[1]):
            platform[c] = platforms[i, c]
        for c in range(4):
            goal[c] = target[i, c] * alive[i]
        for s in range(3):
            _write_lagged_inputs(actual[i], goal, 0.5 * h * s, lags, u[s])
        if resting[i] and _is_held_by_weight(x[i, :10], u[2], platform):
            actual[i, INTEGRATOR_COLUMNS.thrust] = u[2, INTEGRATOR_COLUMNS.thrust]
            actual[i, 1:4] = 0.0
            continue
        resting[i] = 0.0
        actual[i] = u[2]
        y[:] = x[i, :10]
        _step_runge_kutta(y, u, h, platform, euler > 0.0, k)
        x[i, :10] = y
        bx, by, bz = rotation_columns((y[6], y[7], y[8], y[9]))
        x[i, 10], x[i, 11], x[i, 12] = _convert_to_body_rates(
            (bx[2], by[2], bz[2]), u[2], euler > 0.0
        )
        if y[2] < 0.0:
            impact[i] = max(impact[i], -y[5])
            resting[i] = 1.0
            _put_down(x[i])


@dataclass(frozen=True, slots=True)
class InputLags:
    """How late the thrust and the rates of a drone follow its commands."""

    rates: float = 0.0
    """First-order lag of the rates in s, exact."""
    thrust: float = 0.0
    """First-order lag of the thrust in s, exact."""
    delay: float = 0.0
    """Delay of the commands in s, exact for any value.

    If it is no multiple of the step, the step is split at the time at which the input switches.
    """


NO_INPUT_LAGS = InputLags()


class CFIntegrator(Truth):
    """The paper's lightweight simulation: Runge-Kutta of order 4, one compiled pass for all drones.

    The floor is z = 0: a drone rests on it without slipping until its thrust exceeds its weight.
    Until its first command arrives, a drone on the floor has its motors stopped and a drone in the
    air hovers.

    ids: the drones, in the order of the rows
    p0: (N, 3) m: start positions
    yaw0: (N,) rad: start headings
    platform: one for all drones, or one a drone
    dt: s: one step
    lags: how late the thrust and the rates follow the commands
    inputs: "rates" (body rates) or "euler" (the paper's Euler-angle rates)
    """

    flies: tuple[str, ...] = ("fpqr",)
    takes_rows: tuple[str, ...] = ("fpqr",)
    command_timeout: float | None = LIGHTWEIGHT_COMMAND_TIMEOUT

    def __init__(
        self,
        ids: Sequence[int],
        p0: Mat,
        yaw0: Vec | None = None,
        platform: Platform | Sequence[Platform] = PAPER_PLATFORM,
        dt: float = 0.01,
        *,
        lags: InputLags = NO_INPUT_LAGS,
        inputs: Literal["rates", "euler"] = "rates",
    ) -> None:
        super().__init__(ids, p0, yaw0, platform, dt)
        n = len(self.ids)
        self.commands = np.zeros((n, 4))
        self.commands[:, INTEGRATOR_COLUMNS.thrust] = np.where(
            self.states[:, 2] > 0.0, [row.weight for row in self.platforms], 0.0
        )
        self._alive = np.ones(n)
        self._held = {i: self.commands[row] for i, row in self.row.items()}
        self._actual = self.commands.copy()
        self._flat = np.array([row.flat for row in self.platforms])
        self._lags = np.array([lags.thrust, lags.rates])
        self._late = int(lags.delay / dt + 1e-9)
        self._split = max(lags.delay - self._late * dt, 0.0)
        self._sent = [self.commands.copy() for _ in range(self._late + 2)]
        self._euler = float(inputs == "euler")

    def link(self, i: int, kind: str = "fpqr") -> SimulatedLink:
        """Return the link to drone i; it takes body rates, whatever the inputs of the world are.

        Raises ConfigError if the kind is not "fpqr".
        """
        if kind not in self.flies:
            raise make_unsupported_kind_error(i, kind, self.flies)
        return EulerRatesLink(self, i) if self._euler else SimulatedLink(self, i)

    def command(self, i: int, u: Vec | Sequence[float]) -> None:
        """Hold u (4,) = thrust N, rates rad/s for drone i from now on."""
        self._held[i][...] = u

    def take_commands(self, inputs: Mat, is_new: Ints) -> None:
        """Hold the new commands of all drones, as `link` would.

        inputs: (n, 4): thrusts N, body rates rad/s, one row a drone
        is_new: (n,): 1 for a drone with a new command
        """
        _take_commands(inputs, is_new, self.states, self._euler, self.commands)

    def cut(self, i: int) -> None:
        """Stop the motors of drone i for good."""
        self._alive[self.row[i]] = 0.0

    def replace_body(self, i: int, platform: Platform) -> None:
        """Give drone i another true body; its state stays."""
        super().replace_body(i, platform)
        self._flat[self.row[i]] = platform.flat

    def put(self, i: int, p: Vec, yaw: float) -> None:
        """Put drone i at rest at p (3,) m, world, as at the start of the world.

        In the air it hovers until its next command. Commands on their way are forgotten.
        yaw: rad: heading
        """
        super().put(i, p, yaw)
        row = self.row[i]
        is_in_air = self.states[row, 2] > 0.0
        hover = (self.platforms[row].weight if is_in_air else 0.0, 0.0, 0.0, 0.0)
        self._alive[row] = 1.0
        for commands in (self.commands, self._actual, *self._sent):
            commands[row] = hover

    @property
    def variables(self) -> Iterable[str]:
        """Names of the log variables of the drones."""
        return LIGHTWEIGHT_LOG_READERS

    def log(self, i: int, name: str) -> float:
        """Return a log variable of drone i now, in the firmware's unit."""
        return LIGHTWEIGHT_LOG_READERS[name](self.state(i))

    def step(self) -> None:
        """Advance every drone by dt."""
        size = len(self._sent)
        k = self.tick
        _clip_commands(
            self.commands,
            self._flat,
            self._sent[k % size],
            self._sent[(k - 1) % size],
            self.limited,
        )
        if self._split > 1e-9 * self.dt:
            self._run(self._sent[(k - self._late - 1) % size], self._split)
        self._run(self._sent[(k - self._late) % size], self.dt - self._split)
        self.tick += 1

    def _run(self, target: Mat, h: float) -> None:
        _advance(
            self.states,
            self._actual,
            target,
            h,
            self._flat,
            self._lags,
            self._alive,
            self._resting,
            self.impact,
            self._euler,
        )
