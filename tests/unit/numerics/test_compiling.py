"""When laws are compiled: after the checks of a program that asks for that."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from crazychoir.numerics.compiling import KERNEL_QUEUE
from crazychoir.numerics.kernel_cache import COMPILING_MESSAGE
from crazychoir.numerics.kernels import kernel, real, vector

NOT_RIGID = """
name = "path"
mission = "bearing_formation"
edges = [[0, 1], [1, 2], [2, 3]]
mission_options = {shape = {0 = [0, 0, 1], 1 = [1, 0, 1], 2 = [1, 1, 1], 3 = [0, 1, 1]}}
drones = [
    {id = 0, home = [0, 0, 0], leader = true}, {id = 1, home = [1, 0, 0], leader = true},
    {id = 2, home = [1, 1, 0]}, {id = 3, home = [0, 1, 0]},
]
"""
GOOD = 'name = "one"\nmission = "figure"\ngraph = "empty"\ndrones = [{id = 0, home = [0, 0, 0]}]\n'
ALGORITHM = "class Agent:\n    x = 0.0\n    done = False\n\n\ndef agent(i, graph):\n    return Agent()\n"


def law():
    """A law of its own for each test."""

    @kernel(vector, real)
    def scaled(x, factor):
        return factor * x[0]

    return scaled


def test_a_law_is_compiled_when_it_is_imported():
    assert len(law().signatures) == 1


def test_inside_checks_first_a_law_waits_until_all_are_compiled():
    with KERNEL_QUEUE.checks_first():
        first = law()
        second = law()
        assert (first.signatures, second.signatures) == ([], [])
    KERNEL_QUEUE.compile()
    assert (len(first.signatures), len(second.signatures)) == (1, 1)
    assert first(np.array([3.0]), 2.0) == 6.0
    assert len(law().signatures) == 1, "afterwards they do not wait"


def test_only_kept_laws_are_loaded_before_the_others_are_compiled(
    tmp_path, monkeypatch
):
    def scaled(x):
        return x * 2.5

    def shifted(x):
        return x + 2.5

    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path))
    kernel(real)(scaled)  # writes the machine code
    with KERNEL_QUEUE.checks_first():
        kept = kernel(real)(scaled)
        missing = kernel(real)(shifted)
    KERNEL_QUEUE.load_kept()
    assert (len(kept.signatures), len(missing.signatures)) == (1, 0)
    KERNEL_QUEUE.compile()
    assert (kept(2.0), missing(2.0)) == (5.0, 4.5)
    assert (len(kept.signatures), len(missing.signatures)) == (1, 1)


def test_a_law_that_waits_is_compiled_for_its_own_types_alone_when_it_is_called():
    with KERNEL_QUEUE.checks_first():
        waits = law()
        assert waits(np.array([3.0]), 2) == 6.0
    assert waits.signatures == law().signatures
    with pytest.raises(TypeError):
        waits(np.array([3]), 2.0)
    KERNEL_QUEUE.compile()
    assert len(waits.signatures) == 1


@pytest.mark.parametrize(
    ("text", "words", "said"),
    [
        (
            NOT_RIGID,
            ("main", "run", "{file}", "--fast"),
            "all bearings of drone 3 are parallel",
        ),
        (
            NOT_RIGID,
            ("fly.agent", "--swarm", "{file}", "--id", "0"),
            "all bearings of drone 3 are parallel",
        ),
        (GOOD, ("fly.agent", "--swarm", "{file}", "--id", "7"), "found drone 7"),
        (
            GOOD.replace("[0, 0, 0]", "[9, 0, 0]"),
            ("main", "run", "{file}"),
            "outside the fence",
        ),
        (GOOD, ("main", "run", "{file}", "--only", "3"), "--only"),
        (ALGORITHM, ("main", "simulate", "{file}"), "without message, step"),
    ],
)
def test_what_is_wrong_with_a_swarm_is_said_before_any_law_is_compiled(
    text, words, said, tmp_path
):
    file = tmp_path / ("a.py" if text == ALGORITHM else "a.toml")
    file.write_text(text)
    program, *rest = (word.format(file=file) for word in words)
    kept = tmp_path / "kept"
    kept.mkdir()
    command = [sys.executable, "-m", f"crazychoir.cli.{program}", *rest]
    run = subprocess.run(
        command,
        env={**os.environ, "NUMBA_CACHE_DIR": str(kept)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (run.returncode, said in run.stderr) == (2, True), run.stderr
    assert COMPILING_MESSAGE not in run.stderr
    assert list(Path(kept).rglob("*.nbc")) == []
