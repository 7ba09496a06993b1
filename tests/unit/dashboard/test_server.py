import pytest

pytest.importorskip(
    "nicegui", reason="the page needs: pip install 'crazychoir[dashboard]'"
)

import trustme

from crazychoir.dashboard.server import PageAddress
from crazychoir.errors import ConfigError

PASSWORD = "correct horse"  # noqa: S105 - of a test
LOCAL = ("localhost", "127.0.0.1", "[::1]")


def named(port, *names):
    return tuple(f"{name}:{port}" for name in names)


@pytest.mark.parametrize(
    ("host", "port", "hosts"),
    [
        ("127.0.0.1", 8765, named(8765, *LOCAL)),
        ("::1", 8765, named(8765, *LOCAL)),
        ("127.0.0.2", 8765, named(8765, *LOCAL, "127.0.0.2")),
        ("127.0.0.1", 443, named(443, *LOCAL)),
        ("127.0.0.2", 80, (*named(80, *LOCAL, "127.0.0.2"), *LOCAL, "127.0.0.2")),
        ("0.0.0.0", 80, None),  # noqa: S104
    ],
)
def test_a_page_may_be_called_as_it_is_served_and_without_the_port_that_browsers_leave_out(
    host, port, hosts
):
    assert PageAddress(host, password=PASSWORD).hosts(port) == hosts


@pytest.fixture(scope="module")
def pem(tmp_path_factory):
    """Files of a certificate, of its key, of another key, of its authority, of none of these."""
    folder, authority = tmp_path_factory.mktemp("pem"), trustme.CA()
    mine, other = authority.issue_cert("localhost"), authority.issue_cert("localhost")
    files = {
        name: folder / f"{name}.pem"
        for name in ("certificate", "key", "other", "authority", "text")
    }
    mine.cert_chain_pems[0].write_to_path(files["certificate"])
    mine.private_key_pem.write_to_path(files["key"])
    other.private_key_pem.write_to_path(files["other"])
    authority.cert_pem.write_to_path(files["authority"])
    files["text"].write_text("no certificate")
    return files


def test_a_page_with_a_certificate_has_another_port_that_is_left_out(pem):
    served = PageAddress(certificate=pem["certificate"], key=pem["key"])
    assert served.hosts(443) == (*named(443, *LOCAL), *LOCAL)
    assert served.hosts(80) == named(80, *LOCAL)


@pytest.mark.parametrize(
    "credentials", [{"password": PASSWORD}, {"authority": "authority"}]
)
def test_other_machines_come_in_with_a_password_or_a_certificate(pem, credentials):
    tls = {"certificate": pem["certificate"], "key": pem["key"]}
    served = PageAddress(
        "0.0.0.0",  # noqa: S104
        **tls,
        **{name: pem.get(found, found) for name, found in credentials.items()},
    )
    assert served.hosts(8765) is None


@pytest.mark.parametrize(
    ("host", "files", "said"),
    [
        ("0.0.0.0", {}, "--host: found 0.0.0.0; allowed: a password or an authority"),  # noqa: S104
        (
            "localhost",
            {"certificate": "certificate"},
            "--certificate: found without --key",
        ),
        (
            "localhost",
            {"authority": "authority"},
            "--authority: found no --certificate and no --key",
        ),
        (
            "localhost",
            {"certificate": "certificate", "key": "other"},
            "key values mismatch; a PEM certificate",
        ),
        (
            "localhost",
            {"certificate": "text", "key": "key"},
            "a PEM certificate and its own key",
        ),
        ("localhost", {"certificate": "certificate", "key": "missing"}, "No such file"),
        (
            "0.0.0.0",  # noqa: S104
            {"certificate": "certificate", "key": "key", "authority": "text"},
            "no certificate or crl found",
        ),
    ],
)
def test_settings_that_would_admit_no_visitor_are_refused_before_serving(
    pem, host, files, said
):
    with pytest.raises(ConfigError) as raised:
        PageAddress(
            host,
            **{
                name: pem.get(file, pem["text"].with_name(file))
                for name, file in files.items()
            },
        )
    assert said in str(raised.value)
