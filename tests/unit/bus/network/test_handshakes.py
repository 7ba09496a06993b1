"""What Zenoh says of connections that fail for a certificate, and what we make of it."""

import logging

import pytest

from crazychoir.bus.network.handshakes import ZENOH_LOG_READING, HandshakeReporter

CONNECT = "zenoh::net::runtime::orchestrator: Unable to connect to configured peer tls/10.0.0.1:7460!"
AT = "2026-11-25T02:25:06.566105Z  WARN acc-0 ThreadId(05) "
LATE = (
    AT
    + "zenoh_link_tls::unicast: certificate expired ({} seconds ago). Hint: increase the system open file limit."
)
CARGO = "at /root/.cargo/git/checkouts/zenoh/io/zenoh-links/zenoh-link-tls/src/unicast.rs:226.. Retry in 1s."
NONE = f"\x1b[2m{AT}\x1b[0m zenoh_link_tls::unicast: peer sent no certificates. Hint: increase the system open file limit."  # noqa: E501
ALERT = f"{AT} {CONNECT} received fatal alert: CertificateExpired {CARGO}"
ISSUER = (
    f"{AT} {CONNECT} Can not create a "
    f"new TLS link bound to IpAddress(V4(Ipv4Addr([10, 0, 0, 1]))): invalid peer certificate: UnknownIssuer {CARGO}"
)
ABSENT = f"{AT} {CONNECT} Connection refused (os error 111) {CARGO}"


@pytest.fixture
def said(caplog):
    caplog.set_level(logging.WARNING)
    return lambda: [record.getMessage() for record in caplog.records]


def test_a_refused_process_is_reported_once(said):
    heard = HandshakeReporter()
    for seconds in range(2):
        assert heard.line(NONE)
        assert heard.line(LATE.format(seconds))
    assert said() == [
        "a process connected and was refused: peer sent no certificates. Nothing of it was read",
        "a process connected and was refused: certificate expired (0 seconds ago). Nothing of it was read",
    ]


def test_a_refusal_by_a_peer_is_reported_once_with_its_address_and_reason(said):
    heard = HandshakeReporter()
    assert all(heard.line(text) for text in (ALERT, ISSUER, ALERT))
    where = "tls/10.0.0.1:7460 and we do not accept each other's certificate: "
    assert said() == [
        f"{where}received fatal alert: CertificateExpired. See `crazychoir doctor`",
        f"{where}invalid peer certificate: UnknownIssuer. See `crazychoir doctor`",
    ]


def test_an_absent_peer_is_not_reported(said):
    assert HandshakeReporter().line(ABSENT)
    assert said() == []


def test_what_is_not_zenoh_s_is_left(said):
    assert not HandshakeReporter().line("a mission prints")
    assert not HandshakeReporter().line("")
    assert said() == []


def test_the_number_of_reports_in_the_log_is_limited(said):
    heard = HandshakeReporter()
    for n in range(2 * ZENOH_LOG_READING.max_reports):
        heard.line(
            f"{AT} zenoh_link_tls::unicast: reason {chr(n)}{n}. Hint: increase the system open file limit."
        )
    assert len(said()) == ZENOH_LOG_READING.max_reports
