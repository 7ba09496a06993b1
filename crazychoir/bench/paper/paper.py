"""`crazychoir bench paper`: the tables and pictures of an article on the routing, in one folder."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rich.text import Text

from crazychoir.bench import routing as bench_routing
from crazychoir.bench.paper import ablation as bench_ablation
from crazychoir.bench.paper import pictures as bench_pictures
from crazychoir.bench.paper.csv_files import write_csv
from crazychoir.files.output_files import output_file, require_writable_folder


def run(
    folder: Path,
    quick: bool = False,
    peers: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Measure and write all tables and pictures.

    folder: folder for the files
    quick: fewer cases
    peers: whether to run the other solvers too, in real time, which takes most of the time
    say: called with a text that says what is being measured
    """
    require_writable_folder(folder, "--out")
    rows = bench_ablation.run(bench_ablation.list_cases(quick), say)
    cells = bench_ablation.summary(rows)
    files = [
        write_csv(folder / "ablation_runs.csv", rows),
        write_csv(folder / "ablation.csv", cells),
    ]
    files += bench_pictures.draw_ablation(cells, folder)
    if peers:
        files += _write_solvers(folder, quick, say)
    same = all(row["same_plan"] for row in rows)
    return {
        "folder": str(folder),
        "files": [file.name for file in files],
        "runs": len(rows),
        "same_plans": same,
    }


def _write_solvers(folder: Path, quick: bool, say: Callable[[str], None]) -> list[Path]:
    found = bench_routing.run(prove=True, quick=quick, say=say)
    with output_file(folder / "routing.json", "--out") as place:
        place.write_text(json.dumps(found), encoding="utf-8")
    runs = [
        {key: value for key, value in row.items() if key != "curve"}
        for row in found["rows"]
    ]
    files = [folder / "routing.json", write_csv(folder / "routing_runs.csv", runs)]
    files.append(
        write_csv(
            folder / "routing.csv", [flatten_row(row) for row in found["summary"]]
        )
    )
    return files + bench_pictures.draw_routing(found["rows"], folder)


def flatten_row(row: dict[str, Any]) -> dict[str, Any]:
    """Return the row with nested figures as columns: gap_percent_median, ..."""
    plain: dict[str, Any] = {}
    for name, value in row.items():
        if isinstance(value, dict):
            plain |= {f"{name}_{inner}": figure for inner, figure in value.items()}
        else:
            plain[name] = (
                "; ".join(map(str, value)) if isinstance(value, list) else value
            )
    return plain


def table(result: dict[str, Any]) -> Text:
    """Return a text that lists the written files."""
    end = (
        "Loss changed no plan."
        if result["same_plans"]
        else "LOSS CHANGED A PLAN: see same_plan."
    )
    lines = [
        f"{result['runs']} runs in virtual time; files in {result['folder']}:",
        *result["files"],
        end,
    ]
    return Text("\n".join(lines))
