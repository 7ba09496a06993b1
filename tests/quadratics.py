"""Quadratic costs of a team, and their common optimum."""

import numpy as np


class Quadratics:
    """f_i(x) = 1/2 x'P_i x + q_i'x, P_i positive definite; the minimum of their sum is at `optimum`."""

    def __init__(self, agents, n=2, seed=0):
        chance = np.random.default_rng(seed)
        roots = chance.normal(size=(agents, n, n))
        self.p = roots @ roots.transpose(0, 2, 1) + 0.5 * np.eye(n)
        self.q = chance.normal(size=(agents, n)) * 2.0
        self.optimum = -np.linalg.solve(self.p.sum(axis=0), self.q.sum(axis=0))
        self.smoothness = np.linalg.eigvalsh(self.p).max()

    def gradient(self, i):
        return lambda x: self.p[i] @ x + self.q[i]

    def cost(self, x):
        return 0.5 * x @ self.p.sum(axis=0) @ x + self.q.sum(axis=0) @ x
