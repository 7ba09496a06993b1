"""The rules of the house, run as tests; each with a test that it can fail."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import grimp
import pytest
from pages import FRONT_PAGE, PAGES
from prose_rules import hard_docstrings, hard_lines, hard_test_names
from script_rules import (
    hard_comments,
    one_word_script_constants,
    packed_declarations,
)
from source_rules import CLOCKS, STOPWATCHES, forbidden_clocks, set_iterations
from style_rules import (
    MOST_ARGUMENTS,
    MOST_CLASS_ATTRIBUTES,
    MOST_CLASS_LINES,
    MOST_CLASS_METHODS,
    large_classes,
    nested_conditions,
    one_word_constants,
    packed_assignments,
    shared_class_names,
    wide_functions,
)
from syntax_trees import syntax_tree

REPOSITORY = Path(__file__).resolve().parents[2]
CONTRACTS = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"][
    "importlinter"
]["contracts"]
LAYERS = [contract for contract in CONTRACTS if contract["type"] == "layers"]
REPORTS_DURATIONS = ("api", "bench", "cli", "launch", "solve")
ORDERED_ROOMS = ("runtime", "bus", "team")
MOST_MODULES = 22  # a folder
MOST_LINES = 200  # of the front page
MOST_MISSION_LINES = 90  # of a file in agents/
LARGE_CLASSES = {
    "Fleet",
    "Swarm",
}
"""Classes that hold several responsibilities. This list only shrinks."""
WIDE_FUNCTIONS = {
    "Pilot.__init__",
    "fly",  # as simulate
    "solve",  # as simulate
    "sweep",  # as simulate
    "simulate",  # users call it by name; its options are independent of each other
}
"""Functions with too many arguments. This list only shrinks."""
SHARED_CLASS_NAMES = {
    "Stop",  # a request of the page, named by its class; a stop of a route
    "Task",  # a task of a running swarm; a task of an assignment problem
}
"""Names that several classes have."""
LAYOUT_FILES = {
    "crazychoir/simulation/motor_level/lanes.py",  # rows of one array, numbered in groups
}
"""Files that may set several constants in one statement."""
BRANCHING = 'def f(a: int) -> None:\n    """F."""\n' + 12 * "    if a:\n        a = 1\n"
"""A function with thirteen ways through it."""
EXCUSES = re.compile(
    r"#\s*(?:ruff:\s*)?noqa(?!:)|#\s*(?:ruff:\s*)?noqa:.*\bC901\b|#\s*(?:fmt|yapf):\s*(?:skip|off|disable)\b",
    re.IGNORECASE,
)
"""Comments that take a function off the limit of branches, or a line off the formatter."""
FENCED = re.compile(r"^```.*?^```|`[^`\n]*`", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")
WEB_PAGES = "https://github.com/crazychoir/crazychoir/blob/main/"
WEB_PICTURES = "https://raw.githubusercontent.com/crazychoir/crazychoir/main/"


def python_files(folder: Path) -> Iterator[Path]:
    """All .py files below the folder, through links too, in order."""
    for path, folders, files in os.walk(folder, followlinks=True):
        folders.sort()
        yield from (Path(path, name) for name in sorted(files) if name.endswith(".py"))


def module_name(file: Path, root: Path) -> str:
    return ".".join(file.relative_to(root).with_suffix("").parts).removesuffix(
        ".__init__"
    )


def python(
    *arguments: str, cwd: Path, stdin: str | None = None
) -> subprocess.CompletedProcess[str]:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"} | {
        "COLUMNS": "200",
        "NO_COLOR": "1",
    }
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env=environment,
        input=stdin,
        capture_output=True,
        text=True,
    )


def ruff(
    *arguments: str, cwd: Path, stdin: str | None = None
) -> subprocess.CompletedProcess[str]:
    return python(
        "-m",
        "ruff",
        "check",
        "--output-format=concise",
        *arguments,
        cwd=cwd,
        stdin=stdin,
    )


def lint_imports(folder: Path) -> str:
    program = (
        "from importlinter.cli import lint_imports_command; lint_imports_command()"
    )
    done = python("-c", program, "--no-cache", "--no-logo", cwd=folder)
    return f"exit {done.returncode}\n{done.stdout}{done.stderr}"


@pytest.fixture(scope="module", autouse=True)
def trees() -> Iterator[None]:
    """Free the syntax trees, which the rules share, after the last test."""
    yield
    syntax_tree.cache_clear()


@pytest.fixture(scope="module")
def imports() -> grimp.ImportGraph:
    return grimp.build_graph(
        "crazychoir", include_external_packages=True, cache_dir=None
    )


def bottom_imports_top(package: Path, contract: dict) -> None:
    """Add an import of its highest child to the lowest child of a contract's container."""
    container = contract["containers"][0]
    top = contract["layers"][0].split(" | ")[0]
    bottom = contract["layers"][-1].split(" | ")[0]
    folder = package.parent.joinpath(*container.split("."))
    file = (
        folder / bottom / "__init__.py"
        if (folder / bottom).is_dir()
        else folder / f"{bottom}.py"
    )
    file.write_text(f"{file.read_text()}\nimport {container}.{top}\n")


