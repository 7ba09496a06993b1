import pytest

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.dashboard.operator import PageOperator
from crazychoir.dashboard.requests import GoTo, Load, PlanTrajectory
from crazychoir.errors import ConfigError
from crazychoir.planning.minimum_snap import minimum_snap
from crazychoir.planning.trajectory_file import write_pieces


class Desk:
    """Notes what it is to command."""

    def __init__(self):
        self.told = []

    def order(self, verb, drones, words, each):
        self.told += [(verb, i, each(i)["p"]) for i in drones]


def operator_of(desk, **tables):
    drones = [{"id": i, "home": [1.0 * i, 0.0, 0.0], "leader": i < 2} for i in range(4)]
    return PageOperator(
        SwarmConfig.of({"name": "a", "drones": drones, **tables}), desk, None
    )


@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (0.3, 0.0, 0.0), (0.1, 0.1, 0.3)])
def test_several_drones_are_not_sent_to_places_that_are_too_near_to_each_other(offset):
    desk = Desk()
    for drones in ((2, 3), (0, 1)):
        with pytest.raises(
            ConfigError, match=r"offset: .*0\.32 m aside, or 0\.6 m above"
        ):
            operator_of(desk).asked(GoTo(drones, (0.0, 0.0, 1.0), offset=offset))
    assert desk.told == []
    operator_of(desk).asked(GoTo((2, 2), (0.0, 0.0, 1.0), offset=offset))
    assert desk.told == [("go-to", 2, [0.0, 0.0, 1.0])]
    operator_of(desk, collision={"method": "off"}).asked(
        GoTo((2, 3), (0.0, 0.0, 1.0), offset=offset)
    )
    assert len(desk.told) == 3


def test_several_drones_are_sent_beside_each_other():
    desk = Desk()
    operator_of(desk).asked(GoTo((2, 3), (0.0, 0.0, 1.0), offset=(0.0, 0.5, 0.0)))
    assert desk.told == [("go-to", 2, [0.0, 0.0, 1.0]), ("go-to", 3, [0.0, 0.5, 1.0])]


async def test_the_page_loads_a_trajectory_and_plans_it_at_a_height(tmp_path):
    file = tmp_path / "line.csv"
    write_pieces(file, minimum_snap([[0, 0, 0], [1, 0, 0]], [0.0, 4.0]))
    operator = operator_of(Desk())
    loaded = await operator.asked(Load("line.csv", file.read_text()))()
    text = loaded["trajectory"]["text"]
    assert loaded["trajectory"]["height"] == 0.0
    planned = await operator.asked(PlanTrajectory("line.csv", text, 1.2, 2.0))()
    assert planned["plan"]["duration"] == pytest.approx(8.0)
    assert planned["plan"]["points"][0] == pytest.approx([0.0, 0.0, 1.2])
    with pytest.raises(ConfigError, match=r"line.csv, line 2"):
        await operator.asked(Load("line.csv", text.replace("\n4.0,", "\nfour,")))()
