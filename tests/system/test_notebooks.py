"""The notebooks of the Python interface run from top to bottom, without a person."""

import pathlib

import nbformat
import pytest
from nbclient import NotebookClient

REPOSITORY = pathlib.Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((REPOSITORY / "crazychoir" / "api" / "notebooks").glob("*.ipynb"))
SHORTENED = {
    "SEEDS = range(1, 21)": "SEEDS = range(1, 3)",
    "LOSSES = [0.0, 0.2, 0.4, 0.6, 0.8]": "LOSSES = [0.0, 0.4]",
    'LAWS = ["paper", "normalised"]': 'LAWS = ["normalised"]',
}
"""Lines of the sweep that a test replaces by shorter ones."""
PICTURE_COUNTS = {"first_flight": 2, "loss_sweep": 2, "own_algorithm": 2}
"""Pictures that each notebook shows."""
LAST_VALUES = {
    "first_flight": "(True, True, True)",
    "own_algorithm": "(array([0.5, 0.2]), True)",
}
"""Beginning of the value of the last cell."""

pytestmark = [
    pytest.mark.system,
    # The kernel's own packages are older than the newest Python; what they warn of is not ours.
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning"),
]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_and_shows_its_pictures(path, tmp_path):
    book = nbformat.read(path, as_version=4)
    for cell in book.cells:
        for line, shorter in SHORTENED.items():
            cell.source = cell.source.replace(line, shorter)
    folder = {"metadata": {"path": str(tmp_path)}}
    NotebookClient(book, timeout=100, resources=folder).execute()
    outputs = [out for cell in book.cells for out in cell.get("outputs", [])]
    shown = [out["data"] for out in outputs if "data" in out]
    assert sum("image/png" in data for data in shown) == PICTURE_COUNTS[path.stem]
    last = shown[-1].get("text/plain", "")
    assert last.startswith(LAST_VALUES.get(path.stem, ""))
    if path.stem == "loss_sweep":
        assert len((tmp_path / "loss_sweep.csv").read_text().splitlines()) == 1 + 4
        assert (tmp_path / "loss_sweep.parquet").is_file()
        assert (tmp_path / "loss_sweep.pdf").read_bytes().startswith(b"%PDF")


def test_each_notebook_is_known_and_each_shortened_line_is_there():
    assert {path.stem for path in NOTEBOOKS} == PICTURE_COUNTS.keys()
    text = "".join(
        cell.source
        for path in NOTEBOOKS
        for cell in nbformat.read(path, as_version=4).cells
    )
    assert [line for line in SHORTENED if line not in text] == []


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_without_outputs(path):
    cells = nbformat.read(path, as_version=4).cells
    assert [cell.id for cell in cells if cell.get("outputs")] == []
