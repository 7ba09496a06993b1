"""A team of rounds in a plain loop: no clock, no network, every message through the codec."""

from crazychoir.bus.codec import decode, encode
from crazychoir.errors import CrazyChoirError
from crazychoir.types import PerNeighbor


def run_team(agents, graph, most=2000):
    """Run to the end; returns the number of rounds. All must end, or fail, in the same round.

    The first error is raised.  graph: a Graph or a GraphSequence, of the ids of `agents`.
    """
    for k in range(most):
        if all(agent.done for agent in agents.values()):
            return k
        assert not any(agent.done for agent in agents.values()), (
            f"round {k}: some have ended"
        )
        messages = {i: agent.message() for i, agent in agents.items()}
        errors = {}
        for i, agent in agents.items():
            try:
                agent.step(
                    {
                        j: decode(encode(_for(i, messages[j])))
                        for j in graph.at(k).in_neighbors(i)
                    }
                )
            except CrazyChoirError as error:
                errors[i] = error
        if errors:
            assert len(errors) == len(agents), (
                f"round {k}: only {sorted(errors)} failed: {errors}"
            )
            raise errors[min(errors)]
    raise AssertionError(f"no end in {most} rounds")


def _for(i, message):
    return message[i] if isinstance(message, PerNeighbor) else message
