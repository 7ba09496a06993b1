"""Graphs and instances of the routing tests."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from crazychoir.routing.instance.instance import Instance

Graph = dict[int, list[int]]


def _ring(n: int) -> Graph:
    return {i: sorted({(i - 1) % n, (i + 1) % n} - {i}) for i in range(n)}


GRAPHS = {
    "ring": _ring,
    "complete": lambda n: {i: [j for j in range(n) if j != i] for i in range(n)},
    "path": lambda n: {i: [j for j in (i - 1, i + 1) if 0 <= j < n] for i in range(n)},
    "star": lambda n: {i: [0] if i else list(range(1, n)) for i in range(n)},
}


@pytest.fixture
def graph() -> Callable[[str, int], Graph]:
    """`graph("ring", 5)`: neighbours of each of five robots."""
    return lambda name, n: GRAPHS[name](n)


@pytest.fixture
def small(repository) -> Callable[[str], tuple[Instance, float]]:
    """`small("limited")`: an instance of tests/data and its proven optimum."""

    def load(name: str) -> tuple[Instance, float]:
        path: Path = repository / "tests" / "data" / f"pickup_delivery_{name}.json"
        return Instance.load(path), json.loads(path.read_text())["optimum"]

    return load
