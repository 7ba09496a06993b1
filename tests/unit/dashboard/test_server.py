import pytest

pytest.importorskip("nicegui", reason="the page needs: pip install 'crazychoir[dashboard]'")

from crazychoir.dashboard.server import Served

PASSWORD = "correct horse"  # noqa: S105 - of a test
LOCAL = ("localhost", "127.0.0.1", "[::1]")


def named(port, *names):
    return tuple(f"{name}:{port}" for name in names)


@pytest.mark.parametrize(
    ("host", "port", "hosts"),
    [("127.0.0.1", 8765, named(8765, *LOCAL)), ("::1", 8765, named(8765, *LOCAL)),
     ("127.0.0.2", 8765, named(8765, *LOCAL, "127.0.0.2")), ("127.0.0.1", 443, named(443, *LOCAL)),
     ("127.0.0.2", 80, (*named(80, *LOCAL, "127.0.0.2"), *LOCAL, "127.0.0.2")), ("0.0.0.0", 80, None)],  # noqa: S104
)  # fmt: skip
def test_a_page_may_be_called_as_it_is_served_and_without_the_port_that_browsers_leave_out(host, port, hosts):
    assert Served(host, password=PASSWORD).hosts(port) == hosts


def test_a_page_with_a_certificate_has_another_port_that_is_left_out(tmp_path):
    for name in ("a.pem", "b.pem"):
        (tmp_path / name).touch()
    served = Served(certificate=tmp_path / "a.pem", key=tmp_path / "b.pem")
    assert served.hosts(443) == (*named(443, *LOCAL), *LOCAL)
    assert served.hosts(80) == named(80, *LOCAL)
