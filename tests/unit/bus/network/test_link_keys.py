"""The keys of a process, and what the keys of others tell."""

import pytest

from crazychoir.bus.network.link_keys import LinkKeys, read_sender, read_token
from crazychoir.bus.topics import MessageClass
from crazychoir.errors import ConfigError

OWN_KEYS = LinkKeys("s", "a", "0-1")


def test_a_frame_names_its_receiver_its_sender_and_its_class():
    key = OWN_KEYS.frame_to("1-2", MessageClass.CONTROL)
    assert key == "choir/s/f/1-2/a/0-1/control"
    assert read_sender(key) == ("a", "0-1")


def test_a_token_names_its_process():
    key = OWN_KEYS.own_token
    assert key == "choir/s/live/a/0-1"
    assert read_token(key) == ("a", "0-1")
    assert read_token(f"{key}/7") == ("a", "0-1")


def test_the_sender_is_read_from_the_part_of_the_key_that_access_control_checks():
    assert read_sender("choir/s/f/0-1/b/1-2/control") == ("b", "1-2")


@pytest.mark.parametrize(
    "key",
    [
        "choir/s/f/0-1/b/a/0-2/control",
        "choir/s/f/0-1/b/1-2",
        "choir/s/f/0-1/b/x/a/0-2/control",
    ],
)
def test_a_key_with_more_or_fewer_parts_has_no_sender(key):
    assert read_sender(key) == ("", "")


@pytest.mark.parametrize(
    ("names", "where"),
    [
        (("s/t", "a", "0-1"), "swarm"),
        (("s", "*", "0-1"), "host"),
        (("s", "a", ""), "process"),
    ],
)
def test_names_with_a_meaning_in_keys_are_refused(names, where):
    with pytest.raises(ConfigError, match=f"name of the {where}"):
        LinkKeys(*names)
