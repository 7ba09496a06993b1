"""The rules of the house, run as tests; each with a test that it can fail."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest
from source_rules import CLOCKS, STOPWATCHES, forbidden_clocks, set_iterations

CONTRACTS = ("house", "zenoh", "cflib", "mujoco", "solvers", "web", "pure")
REPORTS_DURATIONS = ("cli", "launch", "simulate.py", "solving.py")
ORDERED_ROOMS = ("runtime", "bus", "swarm")


def python_files(folder: Path) -> Iterator[Path]:
    """All .py files below the folder, through links too, in order."""
    for path, folders, files in os.walk(folder, followlinks=True):
        folders.sort()
        yield from (Path(path, name) for name in sorted(files) if name.endswith(".py"))


def module_name(file: Path, root: Path) -> str:
    return ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(".__init__")


def python(*arguments: str, cwd: Path, stdin: str | None = None) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {"COLUMNS": "200", "NO_COLOR": "1"}
    return subprocess.run(
        [sys.executable, *arguments], cwd=cwd, env=environment, input=stdin, capture_output=True, text=True
    )


def ruff(*arguments: str, cwd: Path, stdin: str | None = None) -> subprocess.CompletedProcess[str]:
    return python("-m", "ruff", "check", "--output-format=concise", *arguments, cwd=cwd, stdin=stdin)


def lint_imports(folder: Path) -> str:
    program = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    done = python("-c", program, "--no-cache", "--no-logo", cwd=folder)
    return f"exit {done.returncode}\n{done.stdout}{done.stderr}"


@pytest.fixture(scope="module")
def imports() -> grimp.ImportGraph:
    return grimp.build_graph("crazychoir", include_external_packages=True, cache_dir=None)


@pytest.fixture(scope="module")
def spoilt(repository, tmp_path_factory) -> Path:
    """A copy of the package with one fault for each rule."""
    folder = tmp_path_factory.mktemp("spoilt")
    shutil.copy(repository / "pyproject.toml", folder)
    shutil.copytree(repository / "crazychoir", folder / "crazychoir", ignore=shutil.ignore_patterns("__pycache__"))
    faults = {
        "bus/fault.py": "import cflib.crazyflie\nimport highspy\nimport mujoco\nfrom crazychoir import swarm\n",
        "swarm/fault.py": "import nicegui\n",
        "filters/fault.py": "import asyncio\nimport zenoh\nfrom crazychoir import control\n",
        "agents/fault.py": "from crazychoir import cli\n",
        "attic.py": "def f(x):\n    return x\n",
    }
    for name, text in faults.items():
        (folder / "crazychoir" / name).write_text(f'"""A fault."""\n\n{text}')
    return folder


@pytest.fixture(scope="module")
def verdict_on_spoilt(spoilt) -> str:
    return lint_imports(spoilt)


def test_the_import_contract_holds(repository):
    report = lint_imports(repository)
    assert f"Contracts: {len(CONTRACTS)} kept, 0 broken." in report, report


def test_the_import_contract_sees_every_file(repository, imports):
    package = repository / "crazychoir"
    files = {module_name(file, repository) for file in python_files(package)}
    assert {"crazychoir", "crazychoir.types", "crazychoir.agents"} <= files
    assert {m for m in imports.modules if m.partition(".")[0] == "crazychoir"} == files


@pytest.mark.parametrize(
    "fault",
    [
        "The lines of the house BROKEN",
        "crazychoir.bus is not allowed to import crazychoir.swarm",
        "crazychoir.filters is not allowed to import crazychoir.control",
        "crazychoir.agents is not allowed to import crazychoir.cli",
        "zenoh is imported in bus/network/zenoh_link.py only BROKEN",
        "cflib is imported in radio/ only BROKEN",
        "mujoco is imported in simulation/mujoco/ only BROKEN",
        "guidance/mpc.py only BROKEN",
        "imported in dashboard/ only BROKEN",
        "optimization/, routing/ BROKEN",
        f"Contracts: 0 kept, {len(CONTRACTS)} broken.",
        "exit 1",
    ],
)
def test_the_import_contract_can_break(verdict_on_spoilt, fault):
    assert fault in verdict_on_spoilt, verdict_on_spoilt


def test_a_room_without_a_line_is_refused(verdict_on_spoilt):
    assert "attic" in verdict_on_spoilt


def import_cycle(graph: grimp.ImportGraph) -> list[str]:
    """The modules of one import cycle, or none."""
    try:
        TopologicalSorter({m: graph.find_modules_directly_imported_by(m) for m in graph.modules}).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_there_is_no_import_cycle(imports):
    assert import_cycle(imports) == []


def test_an_import_cycle_is_found():
    graph = grimp.ImportGraph()
    for importer, imported in (("a", "b"), ("b", "c"), ("c", "a")):
        graph.add_import(importer=importer, imported=imported)
    assert set(import_cycle(graph)) == {"a", "b", "c"}


def places(package: Path, file: Path, found: list[str]) -> list[str]:
    return [f"{file.relative_to(package.parent)}:{place}" for place in found]


def clock_uses(package: Path) -> list[str]:
    """Where time is read: the wall clock outside runtime/clock.py, stopwatches outside what reports durations."""
    found = []
    for file in python_files(package):
        room = file.relative_to(package).parts
        if room == ("runtime", "clock.py"):
            continue
        banned = CLOCKS if room[0] in REPORTS_DURATIONS else CLOCKS | STOPWATCHES
        found += places(package, file, forbidden_clocks(file.read_text(), banned))
    return found


def hash_orders(package: Path) -> list[str]:
    """Where a room that the order of events goes through iterates over a set."""
    files = (file for room in ORDERED_ROOMS for file in python_files(package / room))
    return [place for file in files for place in places(package, file, set_iterations(file.read_text()))]


def test_time_is_read_in_one_place(repository):
    assert clock_uses(repository / "crazychoir") == []


def test_nothing_iterates_over_a_set(repository):
    assert hash_orders(repository / "crazychoir") == []


def test_clocks_and_sets_are_found_in_their_rooms(tmp_path):
    for room in ("runtime", "bus", "cli", "radio"):
        (tmp_path / room).mkdir()
        (tmp_path / room / "clock.py").write_text("import time\nt = time.time(), time.perf_counter()\nlist({1})\n")
    assert [p.split("/", 1)[1] for p in clock_uses(tmp_path)] == [
        "bus/clock.py:2: time.time",
        "bus/clock.py:2: time.perf_counter",
        "cli/clock.py:2: time.time",
        "radio/clock.py:2: time.time",
        "radio/clock.py:2: time.perf_counter",
    ]
    assert [p.split("/", 1)[1] for p in hash_orders(tmp_path)] == ["runtime/clock.py:3: {1}", "bus/clock.py:3: {1}"]


def test_ruff_is_content(repository):
    done = ruff(".", cwd=repository)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("rule", "line"),
    [
        ("T201", "print(3)"),
        ("F401", "import os"),
        ("ANN201", 'def f():\n    """F."""'),
        ("D103", "def f() -> None: ..."),
        ("BLE001", "try:\n    x = 1\nexcept Exception:\n    x = 2"),
        ("S301", "import pickle\n\nx = pickle.loads(b'')"),
        ("ASYNC251", 'import time\n\n\nasync def f() -> None:\n    """F."""\n    time.sleep(1)'),
        ("B006", 'def f(a: list[int] = []) -> None:\n    """F."""'),
        ("E501", "# " + 60 * "x "),
    ],
)
def test_ruff_can_complain(repository, rule, line):
    source = f'"""A fault."""\n\n{line}\n'
    done = ruff("--stdin-filename=crazychoir/fault.py", "-", cwd=repository, stdin=source)
    assert done.returncode == 1
    assert rule in done.stdout, done.stdout


def test_mypy_is_content_with_every_file(repository):
    done = python("-m", "mypy", cwd=repository)
    count = len(list(python_files(repository / "crazychoir")))
    assert done.stdout == f"Success: no issues found in {count} source files\n", done.stdout + done.stderr


def test_mypy_can_complain(spoilt, repository):
    cache = f"--cache-dir={repository / '.mypy_cache'}"
    done = python("-m", "mypy", cache, "crazychoir/attic.py", cwd=spoilt)
    assert done.returncode == 1
    assert "Function is missing a type annotation" in done.stdout, done.stdout
