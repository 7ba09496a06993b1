import pytest

from crazychoir.bus.zenoh import _speaker


def test_who_speaks_is_read_where_access_control_looks():
    assert _speaker("choir/s/f/0-1/b/1-2/control") == ("b", "1-2")


@pytest.mark.parametrize(
    "key", ["choir/s/f/0-1/b/a/0-2/control", "choir/s/f/0-1/b/1-2", "choir/s/f/0-1/b/x/a/0-2/control"]
)
def test_a_key_of_more_or_fewer_parts_is_nobody_s(key):
    assert _speaker(key) == ("", "")