@pytest.fixture(scope="module")
def spoilt(repository, tmp_path_factory) -> Path:
    """Return a copy of the package with one fault for each contract and a room without a line."""
    folder = tmp_path_factory.mktemp("spoilt")
    shutil.copy(repository / "pyproject.toml", folder)
    shutil.copytree(
        repository / "crazychoir",
        folder / "crazychoir",
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    for contract in LAYERS:
        bottom_imports_top(folder / "crazychoir", contract)
    faults = {
        "bus/fault.py": "import cflib.crazyflie\nimport highspy\nimport mujoco\n",
        "team/fault.py": "import foxglove\nimport nicegui\n",
        "filters/fault.py": "import asyncio\nimport zenoh\n",
        "agents/fault.py": "from crazychoir import cli\n",
        "attic.py": "",
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


@pytest.mark.parametrize("contract", CONTRACTS, ids=lambda contract: contract["id"])
def test_each_import_contract_can_break(verdict_on_spoilt, contract):
    report = " ".join(verdict_on_spoilt.split())
    assert f"{contract['name']} BROKEN" in report, verdict_on_spoilt
    assert "exit 1" in report


@pytest.mark.parametrize("contract", LAYERS, ids=lambda contract: contract["id"])
def test_each_import_that_goes_up_is_named(verdict_on_spoilt, contract):
    container = contract["containers"][0]
    top = contract["layers"][0].split(" | ")[0]
    bottom = contract["layers"][-1].split(" | ")[0]
    text = f"{container}.{bottom} is not allowed to import {container}.{top}"
    assert text in " ".join(verdict_on_spoilt.split()), verdict_on_spoilt


def test_every_room_with_sub_packages_has_a_contract(repository):
    package = repository / "crazychoir"
    parents = {file.parent.parent for file in package.rglob("*/__init__.py")} - {
        package.parent
    }
    with_contract = {
        repository.joinpath(*contract["containers"][0].split("."))
        for contract in LAYERS
    }
    assert parents == with_contract


def crowded_folders(package: Path) -> list[str]:
    """Return the folders with more modules than a reader takes in at a glance."""
    counts: dict[Path, int] = {}
    for file in python_files(package):
        if file.name != "__init__.py":
            counts[file.parent] = counts.get(file.parent, 0) + 1
    return [
        f"{folder.relative_to(package)}: {count}"
        for folder, count in counts.items()
        if count > MOST_MODULES
    ]


def test_no_folder_is_crowded(repository):
    assert crowded_folders(repository / "crazychoir") == []


def test_a_crowded_folder_is_found(tmp_path):
    (tmp_path / "room").mkdir()
    for k in range(MOST_MODULES + 1):
        (tmp_path / "room" / f"module_{k}.py").touch()
    assert crowded_folders(tmp_path) == [f"room: {MOST_MODULES + 1}"]


def test_a_room_without_a_line_is_refused(verdict_on_spoilt):
    assert "attic" in verdict_on_spoilt


def import_cycle(graph: grimp.ImportGraph) -> list[str]:
    """The modules of one import cycle, or none."""
    try:
        TopologicalSorter(
            {m: graph.find_modules_directly_imported_by(m) for m in graph.modules}
        ).prepare()
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
    return [
        place
        for file in files
        for place in places(package, file, set_iterations(file.read_text()))
    ]


def test_time_is_read_in_one_place(repository):
    assert clock_uses(repository / "crazychoir") == []


def test_nothing_iterates_over_a_set(repository):
    assert hash_orders(repository / "crazychoir") == []


def test_clocks_and_sets_are_found_in_their_rooms(tmp_path):
    for room in ("runtime", "bus", "cli", "radio"):
        (tmp_path / room).mkdir()
        (tmp_path / room / "clock.py").write_text(
            "import time\nt = time.time(), time.perf_counter()\nlist({1})\n"
        )
    assert [p.split("/", 1)[1] for p in clock_uses(tmp_path)] == [
        "bus/clock.py:2: time.time",
        "bus/clock.py:2: time.perf_counter",
        "cli/clock.py:2: time.time",
        "radio/clock.py:2: time.time",
        "radio/clock.py:2: time.perf_counter",
    ]
    assert [p.split("/", 1)[1] for p in hash_orders(tmp_path)] == [
        "runtime/clock.py:3: {1}",
        "bus/clock.py:3: {1}",
    ]


def hard_texts(folder: Path) -> list[str]:
    """Return the places of all docstrings below the folder that are hard to read."""
    return [
        place
        for file in python_files(folder)
        for place in places(folder, file, hard_docstrings(file.read_text()))
    ]


@pytest.mark.parametrize("folder", ["crazychoir", "tests"])
def test_docstrings_are_plain_english(repository, folder):
    assert hard_texts(repository / folder) == []


def own_files(repository: Path) -> list[Path]:
    """Return the files of the package, with its missions, each once."""
    return list(python_files(repository / "crazychoir"))


def test_classes_have_one_responsibility(repository):
    large = {
        name: f"{file.relative_to(repository)}: {size}"
        for file in own_files(repository)
        for name, size in large_classes(file.read_text())
    }
    assert {name: large[name] for name in large.keys() - LARGE_CLASSES} == {}
    assert LARGE_CLASSES - large.keys() == set(), "take it off the list"


@pytest.mark.parametrize(
    "body",
    [
        "\n".join(f"    # {k}" for k in range(MOST_CLASS_LINES)) + "\n    x = 1",
        "\n".join(f"    def f{k}(self): ..." for k in range(MOST_CLASS_METHODS + 1)),
        "\n".join(f"    a{k}: int" for k in range(MOST_CLASS_ATTRIBUTES + 1)),
        "    def f(self):\n"
        + "\n".join(f"        self.a{k} = 1" for k in range(MOST_CLASS_ATTRIBUTES + 1)),
    ],
    ids=["lines", "methods", "fields", "attributes"],
)
def test_large_classes_are_found(body):
    assert [name for name, _ in large_classes(f"class Large:\n{body}\n")] == ["Large"]


def test_functions_take_few_arguments(repository):
    wide = {
        name: f"{file.relative_to(repository)}: {count} arguments"
        for file in own_files(repository)
        for name, count in wide_functions(file.read_text())
    }
    assert {name: wide[name] for name in wide.keys() - WIDE_FUNCTIONS} == {}
    assert WIDE_FUNCTIONS - wide.keys() == set(), "take it off the list"


def test_wide_functions_are_found():
    many = ", ".join(f"a{k}" for k in range(MOST_ARGUMENTS + 1))
    few = ", ".join(f"a{k}" for k in range(MOST_ARGUMENTS))
    assert list(wide_functions(f"def f({many}): ...")) == [("f", MOST_ARGUMENTS + 1)]
    assert list(wide_functions(f"def f({few}): ...")) == []
    assert list(wide_functions(f"class A:\n  def f(self, {few}): ...")) == []
    assert list(wide_functions(f"class A:\n  async def f(self, *, {many}): ...")) == [
        ("A.f", MOST_ARGUMENTS + 1)
    ]
    assert list(wide_functions(f"@kernel()\ndef f({many}): ...")) == []
    assert list(wide_functions(f"def f({many}, o: typer.Option = 1): ...")) == []


def test_constants_have_names_of_two_words(repository):
    found = [
        f"{file.relative_to(repository)}: {name}"
        for file in own_files(repository)
        for name in one_word_constants(file.read_text())
    ]
    assert found == []


def test_constants_of_one_word_are_found():
    source = "LOOK = 1\n_MOST: int = 2\nPOSE_TIMEOUT = 0.5\nT = TypeVar('T')\nlog = 3\n"
    assert one_word_constants(source) == ["LOOK", "_MOST"]


def test_each_assignment_has_a_line_of_its_own(repository):
    found = [
        place
        for file in own_files(repository)
        if str(file.relative_to(repository)) not in LAYOUT_FILES
        for place in places(
            repository / "crazychoir", file, list(packed_assignments(file.read_text()))
        )
    ]
    assert found == []


def test_packed_assignments_are_found():
    source = (
        "A, B = 1, 2\nx, y = y, x\nC, D = range(2)\na, b, c = 1, 2, 3\nE, F = call()\n"
    )
    assert list(packed_assignments(source)) == ["1: A, B", "3: C, D", "4: a, b, c"]


def test_conditional_expressions_are_not_nested(repository):
    found = [
        place
        for file in own_files(repository)
        for place in places(
            repository / "crazychoir", file, nested_conditions(file.read_text())
        )
    ]
    assert found == []


@pytest.mark.parametrize(
    "nested",
    [
        "1 if a else 2 if b else 3",
        "(1 if b else 2) if a else 3",
        "1 if (a if b else c) else 2",
        "f(1 if b else 2) if a else 3",
    ],
    ids=["otherwise", "result", "test", "argument"],
)
def test_nested_conditional_expressions_are_found(nested):
    assert nested_conditions("x = 1 if a else 2\ny = [1 if a else 2, b]\n") == []
    assert [place[:2] for place in nested_conditions(f"\nx = {nested}\n")] == ["2:"]


def test_class_names_mean_one_thing(repository):
    shared = shared_class_names(own_files(repository))
    assert {name: shared[name] for name in shared.keys() - SHARED_CLASS_NAMES} == {}
    assert SHARED_CLASS_NAMES - shared.keys() == set(), "take it off the list"


def test_shared_class_names_are_found(tmp_path):
    for name in ("one", "other"):
        (tmp_path / f"{name}.py").write_text("class Link: ...\n")
    assert list(shared_class_names(tmp_path.glob("*.py"))) == ["Link"]


def test_hard_docstrings_are_found(tmp_path):
    (tmp_path / "room").mkdir()
    text = '"""Return the neighbours."""\n\ndef f():\n    """Whoever has said it."""\n'
    text += 'LIMIT = 3\n"""Of those that are late, the latter."""\n'
    (tmp_path / "room" / "a.py").write_text(text)
    found = hard_texts(tmp_path)
    assert sorted(place.rpartition("a.py:")[2] for place in found) == [
        "4: Whoever",
        "6: those that",
    ]


def scripts(repository: Path) -> list[Path]:
    """Return the JavaScript files of the operator's page."""
    return sorted((repository / "crazychoir").rglob("*.js"))


@pytest.mark.parametrize(
    "rule", [hard_comments, packed_declarations, one_word_script_constants]
)
def test_the_scripts_of_the_page_are_plain(repository, rule):
    files = scripts(repository)
    assert repository / "crazychoir/dashboard/static/page.js" in files
    found = [
        place
        for file in files
        for place in places(repository, file, rule(file.read_text()))
    ]
    assert found == []


def test_hard_comments_of_scripts_are_found():
    source = (
        '// Return the drones.\nconst text = "// who"; // whom it was sent to\n'
        "// Keep the stops, and those\n// that were sent.\nf();\n/* Tell\nnobody */\n"
        "const link = `http://who`;\n"
    )
    assert hard_comments(source) == ["2: whom", "3: those that", "6: nobody"]


def test_packed_declarations_of_scripts_are_found():
    source = (
        "const LOOK = 250, AGAIN = 1000;\nlet a = null,\n  b;\nconst [c, d] = f(1, 2);\n"
        'const { e, g } = { e: 1, g: 2 };\nconst h = "1, 2"; // i, j\n'
        "export const k = (l, m) => {\n  const n = 1, { o } = l;\n};\n"
        "for (const p of [q, r]) s(p);\n"
    )
    assert packed_declarations(source) == ["1: LOOK, AGAIN", "2: a, b", "8: n, { o }"]


def test_one_word_constants_of_scripts_are_found():
    source = (
        "export const STOP = 1;\nconst LOOK_PERIOD = 250;\n  let MOST = 1, last = 2;\n"
        "const t = T;\n// const WHY = 1\n"
    )
    assert one_word_script_constants(source) == ["1: STOP", "3: MOST"]


def hard_pages(root: Path) -> list[str]:
    """Return the lines of the documentation that are hard to read, as `page:line: word`."""
    return [
        f"{file}:{found}"
        for file in all_pages(root)
        for found in hard_lines((root / file).read_text())
    ]


def test_the_documentation_is_plain_english(repository):
    assert hard_pages(repository) == []


def test_hard_lines_of_the_documentation_are_found(tmp_path):
    text = "# Whose\n\n```\nwho\n```\n`who` knows those that are late\n"
    generated = "<!-- generated: begin -->\nwho\n<!-- generated: end -->\n"
    (tmp_path / FRONT_PAGE).write_text(text + generated)
    assert hard_pages(tmp_path) == [
        f"{FRONT_PAGE}:1: Whose",
        f"{FRONT_PAGE}:6: those that",
    ]


def test_the_names_of_tests_are_plain_sentences(repository):
    tests = repository / "tests"
    found = [
        place
        for file in python_files(tests)
        for place in places(tests, file, hard_test_names(file.read_text()))
    ]
    assert found == []


@pytest.mark.parametrize(
    "name",
    [
        "test_who_lands_waits",
        "test_a_drone_waits_for_nobody",
        "test_one_that_lands_waits",
        "test_those_that_land_wait",
        "test_of_two_drones_one_waits",
        "test_that_a_drone_waits",
        "test_the_same_drone_waits",
        "test_as_told_it_waits",
        "test_so_does_a_drone",
    ],
)
def test_hard_names_of_tests_are_found(name):
    easy = "def test_a_drone_that_lands_waits_as_told(): ...\n"
    hard = f"class TestLanding:\n  async def {name}(self): ...\n"
    assert hard_test_names(easy + hard) == [f"3: {name}"]


def missing_pages(root: Path) -> list[str]:
    """Return the pages of the documentation that are not there."""
    return [file for file in PAGES if not (root / file).is_file()]


def test_every_room_has_its_page(repository):
    assert missing_pages(repository) == []


def test_a_missing_page_is_found(tmp_path):
    for file in PAGES[1:]:
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / file).write_text("# A room\n")
    assert missing_pages(tmp_path) == [FRONT_PAGE]


def is_short(text: str) -> bool:
    """Return whether the text is short enough for the front page."""
    return len(text.splitlines()) <= MOST_LINES


def test_the_front_page_is_short(repository):
    assert is_short((repository / FRONT_PAGE).read_text())


def test_a_long_front_page_is_found():
    assert is_short("a\n" * MOST_LINES)
    assert not is_short("a\n" * (MOST_LINES + 1))


def long_missions(folder: Path) -> list[str]:
    """Return the missions that a reader does not take in at a glance."""
    return [
        file.stem
        for file in sorted(folder.glob("*.py"))
        if len(file.read_text().splitlines()) > MOST_MISSION_LINES
    ]


def test_missions_are_short(repository):
    assert long_missions(repository / "agents") == []


def test_a_long_mission_is_found(tmp_path):
    (tmp_path / "short.py").write_text("a = 1\n" * MOST_MISSION_LINES)
    (tmp_path / "long.py").write_text("a = 1\n" * (MOST_MISSION_LINES + 1))
    assert long_missions(tmp_path) == ["long"]


def all_pages(root: Path) -> list[str]:
    """Return the front page, the page for contributors, and all pages of the folders that have pages."""
    folders = ("agents", "crazychoir", "deploy")
    files = [file for folder in folders for file in (root / folder).rglob("*.md")]
    guide = [root / "CONTRIBUTING.md"] if (root / "CONTRIBUTING.md").is_file() else []
    return [FRONT_PAGE, *sorted(str(file.relative_to(root)) for file in guide + files)]


def broken_links(root: Path) -> list[str]:
    """Return the links of the documentation that lead to no file, as `page: link`.

    A link of the front page must be absolute, because other sites show that page too. It leads to
    a file of this repository, or to another site. The links of other pages are relative.
    """
    found = []
    for file in all_pages(root):
        text = FENCED.sub("", (root / file).read_text())
        for link in LINK.findall(text):
            if not _leads_to_a_file(root, file, link):
                found.append(f"{file}: {link}")
    return found


def _leads_to_a_file(root: Path, file: str, link: str) -> bool:
    target, _, _ = link.partition("#")
    if file == FRONT_PAGE:
        for prefix in (WEB_PAGES, WEB_PICTURES):
            if target.startswith(prefix):
                return (root / target.removeprefix(prefix)).exists()
        return target.startswith("https://")
    return target.startswith("https://") or ((root / file).parent / target).exists()


def test_the_links_of_the_documentation_lead_to_files(repository):
    assert broken_links(repository) == []


def test_a_broken_link_is_found(tmp_path):
    pages = {
        FRONT_PAGE: f"[a]({WEB_PAGES}LICENSE) [b]({WEB_PAGES}none.md) [c](LICENSE)",
        "agents/README.md": "[a](../LICENSE) [b](none.md) [c](https://zenoh.io) `[d](e)`",
    }
    (tmp_path / "LICENSE").touch()
    (tmp_path / "agents").mkdir()
    for file, text in pages.items():
        (tmp_path / file).write_text(text)
    assert broken_links(tmp_path) == [
        f"{FRONT_PAGE}: {WEB_PAGES}none.md",
        f"{FRONT_PAGE}: LICENSE",
        "agents/README.md: none.md",
    ]


def test_the_formatter_has_decided_the_layout(repository):
    done = python("-m", "ruff", "format", "--check", ".", cwd=repository)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_formatter_can_complain(repository):
    words = ("-m", "ruff", "format", "--check", "--stdin-filename=a.py", "-")
    assert python(*words, cwd=repository, stdin="x  =  1\n").returncode == 1


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
        (
            "ASYNC251",
            'import time\n\n\nasync def f() -> None:\n    """F."""\n    time.sleep(1)',
        ),
        ("B006", 'def f(a: list[int] = []) -> None:\n    """F."""'),
        ("E501", "# " + 60 * "x "),
        ("C901", BRANCHING),
    ],
)
def test_ruff_can_complain(repository, rule, line):
    source = f'"""A fault."""\n\n{line}\n'
    done = ruff(
        "--stdin-filename=crazychoir/fault.py", "-", cwd=repository, stdin=source
    )
    assert done.returncode == 1
    assert rule in done.stdout, done.stdout


