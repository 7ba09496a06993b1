"""What a formation with leaders needs beside the law of its followers."""

from typing import Generic, TypeVar

from crazychoir.config.shared_values import share
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.formation import leader
from crazychoir.guidance.formation.leader import Leader, LeaderOptions
from crazychoir.guidance.mission_options import HeightOption, given
from crazychoir.guidance.mission_pictures import draw_tracks
from crazychoir.guidance.mission_report import Results

Options = TypeVar("Options", bound=LeaderOptions)
"""The table of [mission_options]."""


class Follower(CFDistributedFeedback):
    """A law that takes off to the height in the options of its drone.

    So it may start outside the plane of its formation.
    """

    def height(self) -> float | None:
        """Return the height in the drone's options; None: that of the swarm file."""
        return leader.height_of(self.member.config, self.id)


class FormationHooks(Generic[Options]):
    """The hooks of a formation in which leaders stand still or fly a path.

    options: the table of [mission_options].
    """

    drone_options = HeightOption
    """The table of the `options` of a drone."""

    def __init__(self, options: type[Options]) -> None:
        self.options = options

    def given(self, config: SwarmConfig) -> Options:
        """Return [mission_options]. Raises ConfigError with the key that is wrong."""
        return given(config, self.options)

    def leader(self, i: int, config: SwarmConfig) -> Leader:
        """Return the law of leader i."""
        return leader.leader_of(i, config, self.given(config))

    def duration(self, config: SwarmConfig) -> float:
        """Return the duration of the law in s."""
        return leader.duration_of(config, self.given(config))

    def check(self, config: SwarmConfig, force: bool = False) -> list[str]:
        """Check that all drones hover in the fence, and that the leaders can fly their path.

        Raises ConfigError if not.
        """
        leader.require_flyable(config, self.given(config))
        return []

    def picture(self, config: SwarmConfig, results: Results, path: str) -> None:
        """Draw the flown paths from above."""
        draw_tracks(
            results,
            path,
            leaders=list(leader.leaders_of(config)),
            edges=config.graph().edges(),
        )


def list_neighbors(config: SwarmConfig) -> dict[int, tuple[int, ...]]:
    """Return the ids that each drone hears, the same dictionary for all drones."""
    return share(config, _list_in_neighbors)


def _list_in_neighbors(config: SwarmConfig) -> dict[int, tuple[int, ...]]:
    graph = config.graph()
    return {i: graph.in_neighbors(i) for i in graph.ids}
