"""What a session does with its settings and with errors of Zenoh, without a network."""

import os

import pytest
import zenoh

from crazychoir.bus.network import zenoh_session
from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.network.link_keys import LinkKeys
from crazychoir.bus.network.zenoh_session import (
    SessionEndpoints,
    ZenohSession,
    count_receivers,
)
from crazychoir.bus.topics import MessageClass
from crazychoir.errors import ConfigError

OWN_KEYS = LinkKeys("s", "a", "0-1")


class SteppingClock:
    """Goes on by a second at each look."""

    ns = 0

    def now_ns(self):
        self.ns += 1_000_000_000
        return self.ns


def make_session(reach=None):
    counters = LinkCounters()
    reach = reach or SessionEndpoints([], [])
    return ZenohSession(OWN_KEYS, reach, None, counters, SteppingClock().now_ns)


@pytest.mark.parametrize(
    "reach",
    [
        SessionEndpoints(["tcp/nowhere"], []),
        SessionEndpoints([], ["tcp/nowhere"]),
        SessionEndpoints([], [], ["tcp/nowhere"]),
    ],
)
def test_a_malformed_endpoint_is_refused_before_the_session_opens(reach):
    with pytest.raises(ConfigError, match="endpoint: found tcp/nowhere"):
        make_session(reach)


def test_a_router_replaces_all_other_endpoints():
    reach = SessionEndpoints(
        ["tcp/127.0.0.1:1"], ["tcp/127.0.0.1:2"], ["tcp/127.0.0.1:3"]
    )
    config = make_session(reach)._config
    assert config.get_json("mode") == '"client"'
    assert config.get_json("listen/endpoints") == "[]"
    assert "127.0.0.1:3" in config.get_json("connect/endpoints")
    assert "127.0.0.1:2" not in config.get_json("connect/endpoints")


@pytest.mark.parametrize(
    ("reach", "receivers"),
    [
        (SessionEndpoints([], []), 4),
        (SessionEndpoints([], [], remote_processes=30), 34),
        (SessionEndpoints([], [], remote_processes=300), 64),
        (SessionEndpoints([], [], ["tcp/10.0.0.1:1"], remote_processes=30), 5),
    ],
)
def test_receiving_threads_follow_the_links_that_may_vanish(reach, receivers):
    assert count_receivers(reach) == receivers


@pytest.mark.parametrize("chosen", [None, "(rx: (worker_threads: 3))"])
def test_a_session_leaves_the_environment_as_it_was(monkeypatch, chosen):
    monkeypatch.delenv("ZENOH_RUNTIME", raising=False)
    if chosen is not None:
        monkeypatch.setenv("ZENOH_RUNTIME", chosen)
    seen = []

    def opens(config):
        seen.append(os.environ["ZENOH_RUNTIME"])
        raise zenoh.ZError("no network")

    monkeypatch.setattr(zenoh, "open", opens)
    with pytest.raises(ConfigError):
        make_session().open(seen.append, seen.append)
    assert seen == [chosen or "(rx: (worker_threads: 4))"]
    assert os.environ.get("ZENOH_RUNTIME") == chosen


def test_the_longest_put_and_refused_frames_are_counted():
    session = make_session()
    counters = session._counters
    sent = []

    def refuses(frame):
        raise zenoh.ZError("closed")

    assert session.send(sent.append, b"frame")
    assert (sent, counters.worst_put_s) == ([b"frame"], 1.0)
    assert not session.send(refuses, b"frame")
    assert counters.put_errors == 1


async def test_a_session_that_is_not_open_sends_nothing():
    session = make_session()
    session.put("key", b"data")
    session.announce(0, "state", b"{}")
    session.declare_another_token()
    assert not session.send_frame("1-1", MessageClass.ROUNDS, b"frame")
    assert not session.has_audience("state")
    assert session.connected_programs() == []
    with pytest.raises(RuntimeError, match="not open"):
        session.make_publisher("1-1", MessageClass.ROUNDS, is_occasional=True)
    await session.close()
    assert session._counters.tokens == 0


@pytest.mark.parametrize("lists_links", [True, False])
def test_a_closed_network_warns_of_a_version_that_does_not_list_its_links(
    monkeypatch, caplog, lists_links
):
    monkeypatch.setattr(zenoh_session, "LISTS_LINKS", lists_links)
    closed_to_others = object()
    zenoh_session._report_security(closed_to_others, [])
    assert ("does not list its links" in caplog.text) == (not lists_links)
