"""The public names: imported when they are used, and known to type checkers."""

import ast
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import crazychoir
from crazychoir import Acceleration, types
from crazychoir.guidance.guidance import CFGuidance


def python(program):
    return subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    ).stdout


@pytest.mark.parametrize("name", crazychoir.__all__)
def test_every_public_name_is_there(name):
    value = getattr(crazychoir, name)
    assert value.__name__ == name
    assert name in dir(crazychoir)


def test_a_public_name_is_the_one_of_its_room():
    assert crazychoir.CFGuidance is CFGuidance
    assert Acceleration is types.Acceleration


def test_a_name_that_is_none():
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        crazychoir.Nothing  # noqa: B018
    with pytest.raises(ImportError, match="Nothing"):
        from crazychoir import Nothing  # noqa: F401


def test_type_checkers_see_the_same_names():
    tree = ast.parse(Path(crazychoir.__file__).read_text())
    blocks = [node for node in tree.body if isinstance(node, ast.If)]
    for_checkers = next(
        node for node in blocks if ast.unparse(node.test) == "TYPE_CHECKING"
    )
    seen = {
        alias.name: node.module for node in for_checkers.body for alias in node.names
    }
    assert seen == {
        name: getattr(crazychoir, name).__module__ for name in crazychoir.__all__
    }


def test_the_version_is_that_of_the_distribution():
    assert crazychoir.__version__ == version("crazychoir")


def test_the_package_runs_as_a_module():
    done = subprocess.run(
        [sys.executable, "-m", "crazychoir", "--version"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == f"crazychoir {crazychoir.__version__}\n"


def test_the_package_alone_imports_no_numerics():
    found = python(
        "import crazychoir, sys; print(sorted({name.split('.')[0] for name in sys.modules}))"
    )
    assert "numpy" not in found
    assert "crazychoir" in found


def test_a_light_name_imports_no_kernels():
    found = python(
        "from crazychoir import State; import sys; print(sorted(sys.modules))"
    )
    assert "'numpy'" in found
    assert "'numba'" not in found


def test_simulated_worlds_import_the_engines_that_they_have():
    found = python("import crazychoir.agent.worlds, sys; print(sorted(sys.modules))")
    assert "'crazychoir.simulation.lightweight.integrator'" in found
    assert "'crazychoir.simulation.motor_level.air'" not in found
    assert "'crazychoir.simulation.onboard'" not in found
