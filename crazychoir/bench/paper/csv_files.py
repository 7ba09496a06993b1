"""Tables of a benchmark as CSV files."""

import csv
from pathlib import Path
from typing import Any

from crazychoir.files.output_files import output_file

Rows = list[dict[str, Any]]


def write_csv(path: Path, rows: Rows) -> Path:
    """Write the rows as a table with a header that has the keys of all rows."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    with (
        output_file(path, "--out") as place,
        place.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
    return path
