"""Tables of runs: medians and quartiles, files, figures."""

import csv

import pytest

from crazychoir.api.table import Table
from crazychoir.api.table_picture import write_label
from crazychoir.errors import ConfigError

VALUES = {0.0: [1.0, 2.0, 3.0, 4.0, None], 0.4: [10.0, None, None, None, None]}
ROWS = [
    {
        "loss": loss,
        "seed": seed,
        "success": value is not None,
        "reason": None if value is not None else "late",
        "drones": 4,
        "settling_s": value,
        "digest": f"{loss}-{seed}",
    }
    for loss, values in VALUES.items()
    for seed, value in enumerate(values)
]


@pytest.fixture
def table():
    return Table(ROWS, ["loss", "seed"])


def test_a_summary_has_medians_and_quartiles_of_the_runs_that_have_the_figure(table):
    first, second = table.summary().rows
    assert first == {
        "loss": 0.0,
        "runs": 5,
        "succeeded": 4,
        "settling_s_q1": 1.75,
        "settling_s_median": 2.5,
        "settling_s_q3": 3.25,
    }
    assert (second["runs"], second["succeeded"]) == (5, 1)
    assert second["settling_s_median"] == 10.0


def test_a_summary_is_taken_by_any_column(table):
    assert len(table.summary(by="seed")) == 5
    assert len(table.summary(by=["loss", "seed"])) == 10
    (whole,) = table.summary(by=[]).rows
    assert whole["settling_s_median"] == 3.0


def test_numbers_of_flights_are_the_figures(table):
    assert table.figures == ["settling_s"]
    assert table.column("loss")[:2] == [0.0, 0.0]


def test_a_row_without_a_figure_has_none():
    table = Table([{"a": 1}, {"b": 2.0}], [])
    assert table.rows == [{"a": 1, "b": None}, {"a": None, "b": 2.0}]


def test_an_unknown_column_is_refused(table):
    for call in (table.column, table.summary, table.plot):
        with pytest.raises(ConfigError, match=r"column: found mass; allowed: loss"):
            call("mass")
    with pytest.raises(ConfigError, match="no numbers of digest"):
        table.plot("digest")


def test_a_csv_file_has_the_rows(table, tmp_path):
    table.to_csv(tmp_path / "a.csv")
    with (tmp_path / "a.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 10
    assert rows[1]["settling_s"] == "2.0"
    assert (rows[4]["settling_s"], rows[4]["reason"]) == ("", "late")


def test_frames_and_parquet_files_have_the_rows(table, tmp_path):
    pandas = pytest.importorskip("pandas")
    table.to_parquet(tmp_path / "a.parquet")
    again = pandas.read_parquet(tmp_path / "a.parquet")
    assert again["digest"].tolist() == table.column("digest")
    assert table.frame()["settling_s"].median() == 3.0


@pytest.mark.parametrize("module", ["pandas", "pyarrow"])
def test_a_missing_package_is_named_with_its_command(table, monkeypatch, module):
    monkeypatch.setitem(__import__("sys").modules, module, None)
    call = table.frame if module == "pandas" else lambda: table.to_parquet("a.parquet")
    with pytest.raises(ConfigError, match=rf"{module}.*pip install 'crazychoir\[tabl"):
        call()


def test_the_figure_has_the_medians(table):
    (axes,) = table.plot("settling_s").axes
    (line,) = axes.lines
    assert line.get_xydata().tolist() == [[0.0, 2.5], [0.4, 10.0]]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("loss", "settling [s]")
    figure = table.plot("settling_s", x="seed", by="loss")
    assert len(figure.axes[0].lines) == 2
    assert [text.get_text() for text in figure.legends[0].texts] == [
        "loss 0.0",
        "loss 0.4",
    ]


def test_labels_have_units():
    assert write_label("min_separation_m") == "min separation [m]"
    assert write_label("speed_m_s") == "speed [m/s]"
    assert write_label("rounds") == "rounds"


def test_a_notebook_shows_the_first_rows(table):
    many = Table(ROWS * 2, ["loss", "seed"])
    assert table._repr_html_().count("<tr>") == 11
    assert "and 10 more rows" in many._repr_html_()
    assert "10 rows" in repr(table)
