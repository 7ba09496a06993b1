"""What `crazychoir param` prints for drones with different parameters."""

import io
import itertools
import json

import pytest
import typer
from rich.console import Console

from crazychoir.cli.operate import param

TRIM = {"trim.thrust": 1.0, "platform.name": "cf21", "platform.mass": 0.03}
GAINS = {"control.kp": [6.0, 6.0, 10.0], "control.kr": [8.0, 8.0, 4.0]}
KINDS = {
    "gains": {**GAINS, **TRIM},
    "none": TRIM,
    "nothing": {},
    "robot": {"robot.v": 0.5, "trim.thrust": 1.0},
}


def rows(answers):
    """{parameter: the cells of the drones}."""
    text = io.StringIO()
    Console(file=text, width=200).print(param._table(answers))
    lines = [
        line.strip().strip("│┃") for line in text.getvalue().splitlines() if "│" in line
    ]
    cells = [[cell.strip() for cell in line.split("│")] for line in lines]
    return {name: row for name, *row in cells}


@pytest.mark.parametrize("kinds", list(itertools.permutations(KINDS, 3)), ids="-".join)
def test_a_drone_without_a_parameter_has_an_empty_cell_whichever_comes_first(kinds):
    said = {i: KINDS[kind] for i, kind in enumerate(kinds)}
    found = rows({i: (True, values) for i, values in said.items()})
    assert set(found) == {name for values in said.values() for name in values}
    for name, cells in found.items():
        assert cells == [
            param._format_parameter(values[name]) if name in values else ""
            for values in said.values()
        ]


def test_parameters_keep_their_order():
    found = rows({0: (True, KINDS["none"]), 1: (True, KINDS["gains"])})
    assert list(found) == list(KINDS["gains"])


def test_a_drone_that_refuses_has_no_column_and_says_why(capsys):
    found = rows(
        {0: (True, TRIM), 1: (False, "refused: it is starting"), 2: (True, {})}
    )
    assert found["platform.mass"] == ["0.03", ""]
    assert "drone 1: refused: it is starting" in capsys.readouterr().err


def test_json_has_the_parameters_of_each_drone(capsys):
    with pytest.raises(typer.Exit) as ended:
        param._conclude(
            {0: (True, KINDS["gains"]), 1: (True, KINDS["none"])}, as_json=True
        )
    assert ended.value.exit_code == 0
    assert json.loads(capsys.readouterr().out) == {
        "0": KINDS["gains"],
        "1": KINDS["none"],
    }


def test_no_answer_at_all_is_an_empty_table():
    assert rows({}) == {}
