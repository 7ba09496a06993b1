"""What the package imports is declared: in its dependencies, or in the extra of the room that imports it."""

import ast
import re
import sys
import tomllib
from functools import cache
from importlib.metadata import packages_distributions

import pytest
from lowest_versions import constrain, lowest_versions

ROOMS = {
    "dashboard": ("crazychoir/dashboard/",),
    "mujoco": (
        "crazychoir/simulation/mujoco/",
        "crazychoir/bench/worlds.py",
        "crazychoir/cli/recordings/render.py",
        "crazychoir/recording/video.py",
    ),
    "mocap": ("crazychoir/mocap/reader.py",),
    "foxglove": ("crazychoir/bridges/foxglove_server.py",),
    "gym": ("crazychoir/api/env",),
    "ros2": ("crazychoir/recording/ros/rmw_zenoh.py",),
    "tables": ("crazychoir/api/",),
    "bench": ("crazychoir/bench/", "crazychoir/cli/compute/bench"),
}
"""The files that may import what an extra brings, by the beginnings of their paths."""
TWINS = {"cvxpy": "cvxpy-base"}
"""Distributions of the same package with fewer dependencies: an old environment may still have the larger one."""
IMPORTERS = ("import_module", "find_spec", "__import__")
NAMED_OTHERWISE = {
    "PIL": "pillow",
    "foxglove": "foxglove-sdk",
    "google": "protobuf",
    "pamoja": "pamoja-ros2",
    "mango": "mango-agents",
    "vroom": "pyvroom",
    "zenoh": "eclipse-zenoh",
    "zmq": "pyzmq",
}
"""The distributions of modules, where these may not be installed."""
BY_HAND = {"cffirmware", "crazyflow"}
"""Modules that no extra can bring: the firmware's own, which is built with it, and a peer that users install."""
WRITTEN_BY_TESTS = {"marbles_of_a_user"}
"""Modules that a test writes before it imports them."""
ELSEWHERE = {"mpich"}
"""Of the extra bench: a program that no module imports."""


def name_of(requirement):
    return (
        re.split(r"[<>=!~;\[ ]", requirement, maxsplit=1)[0].lower().replace("_", "-")
    )


@pytest.fixture(scope="module")
def declared(repository):
    """Return the names of the distributions by extra; "" stands for what every installation has."""
    project = tomllib.loads((repository / "pyproject.toml").read_text())["project"]
    groups = {"": project["dependencies"], **project["optional-dependencies"]}
    return {
        extra: {name_of(requirement) for requirement in those}
        for extra, those in groups.items()
    }


@pytest.fixture(scope="module")
def imports(repository):
    """(path, top-level module) of each import of a library in the package and its missions, wherever it stands."""
    found = set()
    for folder in ("crazychoir", "agents"):
        for file in (repository / folder).rglob("*.py"):
            path = file.relative_to(repository).as_posix()
            if not path.startswith("crazychoir/agents"):
                found |= {
                    (path, name.split(".")[0])
                    for name in imported(file.read_text(encoding="utf-8"))
                }
    ours = {"crazychoir", *sys.stdlib_module_names, *BY_HAND}
    return sorted((path, name) for path, name in found if name not in ours)


def imported(text):
    """The names of modules that a text imports, also by name where that is written down."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield node.module
        elif (
            isinstance(node, ast.Call)
            and node.args
            and isinstance(node.args[0], ast.Constant)
        ):
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if called in IMPORTERS and isinstance(node.args[0].value, str):
                yield node.args[0].value


@cache
def installed():
    """The distributions of each top-level module, which takes seconds to find out."""
    return packages_distributions()


def distributions(module):
    """What could be declared for a module: the distributions here that bring it, or one of its own name."""
    names = {
        name.lower().replace("_", "-")
        for name in installed().get(module, [NAMED_OTHERWISE.get(module, module)])
    }
    return names | {TWINS[name] for name in names & TWINS.keys()}


def test_what_is_imported_is_declared(declared, imports):
    missing = []
    for path, module in imports:
        extras = [extra for extra, begins in ROOMS.items() if path.startswith(begins)]
        allowed = set().union(declared[""], *(declared[extra] for extra in extras))
        if not distributions(module) & allowed:
            missing.append(
                f"{path} imports {module}: not in dependencies, nor in the extras {extras}"
            )
    assert missing == []


@pytest.mark.parametrize("extra", ["", *ROOMS])
def test_what_is_declared_is_imported(declared, imports, extra):
    used = set().union(*(distributions(module) for _, module in imports))
    assert declared[extra] - used - ELSEWHERE == set()


@pytest.fixture(scope="module")
def groups(repository):
    """Return the requirements of each dependency group."""
    return tomllib.loads((repository / "pyproject.toml").read_text())[
        "dependency-groups"
    ]


def test_the_tests_have_the_extras_that_they_need(groups):
    assert {
        "crazychoir[dashboard,foxglove,gym,mujoco,ros2,tables]",
        "crazychoir[mocap]; python_version < '3.14'",
    } <= set(groups["test"])
    assert "crazychoir[bench]" in groups["bench"]


def test_what_the_tests_import_is_declared(repository, declared, groups):
    """Programs of tests/bench may import what the group bench brings, too."""
    tests = repository / "tests"
    known = set().union(*declared.values()) | set(map(name_of, groups["test"]))
    missing = []
    for file in sorted(tests.rglob("*.py")):
        measures = file.is_relative_to(tests / "bench")
        allowed = known | set(map(name_of, groups["bench"] if measures else ()))
        for name in sorted({name.split(".")[0] for name in imported(file.read_text())}):
            if name not in ours(repository) and not distributions(name) & allowed:
                missing.append(f"{file.relative_to(repository)} imports {name}")
    assert missing == []


@cache
def ours(repository):
    """Return the names of modules that need no distribution."""
    paths = [*(repository / "tests").rglob("*"), *(repository / "docs").glob("*.py")]
    own = {"crazychoir", "tests", *(path.stem for path in paths)}
    return own | {*sys.stdlib_module_names, *BY_HAND, *WRITTEN_BY_TESTS}


def test_an_import_is_found_wherever_it_stands():
    text = "import a.b\ndef f():\n    from c import d\n    importlib.import_module('e.f')\nfrom . import g\n"
    assert set(imported(text)) == {"a.b", "c", "e.f"}


def test_each_package_of_users_has_a_lowest_version(declared):
    users = set().union(*(declared[extra] for extra in declared.keys() - {"bench"}))
    assert {name_of(constraint) for constraint in lowest_versions()} == users


def test_a_requirement_without_a_lower_bound_is_refused():
    with pytest.raises(ValueError, match="numpy<3: allowed: a lower bound"):
        constrain("numpy<3")
