import asyncio

import pytest
from virtual_time import virtual

from crazychoir.dashboard.access import (
    LOGIN_LIMITS,
    PAGE_REQUEST_RULES,
    PAGE_SESSION,
    AccessGate,
    network_of,
)

PASSWORD = "correct horse"  # noqa: S105 - of a test
HOST = "127.0.0.1:8765"
ORIGIN = f"http://{HOST}"


async def read_all(scope, receive, send):
    """An application that reads whatever comes, and says so."""
    if scope["type"] == "websocket":
        await send({"type": "websocket.accept"})
        return
    more = True
    while more:
        more = (await receive()).get("more_body", False)
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b"in"})


class Visitor:
    def __init__(self, clock, **options):
        self.gate = AccessGate(read_all, clock, **{"hosts": (HOST,), **options})
        self.cookie = ""

    async def come(
        self,
        method="GET",
        path="/",
        host=HOST,
        origin=None,
        parts=(b"",),
        length=None,
        kind="http",
        address="a",
        fetch=(),
        every=0.0,
    ):
        """Status, what was sent, headers; fetch: site, mode and dest, as a browser says them; every: s a part takes."""
        headers = {
            "host": host,
            "origin": origin,
            "cookie": self.cookie,
            "content-length": length,
        }
        headers |= dict(
            zip(
                ("sec-fetch-site", "sec-fetch-mode", "sec-fetch-dest"),
                fetch,
                strict=False,
            )
        )
        sent, coming = [], list(parts)

        async def receive():
            await self.gate.clock.sleep(every)
            return {
                "type": "http.request",
                "body": coming.pop(0),
                "more_body": bool(coming),
            }

        async def send(event):
            sent.append(event)

        scope = {
            "type": kind,
            "method": method,
            "path": path,
            "client": (address, 1234),
            "headers": [
                (k.encode(), str(v).encode())
                for k, v in headers.items()
                if v is not None
            ],
        }
        await self.gate(scope, receive, send)
        if kind == "websocket":
            return sent[0]["type"].removeprefix("websocket."), b"", {}
        return sent[0]["status"], sent[1]["body"], dict(sent[0]["headers"])

    async def log_in(self, password, address="a"):
        parts = (f"password={password}".encode(),)
        status, _, headers = await self.come(
            "POST", "/login", origin=ORIGIN, parts=parts, address=address
        )
        self.cookie = headers.get(b"set-cookie", b"").decode().partition(";")[0]
        return status, headers.get(b"set-cookie", b"").decode()


@virtual
async def test_a_visitor_of_the_page_itself_is_admitted(clock):
    visitor = Visitor(clock)
    status, body, headers = await visitor.come()
    assert (status, body) == (200, b"in")
    assert headers[b"x-frame-options"] == b"DENY"
    assert b"frame-ancestors 'none'" in headers[b"content-security-policy"]
    assert (await visitor.come("POST", origin=ORIGIN))[0] == 200
    assert (await visitor.come(kind="websocket", origin=ORIGIN))[0] == "accept"


@virtual
async def test_a_name_that_was_bound_to_this_address_is_refused(clock):
    visitor = Visitor(clock)
    for host in ("evil.example:8765", "127.0.0.1:9999", "", "127.0.0.1"):
        assert (await visitor.come(host=host))[0] == 421
        assert (
            await visitor.come(kind="websocket", host=host, origin=f"http://{host}")
        )[0] == "close"


@virtual
async def test_other_sites_may_neither_post_nor_open_a_line(clock):
    visitor = Visitor(clock)
    for origin in (
        "http://evil.example",
        "null",
        None,
        "http://127.0.0.1:8000",
        f"{ORIGIN}.evil.example",
    ):
        assert (await visitor.come("POST", origin=origin))[0] == 403
        assert (await visitor.come("DELETE", origin=origin))[0] == 403
        assert (await visitor.come(kind="websocket", origin=origin))[0] == "close"
    assert (await visitor.come(origin=ORIGIN))[0] == 200


@pytest.mark.parametrize(
    ("origin", "fetch", "status"),
    [
        ("http://evil.example", (), 403),
        ("null", (), 403),
        (None, ("cross-site", "no-cors", "image"), 403),
        (None, ("same-site", "cors", "empty"), 403),
        (None, ("cross-site", "navigate", "iframe"), 403),
        ("http://evil.example", ("cross-site", "navigate", "document"), 403),
        (None, ("cross-site", "navigate", "document"), 200),
        (None, ("same-site", "navigate", "document"), 200),
        (None, ("same-origin", "no-cors", "script"), 200),
        (None, ("none", "navigate", "document"), 200),
    ],
)
def test_other_sites_may_do_no_more_than_link_to_the_page(origin, fetch, status):
    @virtual
    async def come(clock):
        visitor = Visitor(clock)
        for path in ("/", "/own/page.js"):
            assert (await visitor.come(path=path, origin=origin, fetch=fetch))[
                0
            ] == status

    come()


