"""What a session does with its settings and with errors of Zenoh, without a network."""

import pytest
import zenoh

from crazychoir.bus.network.link_counters import LinkCounters
from crazychoir.bus.network.link_keys import LinkKeys
from crazychoir.bus.network.zenoh_session import SessionEndpoints, ZenohSession
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
        session.declare_publisher("1-1", MessageClass.ROUNDS)
    await session.close()
    assert session._counters.tokens == 0
