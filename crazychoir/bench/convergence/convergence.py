"""`crazychoir bench algorithms`: algorithms on random problems, with tables and pictures for a paper."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from crazychoir.bench.convergence.contenders import choose_contenders
from crazychoir.bench.convergence.pictures import draw_comparison
from crazychoir.bench.convergence.study import (
    Case,
    StudyRequest,
    list_cases,
    run_cases,
)
from crazychoir.bench.paper.csv_files import write_csv
from crazychoir.files.output_files import require_writable_folder
from crazychoir.numerics.compiling import KERNEL_QUEUE

QUICK_ROUNDS: Final = 60
"""Rounds of a quick run."""


@dataclass(frozen=True)
class ComparisonChoice:
    """What a user chooses; the first of several values is the base, the others vary alone."""

    algorithms: tuple[str, ...] | None = None
    """Names of algorithms, or FILE.py:NAME; None for the default choice."""
    agents: tuple[int, ...] = (8, 16)
    """Numbers of agents."""
    graphs: tuple[str, ...] = ("ring", "complete")
    """Names of graphs."""
    losses: tuple[float, ...] = (0.0, 0.2, 0.4)
    """Shares of lost messages."""


STANDARD_REQUEST: Final = StudyRequest(
    problem="least-squares", rounds=150, seeds=5, accuracy=1e-3
)
"""What is compared without a choice."""


def run(
    folder: Path,
    request: StudyRequest = STANDARD_REQUEST,
    choice: ComparisonChoice = ComparisonChoice(),
    quick: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Run all algorithms in all cases, and write tables and pictures.

    folder: folder for the files
    request: problem, rounds, number of problems, accuracy
    choice: algorithms and cases
    quick: the first case alone, with one problem and few rounds
    say: called with a text that says what is being computed
    Raises ConfigError for an unknown algorithm, problem or graph, before anything is computed.
    """
    require_writable_folder(folder, "--out")
    contenders = choose_contenders(choice.algorithms, request.problem)
    cases = list_cases(choice.agents, choice.graphs, choice.losses)
    if quick:
        cases = cases[:1]
        request = replace(request, rounds=QUICK_ROUNDS, seeds=1)
    for case in cases:
        case.make_graph(seed=1)
    KERNEL_QUEUE.compile()
    results = run_cases(contenders, cases, request, say)
    rows = [result.summarise(request.accuracy) for result in results]
    runs = [row for result in results for row in result.list_runs(request.accuracy)]
    rounds = [row for result in results for row in result.list_rounds()]
    files = [
        write_csv(folder / "summary.csv", rows),
        write_csv(folder / "runs.csv", runs),
        write_csv(folder / "rounds.csv", rounds),
        *draw_comparison(results, rows, request.accuracy, folder),
    ]
    return {
        "folder": str(folder),
        "files": [file.name for file in files],
        **asdict(request),
        "labels": {one.name: one.label for one in contenders},
        "rows": rows,
    }


def table(result: dict[str, Any]) -> Group:
    """Return the figures of the first case as a table, and the written files."""
    first = result["rows"][0]
    base = [
        row for row in result["rows"] if _describe_case(row) == _describe_case(first)
    ]
    title = f"{result['problem']}, {_describe_case(first)}: medians of {first['seeds']} problems"
    made = Table(title=title, box=box.SIMPLE_HEAD, padding=0, show_edge=False)
    until = f"until {result['accuracy']:g}"
    made.add_column("algorithm")
    for name in ("step", f"rounds {until}", "messages", "kB an agent", "last error"):
        made.add_column(name, justify="right")
    for row in base:
        made.add_row(
            result["labels"][row["algorithm"]],
            f"{row['step_scale']:g}",
            _format(row["rounds_median"]),
            _format(row["messages_an_agent_median"]),
            _format(row["bytes_an_agent_median"], 1e-3),
            _format(row["last_error_median"]),
        )
    files = f"In {result['folder']}: {', '.join(result['files'])}"
    return Group(made, Text("\n".join([*_describe_failures(result), files])))


def _describe_failures(result: dict[str, Any]) -> list[str]:
    """Return a line for each algorithm and case with runs that failed."""
    return [
        f"{result['labels'][row['algorithm']]}: {row['failed']} of {row['seeds']} runs failed: "
        f"{_describe_case(row)}. {row['failure']}".removesuffix(". ")
        for row in result["rows"]
        if row["failed"]
    ]


def _describe_case(row: dict[str, Any]) -> str:
    return str(Case(row["agents"], row["graph"], row["loss"]))


def _format(value: float | None, scale: float = 1.0) -> str:
    return "-" if value is None else f"{scale * value:.3g}"
