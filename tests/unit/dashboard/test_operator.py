import pytest

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.dashboard.operator import PageOperator
from crazychoir.dashboard.requests import GoTo
from crazychoir.errors import ConfigError


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