def excuses(root: Path) -> list[str]:
    """Return the lines that ask the linter or the formatter to look away, as `file:line`."""
    return [
        f"{file.relative_to(root)}:{number}"
        for folder in ("agents", "crazychoir", "tests")
        for file in python_files(root / folder)
        for number, line in enumerate(file.read_text().splitlines(), 1)
        if EXCUSES.search(line)
    ]


def test_no_line_is_excused_from_layout_or_branches(repository):
    assert excuses(repository) == []


@pytest.mark.parametrize(
    "comment",
    [
        "noqa",
        "ruff: noqa",
        "ruff: noqa: C901",
        "noqa: C901",
        "noqa: E501, C901",
        "fmt: skip",
        "fmt: off",
        "fmt:skip",
        "yapf: disable",
    ],
)
def test_excuses_are_found(tmp_path, comment):
    (tmp_path / "agents").mkdir()
    (tmp_path / "agents" / "a.py").write_text(
        f"x = 1  # noqa: E501\ny = 2  # {comment}\n"
    )
    assert excuses(tmp_path) == ["agents/a.py:2"]


def excused_files() -> list[str]:
    """Return the files that may have functions with too many ways through them."""
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["tool"]
    excused = settings["ruff"]["lint"]["per-file-ignores"]
    return [file for file, rules in excused.items() if "C901" in rules]


@pytest.mark.parametrize("file", excused_files())
def test_excused_files_have_a_branching_function(repository, file):
    limit = "--config=lint.mccabe.max-complexity=12"
    done = ruff("--isolated", "--select=C901", limit, file, cwd=repository)
    assert done.returncode == 1, "take it off the list"


@pytest.mark.timeout(500)  # it has the processors that no other test wants
def test_mypy_is_content_with_every_file_and_complains_about_a_faulty_one(
    repository, tmp_path
):
    faulty = tmp_path / "faulty_module.py"
    faulty.write_text("def f(x):\n    return x\n")
    done = python("-m", "mypy", "crazychoir", str(faulty), cwd=repository)
    checked = len(list(python_files(repository / "crazychoir"))) + 1
    lines = done.stdout.splitlines()
    assert len(lines) == 2, done.stdout + done.stderr
    error, summary = lines
    assert "faulty_module.py:1: error: Function is missing a type annotation" in error
    assert summary == f"Found 1 error in 1 file (checked {checked} source files)"
