"""Numbers on the command lines: every option of every program has limits, and names itself when it refuses."""

import importlib
import math

import pytest
import typer
from typer.testing import CliRunner

from crazychoir.errors import ConfigError
from crazychoir.launch import number_options as options
from crazychoir.launch.number_options import (
    RealNumber,
    WholeNumber,
    parse_finite_numbers,
)

PROGRAMS = (
    "main",
    "fly.agent",
    "fly.mocap",
    "fly.radio_owner",
    "fly.world",
    "compute.bench",
)
COMMANDS = {
    program: typer.main.get_command(
        importlib.import_module(f"crazychoir.cli.{program}").app
    )
    for program in PROGRAMS
}
NEVER = ("nan", "inf", "-inf", "1e400", "x", "")


def commands():
    """(program, words of the command, command) of every command of every program."""
    for program in PROGRAMS:
        yield from walk(program, (), COMMANDS[program])


def walk(program, words, command):
    yield program, words, command
    for name, below in getattr(command, "commands", {}).items():
        yield from walk(program, (*words, name), below)


def numeric_options():
    """Return (program, words, option, reader) of every option that takes a number."""
    found = []
    for program, words, command in commands():
        for param in command.params:
            reader = reader_of(param)
            if isinstance(reader, RealNumber | WholeNumber):
                found.append((program, words, param.opts[0], reader))
    return found


def reader_of(param):
    """What reads the value of an option; None for arguments, and for options that Typer itself reads."""
    described = getattr(param, "type_descriptor", None)
    return None if described is None else described.parameter_info.parser


NUMERIC = numeric_options()
IDS = [" ".join((program, *words, option)) for program, words, option, _ in NUMERIC]


def refused(program, words, option, value):
    with pytest.raises(typer.BadParameter) as error:
        COMMANDS[program].main([*words, f"{option}={value}"], standalone_mode=False)
    return error.value.format_message()


def test_no_option_takes_numbers_without_limits_of_its_own():
    assert len(NUMERIC) > 60
    for program, words, command in commands():
        for param in command.params:
            kind = getattr(getattr(param, "type_descriptor", None), "annotation", None)
            if kind in (int, float, list[int], list[float]) and param.opts[
                0
            ].startswith("-"):
                assert reader_of(param) is not None, (program, words, param.opts[0])


@pytest.mark.parametrize(("program", "words", "option", "reader"), NUMERIC, ids=IDS)
def test_every_numeric_option_refuses_what_is_no_number_of_its_and_names_itself(
    program, words, option, reader
):
    values = list(NEVER)
    if reader.least > -math.inf:
        values.append(repr(reader.least - 1))
    if reader.most < math.inf:
        values.append(repr(reader.most * 2))
    for value in values:
        said = refused(program, words, option, value)
        assert f"Invalid value for '{option}'" in said
        assert "allowed: a" in said


@pytest.mark.parametrize(
    ("reader", "text", "do"),
    [
        (RealNumber(0.0, 1.0, unit="share"), "30", "30 % is 0.3."),
        (RealNumber(0.0, 1.0, unit="share"), "30%", "30 % is 0.3."),
        (RealNumber(0.0, 1.0, unit="share"), "2.5 %", "2.5 % is 0.025."),
        (RealNumber(0.0, 1.0, unit="share"), "0,3", "Write 0.3."),
        (RealNumber(0.0, 1.0, unit="share"), "101", "allowed: a probability, 0 to 1."),
        (RealNumber(0.0, 1.0, unit="share"), "-0.1", "allowed: a probability, 0 to 1."),
        (RealNumber(0.0, 60.0, unit="s"), "500ms", "Write 0.5."),
        (RealNumber(0.0, 60.0, unit="s"), "2 min", "Write 120."),
        (RealNumber(0.0, 60.0, True, "s"), "0", "above 0, at most 60"),
        (RealNumber(2.0), "1", "2 or more"),
        (RealNumber(most=2.0), "3", "at most 2"),
        (RealNumber(), "nan", "allowed: a finite number."),
        (WholeNumber(1, 9), "3.0", "Write 3."),
        (WholeNumber(1, 9), "1e3", "Write 1000."),
        (WholeNumber(1, 9), "10", "a whole number, 1 to 9."),
        (WholeNumber(1, 9), "9" * 5000, "a whole number, 1 to 9."),
        (WholeNumber(1, 9), "0x5", "a whole number, 1 to 9."),
    ],
    ids=str,
)
def test_a_refusal_says_what_was_probably_meant(reader, text, do):
    with pytest.raises(typer.BadParameter) as error:
        reader(text)
    assert do in str(error.value)
    assert len(str(error.value)) < 300


