"""The decision on the HELLO of another process."""

from typing import Any

import pytest
from link_parts import make_hello

from crazychoir.bus.network.hello import Hello
from crazychoir.bus.network.hello_review import (
    COPY_FILE_ADVICE,
    HelloReview,
    Introduction,
    describe_address,
)
from crazychoir.bus.port import PORT_ADDRESSES, Bus
from crazychoir.runtime.clock import Clock

BODY = PORT_ADDRESSES.body_offset
CAMERA = PORT_ADDRESSES.camera_offset


def hello(**changes: Any) -> Hello:
    """Return the HELLO of process b with drone 1."""
    return make_hello(
        **{"process": "b", "host": "there", "hears_receiver": True, **changes}
    )


class StoppedClock(Clock):
    """Stands still."""

    def now_ns(self) -> int:
        return 0


def review(*ports: int, **agreed: str) -> HelloReview:
    bus = Bus(StoppedClock(), process="a", host="here")
    for address in ports:
        bus.port(address)
    return HelloReview(bus, Introduction("s", 1, "1", agreed))


@pytest.mark.parametrize(
    ("ports", "changes", "reason"),
    [
        ((1,), {}, "flies drone(s) 1 too and has done so for 2.0 s"),
        (
            (CAMERA + 3,),
            {"observers": [CAMERA + 3]},
            "the motion capture of drone(s) 3",
        ),
        ((BODY + 3,), {"observers": [BODY + 3]}, "owns the world of drone(s) 3"),
        ((0,), {"version": "2"}, "runs version 2, this one runs 1"),
    ],
)
def test_a_process_that_excludes_this_one_is_refused(ports, changes, reason):
    found, _ = review(*ports).find_refusal(hello(**changes), 2.0)
    assert found.startswith("process b on host there ")
    assert reason in found


def test_owners_must_have_the_same_swarm_file():
    other = hello(observers=[BODY + 1], agreed={"plant": "cd"})
    assert review(0, plant="ab").find_refusal(other, 2.0) == (
        "process b on host there has another swarm file than this process, with another plant",
        COPY_FILE_ADVICE,
    )
    assert review(0, plant="cd").find_refusal(other, 2.0) == ("", "")


def test_agents_may_differ_in_the_keys_of_owners():
    assert review(0, plant="ab").find_refusal(hello(agreed={"plant": "cd"}), 2.0) == (
        "",
        "",
    )


def test_an_address_is_described_in_words():
    assert describe_address(4) == "drone 4"
    assert describe_address(BODY + 4) == "the body of drone 4"
    assert describe_address(CAMERA + 4) == "what cameras see of drone 4"
