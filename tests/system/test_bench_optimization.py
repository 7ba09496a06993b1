"""Both programs of `bench optimization` make rounds; their figures are not tested."""

import importlib.util

import pytest

from crazychoir.bench.harness import ProgramRow, measure

pytestmark = [pytest.mark.system, pytest.mark.real_time]
PROGRAMS = [("rounds", "", 2), ("mpi4py_rounds", "mpi4py", 3)]


@pytest.mark.parametrize("algorithm", ["consensus", "dual decomposition"])
@pytest.mark.parametrize(("module", "extra", "processes"), PROGRAMS)
def test_each_program_makes_rounds(module, extra, processes, algorithm):
    if extra and any(
        importlib.util.find_spec(name) is None for name in (extra, "dill")
    ):
        pytest.skip("the extra `bench` is not installed")
    packages = (extra, "dill") if extra else ()
    row = ProgramRow(
        module, module, "ring", 3, processes, packages, options={"algorithm": algorithm}
    )
    measure(row, 0.2)
    assert row.note == ""
    assert row.rounds[0] > 1.0