@pytest.mark.parametrize(
    ("reader", "text", "value"),
    [
        (RealNumber(0.0, 1.0), "1e-1", 0.1),
        (RealNumber(0.0, 1.0), ".5", 0.5),
        (RealNumber(0.0, 1.0), "1", 1.0),
        (RealNumber(), "-3", -3.0),
        (RealNumber(0.0, 1.0), 0.25, 0.25),
        (WholeNumber(0, 9), "007", 7),
        (WholeNumber(0, 9), 3, 3),
        (WholeNumber(0, 9), "+3", 3),
    ],
    ids=str,
)
def test_a_number_is_taken_however_it_is_written(reader, text, value):
    assert reader(text) == value


@pytest.mark.parametrize("text", ["", "a", "1,,2", "1,nan", "inf", "1;2", "1,2,3,4"])
def test_lists_of_numbers_are_finite_and_as_long_as_they_must_be(text):
    with pytest.raises(ConfigError, match="PLACE: found"):
        parse_finite_numbers(text, "PLACE", "three numbers", 3)
    assert parse_finite_numbers(" (1, 2,3) ", "PLACE", "three numbers", 3) == [
        1.0,
        2.0,
        3.0,
    ]


@pytest.mark.parametrize(
    "graph", ["rink", "erdos-renyi:1.5", "grid:3x3", "k-regular:x"]
)
def test_a_graph_that_cannot_be_names_its_option(graph):
    with pytest.raises(ConfigError) as error:
        options.build_named_graph(graph, 4, 0)
    assert str(error.value).startswith("--graph: found")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["land", "--drones", "0-99999999"], "--drones: found 0-99999999"),
        (["stop", "--drones", "5-3"], "--drones: found 5-3"),
        (["go-to", "1,nan,1", "--drones", "0"], "PLACE: found 1,nan,1"),
        (
            ["go-to", "1,1,1", "--offset", "0,inf,0", "--drones", "0"],
            "--offset: found 0,inf,0",
        ),
        (["impair", "--edge", "1"], "--edge: found 1"),
        (["impair", "--edge", "1,1"], "--edge: found 1,1"),
        (["impair", "--burst", "3"], "--burst: found 3 with no --loss"),
        (["task", "add", "--pickup", "1,nan"], "--pickup: found 1,nan"),
        (
            ["task", "add", "--pickup", "1,2", "--robots", "0-999999999"],
            "--robots: found 0-999999999",
        ),
        (["param", "set", "control.kp", "nan"], "VALUE: found nan"),
        (["param", "set", "control.kp", "[[1]]x"], "VALUE: found [[1]]x"),
        (
            ["radio", "survey", "--simulated", "1", "--channels", "0-999999999"],
            "--channels: found 0-999999999",
        ),
        (["virtual", "--drones", "2", "--dongles", "0,0"], "--dongles: found 0,0"),
        (["virtual", "--drones", "2", "--dongles", "0|0"], "--dongles: found 0|0"),
        (
            ["virtual", "--drones", "2", "--dongles", "0-999999999"],
            "--dongles: found 0-999999999",
        ),
        (["virtual", "fault", "0", "loss=nan"], "fault loss: found nan"),
    ],
    ids=" ".join,
)
def test_lists_on_the_command_line_name_their_option(words, said):
    from crazychoir.cli.main import app

    result = CliRunner().invoke(app, words, env={"COLUMNS": "400"})
    assert result.exit_code == 2
    assert said in " ".join(result.output.split())
