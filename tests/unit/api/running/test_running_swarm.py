"""The end of a running swarm that a program has started, also after a failure."""

from contextlib import asynccontextmanager

import pytest

from crazychoir.api import connecting
from crazychoir.api.running.blocking import LoopThread
from crazychoir.api.running.running_swarm import RunningSwarm
from crazychoir.errors import ProcessFailed


class FailingSwarm:
    """A swarm that gets neither ready nor accepts that it lands, and the run that it flies in."""

    ids = (0, 1)
    said = {"reason": None, "reasons": {"1": "drone 1: the cameras do not see it"}}  # noqa: RUF012
    file = "swarm.json"

    def __init__(self, lands, ends_early=False):
        self.lands = lands
        self.ends_early = ends_early
        self.is_left = False
        self.is_ended = False

    @asynccontextmanager
    async def join(self, file=None, console=False):
        yield self
        self.is_left = True

    async def wait_until_ready(self, has_ended):
        if not has_ended():
            raise TimeoutError("not ready")

    async def begin_landing(self):
        if not self.lands:
            raise ConnectionError("no network")

    def has_ended(self):
        return self.ends_early

    def end(self):
        self.is_ended = True
        return {"success": False, **self.said}


def test_run_ends_although_its_landing_fails():
    failing = FailingSwarm(lands=False)
    swarm = RunningSwarm(LoopThread(failing.join), failing)
    with pytest.raises(ConnectionError, match="no network"):
        swarm.close()
    assert failing.is_left
    assert failing.is_ended
    assert swarm.result["success"] is False


def test_launched_run_that_does_not_get_ready_is_ended(monkeypatch):
    failing = FailingSwarm(lands=True)
    monkeypatch.setattr(connecting, "SwarmRun", lambda *told: failing)
    monkeypatch.setattr(connecting, "join_swarm", failing.join)
    with pytest.raises(TimeoutError, match="not ready"):
        connecting.launch("operator", drones=2)
    assert failing.is_left
    assert failing.is_ended


@pytest.mark.parametrize(
    "said",
    [FailingSwarm.said, {"error": "the cameras do not see it", "kind": "ConfigError"}],
    ids=["reasons", "error"],
)
def test_launched_run_that_ends_before_it_is_ready_says_why(monkeypatch, said):
    refused = FailingSwarm(lands=True, ends_early=True)
    refused.said = said
    monkeypatch.setattr(connecting, "SwarmRun", lambda *told: refused)
    monkeypatch.setattr(connecting, "join_swarm", refused.join)
    with pytest.raises(ProcessFailed, match="the cameras do not see it"):
        connecting.launch("operator", drones=2)
    assert refused.is_left
    assert refused.is_ended
