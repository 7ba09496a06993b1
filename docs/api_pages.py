"""The pages of the API: the classes and functions that a user writes against.

Each page names modules and packages, and of some modules the few names that users need. What stands
on a page comes from docstrings, so a new algorithm is on its page without a change here.
"""

import ast
from collections.abc import Iterator
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
INDEX = "api/index.md"
PAGES: dict[str, tuple[str, str, tuple[str, ...]]] = {
    "api/types.md": (
        "Types",
        "States, references and commands. Units are SI.",
        ("crazychoir.types",),
    ),
    "api/errors.md": (
        "Errors",
        "All exceptions that crazychoir raises.",
        ("crazychoir.errors:class",),
    ),
    "api/python.md": (
        "Scripts and notebooks",
        "Flights, sweeps and simulations from Python. "
        "[The Python interface](../crazychoir/api/README.md) shows how to use them.",
        (
            "crazychoir.api.flights:fly,read,Flight",
            "crazychoir.api.sweeps:sweep",
            "crazychoir.api.table:Table",
            "crazychoir.api.simulating:simulate,Simulation",
            "crazychoir.api.solving:solve",
        ),
    ),
    "api/guidance.md": (
        "Guidance",
        "Base classes of missions, and what mission files may define. "
        "[Missions](../agents/README.md) shows how to use them.",
        (
            "crazychoir.guidance.guidance:CFGuidance",
            "crazychoir.guidance.feedback:CFDistributedFeedback",
            "crazychoir.guidance.mission:Mission",
            "crazychoir.guidance.mission_options",
            "crazychoir.guidance.member:Member",
            "crazychoir.guidance.sensors",
            "crazychoir.guidance.timed:TimedFlight,TargetList",
            "crazychoir.guidance.mpc",
            "crazychoir.guidance.aggregative",
            "crazychoir.guidance.formation",
            "crazychoir.guidance.tasks.task_assignment:TaskAssignmentGuidance",
            "crazychoir.guidance.delivery.pickup_delivery:PDVRPGuidance",
            "crazychoir.guidance.delivery.online_delivery:OnlinePDVRPGuidance",
        ),
    ),
    "api/team.md": (
        "Rounds and graphs",
        "How drones exchange values, and the graphs on which they do.",
        (
            "crazychoir.team.communicator",
            "crazychoir.team.round",
            "crazychoir.team.graph",
            "crazychoir.team.algorithm_run",
        ),
    ),
    "api/algorithms.md": (
        "Algorithms",
        "The distributed algorithms, one module each. "
        "[Optimization](../crazychoir/optimization/README.md) says which one solves which problem.",
        (
            "crazychoir.optimization.algorithms",
            "crazychoir.optimization.assignment",
            "crazychoir.optimization.predictive_control",
        ),
    ),
    "api/problems.md": (
        "Problems and rounds",
        "What an algorithm of your own is made of: local problems, rounds, step sizes, ends.",
        (
            "crazychoir.optimization.problems.problems",
            "crazychoir.optimization.rounds",
            "crazychoir.solve.simulate",
            "crazychoir.optimization.history",
        ),
    ),
    "api/swarm_file.md": (
        "Swarm file",
        "The swarm file as an object. [Keys](../deploy/REFERENCE.md) has the same keys as tables.",
        ("crazychoir.config.swarm_config", "crazychoir.config.tables"),
    ),
}
"""{page: title, what it is for, modules and packages}.

`module:Name,Name` shows these names of a module alone, `module:class` its classes alone.
"""


def texts() -> dict[str, str]:
    """Return the text of each page of the API, by its path on the site."""
    return {INDEX: _index(), **{page: _page(*row) for page, row in PAGES.items()}}


def _page(title: str, purpose: str, names: tuple[str, ...]) -> str:
    """Return a page with the public classes and functions of modules and packages."""
    parts = [f"# {title}", purpose]
    for row in names:
        name, _, chosen = row.partition(":")
        for module, file in _modules(name):
            members = _members(file, chosen)
            if members:
                options = "".join(f"\n        - {member}" for member in members)
                parts.append(f"::: {module}\n    options:\n      members:{options}")
    return "\n\n".join(parts) + "\n"


def _members(file: Path, chosen: str) -> list[str]:
    """Return the classes and functions of a module that a page shows.

    chosen: names with commas between them, "class" for all classes, "" for all
    Raises ValueError if the module does not define one of the names.
    """
    public = _public(file)
    if chosen in ("", "class"):
        return [
            name for name, kind in public.items() if not chosen or kind is ast.ClassDef
        ]
    names = chosen.split(",")
    missing = [name for name in names if name not in public]
    if missing:
        raise ValueError(f"docs/api_pages.py: {file} does not define {missing}")
    return names


def _index() -> str:
    """Return the page of the public names: where each is defined, and what it is."""
    rows = []
    for module, name in sorted(_public_names(), key=lambda row: row[1]):
        summary = _summary(_file(module), name)
        rows.append(f"| [`{name}`][{module}.{name}] | {summary} |")
    return (
        "# Public names\n\nThese names come from `crazychoir` itself: `from crazychoir import State`. "
        "Their documentation, and that of all else that a user writes against, is on the pages of "
        "this section.\n\n| name | what it is |\n|---|---|\n" + "\n".join(rows) + "\n"
    )


def _public_names() -> Iterator[tuple[str, str]]:
    """Yield the module and the name of each public name of the package."""
    tree = ast.parse((REPOSITORY / "crazychoir" / "__init__.py").read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            for statement in node.body:
                if isinstance(statement, ast.ImportFrom) and statement.module:
                    for alias in statement.names:
                        yield statement.module, alias.name


def _modules(name: str) -> Iterator[tuple[str, Path]]:
    """Yield a module, or the modules of a package, with their files."""
    file = _file(name)
    if file.name != "__init__.py":
        yield name, file
        return
    for inner in sorted(file.parent.rglob("*.py")):
        if inner.name != "__init__.py":
            path = inner.relative_to(REPOSITORY).with_suffix("")
            yield ".".join(path.parts), inner


def _file(module: str) -> Path:
    """Return the file of a module or package."""
    path = REPOSITORY.joinpath(*module.split("."))
    return path / "__init__.py" if path.is_dir() else path.with_suffix(".py")


def _public(file: Path) -> dict[str, type[ast.stmt]]:
    """Return the public classes and functions that a module defines, and what each is."""
    return {
        node.name: type(node)
        for node in ast.parse(file.read_text()).body
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and not node.name.startswith("_")
    }


def _summary(file: Path, name: str) -> str:
    """Return the first sentence of the docstring of a class."""
    for node in ast.parse(file.read_text()).body:
        if isinstance(node, ast.ClassDef) and node.name == name:
            first = (ast.get_docstring(node) or "").split("\n\n")[0]
            return " ".join(first.split()).replace("|", "\\|")
    return ""
