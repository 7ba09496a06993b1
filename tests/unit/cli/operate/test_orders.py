import pytest
import typer

from crazychoir.cli.operate.orders import _conclude, parse_drones


def test_drones_are_told_by_numbers_and_ranges():
    assert parse_drones(None) is None
    assert parse_drones("3, 5-7,3") == [3, 5, 6, 7]


@pytest.mark.parametrize(
    ("text", "said"), [("7-5", "5-7"), ("3,7-5", "5-7"), ("x", "3,5-7"), ("", "3,5-7")]
)
def test_what_names_no_drones_is_refused(text, said, capsys):
    with pytest.raises(typer.Exit) as ended:
        parse_drones(text)
    assert ended.value.exit_code != 0
    assert said in "".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("rows", "code"),
    [
        ({}, 1),
        ({0: {"answer": "done", "says": ""}}, 0),
        ({0: {"answer": "silent", "says": ""}}, 1),
    ],
)
def test_an_order_that_reaches_no_drone_has_failed(rows, code, capsys):
    with pytest.raises(typer.Exit) as ended:
        _conclude(rows, as_json=True)
    assert ended.value.exit_code == code
