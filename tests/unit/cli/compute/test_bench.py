"""Options of the benchmarks that contradict each other."""

from typer.testing import CliRunner

from crazychoir.cli.main import app


def test_round_trips_have_no_choice_of_agents():
    said = CliRunner().invoke(
        app, ["bench", "exchange", "--round-trips", "--agents", "4"]
    )
    assert said.exit_code == 2
    assert "one of the two" in said.output
