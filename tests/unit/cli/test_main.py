import typer
from typer.testing import CliRunner

from crazychoir.cli.main import CommandGroup, app

GROUPS = [str(group) for group in CommandGroup]
TOP = typer.main.get_command(app)


def test_run_stands_first():
    name, command = next(iter(TOP.commands.items()))
    assert name == "run"
    assert command.rich_help_panel == GROUPS[0] == "Fly"


def test_every_command_has_a_group():
    groups = {name: command.rich_help_panel for name, command in TOP.commands.items()}
    assert {name for name, group in groups.items() if group not in GROUPS} == set()
    assert set(groups.values()) == set(GROUPS)


def test_help_shows_the_groups_in_the_order_of_a_users_work():
    shown = CliRunner().invoke(app, ["--help"]).output
    places = [shown.index(f" {group} ") for group in GROUPS]
    assert places == sorted(places)


def test_the_first_paragraph_of_each_help_is_one_line():
    for name, command in TOP.commands.items():
        first = (command.help or "").partition("\n\n")[0]
        assert "\n" not in first.strip(), name
        assert first.endswith("."), name