@virtual
async def test_what_is_too_large_is_refused_whether_it_says_so_or_not(clock):
    visitor = Visitor(clock)
    for length in (PAGE_REQUEST_RULES.largest_body + 1, "much", "-1"):
        assert (await visitor.come("POST", origin=ORIGIN, length=length))[0] == 413
    half = b"x" * (PAGE_REQUEST_RULES.largest_body // 2)
    assert (await visitor.come("POST", origin=ORIGIN, parts=(half, half)))[0] == 200
    assert (await visitor.come("POST", origin=ORIGIN, parts=(half, half, b"x")))[
        0
    ] == 413


@virtual
async def test_without_the_password_no_visitor_is_admitted(clock):
    visitor = Visitor(clock, hosts=None, password=PASSWORD)
    for path in (
        "/",
        "/line",
        "/own/page.js",
        "/_nicegui/3/static/nicegui.js",
        "/login",
    ):
        status, body, _ = await visitor.come(path=path, host="lab:8765")
        assert status == 401
        assert b"Password" in body
        assert body != b"in"
    assert (await visitor.come(kind="websocket", origin=ORIGIN))[0] == "close"
    visitor.cookie = f"{PAGE_SESSION.cookie_name}=guessed"
    assert (await visitor.come())[0] == 401
    visitor.cookie = f"{PAGE_SESSION.cookie_name}="
    assert (await visitor.come(kind="websocket", origin=ORIGIN))[0] == "close"


@virtual
async def test_with_the_password_one_comes_in_and_wrong_ones_take_their_time(clock):
    visitor = Visitor(clock, hosts=None, password=PASSWORD)
    assert (await visitor.log_in("wrong"))[0] == 401
    assert clock.now() == 0.0
    status, cookie = await visitor.log_in("correct+horse")
    assert status == 303
    assert clock.now() == LOGIN_LIMITS.attempt_interval, "it waits for its turn"
    assert "HttpOnly" in cookie
    assert "Max-Age=43200" in cookie
    assert "SameSite=Strict" in cookie
    assert "Secure" not in cookie
    assert (await visitor.come())[:2] == (200, b"in")
    assert (await visitor.come(kind="websocket", origin=ORIGIN))[0] == "accept"
    assert (await visitor.come(kind="websocket", origin="http://evil.example"))[
        0
    ] == "close"
    await clock.sleep(PAGE_SESSION.lifetime - 1.0)
    assert (await visitor.come())[0] == 200
    again = AccessGate(read_all, clock, None, PASSWORD)
    other, visitor.gate = visitor.gate, again
    assert (await visitor.come())[0] == 200, "the server was started again"
    visitor.gate = AccessGate(read_all, clock, None, "another password")
    assert (await visitor.come())[0] == 401
    visitor.gate = other
    name, _, value = visitor.cookie.partition("=")
    until, _, signed = value.partition(".")
    for forged in (
        f"{int(until) + 9}.{signed}",
        f"{until}.{signed[:-1]}",
        f".{signed}",
        until,
        "\u0661.x",
    ):
        visitor.cookie = f"{name}={forged}"
        assert (await visitor.come())[0] == 401, forged
    visitor.cookie = f"{name}={value}"
    await clock.sleep(2.0)
    assert (await visitor.come())[0] == 401, "it has come in too long ago"
    assert (await visitor.come(kind="websocket", origin=ORIGIN))[0] == "close"


@virtual
async def test_a_password_guesser_is_slowed_and_does_not_lock_out_others(clock):
    guesser, operator = (
        Visitor(clock, hosts=None, password=PASSWORD) for _ in range(2)
    )
    operator.gate = guesser.gate
    tries = [
        asyncio.create_task(guesser.log_in(f"guess-{k}", "evil")) for k in range(20)
    ]
    await clock.sleep(0.1)
    assert (await operator.log_in("correct+horse", "operator"))[0] == 303
    assert clock.now() == 0.1
    said = [status for status, _ in await asyncio.gather(*tries)]
    looked_at = 1 + round(LOGIN_LIMITS.longest_wait / LOGIN_LIMITS.attempt_interval)
    assert (said.count(401), said.count(429)) == (looked_at, 20 - looked_at)
    assert clock.now() == LOGIN_LIMITS.longest_wait
    assert (await guesser.log_in("guess", "evil"))[0] == 401
    assert clock.now() == LOGIN_LIMITS.longest_wait + LOGIN_LIMITS.attempt_interval
    for k in range(2 * LOGIN_LIMITS.most_addresses):
        assert (await guesser.log_in("guess", f"evil-{k}"))[0] == 401
    assert len(guesser.gate._next) == LOGIN_LIMITS.most_addresses


@virtual
async def test_a_login_is_bounded_and_of_this_site_and_its_cookie_is_secret_under_tls(
    clock,
):
    visitor = Visitor(clock, hosts=None, password=PASSWORD, tls=True)
    assert (await visitor.come("POST", "/login", parts=(b"password=correct+horse",)))[
        0
    ] == 403
    parts = (b"x" * LOGIN_LIMITS.largest_body, b"x")
    status, _, headers = await visitor.come(
        "POST", "/login", origin=ORIGIN, parts=parts
    )
    assert (status, headers[b"connection"]) == (413, b"close")
    parts = (b"password=", *[b"x"] * 100)
    status, _, headers = await visitor.come(
        "POST", "/login", origin=ORIGIN, parts=parts, every=1.0
    )
    assert (status, headers[b"connection"], clock.now()) == (
        408,
        b"close",
        LOGIN_LIMITS.body_timeout,
    )
    assert "; Secure" in (await visitor.log_in("correct+horse"))[1]


@virtual
async def test_what_is_no_request_goes_through(clock):
    through = asyncio.Event()

    async def app(scope, receive, send):
        through.set()

    await AccessGate(app, clock, (HOST,))({"type": "lifespan"}, None, None)
    assert through.is_set()


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("10.0.0.1", "10.0.0.2", False),
        ("2001:db8::1", "2001:db8::ffff:1", True),
        ("2001:db8::1", "2001:db8:0:1::1", False),
        ("::ffff:10.0.0.1", "::ffff:10.0.0.2", False),
        ("fe80::1%eth0", "fe80::2%eth0", True),
        ("", "", True),
    ],
)
def test_addresses_that_one_visitor_may_choose_among_count_as_one_network(
    one, other, same
):
    assert (network_of(one) == network_of(other)) is same
