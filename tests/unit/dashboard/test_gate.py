import asyncio

import pytest
from virtual_time import virtual

from crazychoir.dashboard.gate import COOKIE, MOST_BODY, PAUSE, Gate

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
        self.gate = Gate(read_all, clock, **{"hosts": (HOST,), **options})
        self.cookie = ""

    async def come(self, method="GET", path="/", host=HOST, origin=None, parts=(b"",), length=None, kind="http"):
        """Status, what was sent, headers."""
        headers = {"host": host, "origin": origin, "cookie": self.cookie, "content-length": length}
        sent, coming = [], list(parts)

        async def receive():
            return {"type": "http.request", "body": coming.pop(0), "more_body": bool(coming)}

        async def send(event):
            sent.append(event)

        scope = {
            "type": kind, "method": method, "path": path,
            "headers": [(k.encode(), str(v).encode()) for k, v in headers.items() if v is not None],
        }  # fmt: skip
        await self.gate(scope, receive, send)
        if kind == "websocket":
            return sent[0]["type"].removeprefix("websocket."), b"", {}
        return sent[0]["status"], sent[1]["body"], dict(sent[0]["headers"])

    async def log_in(self, password):
        status, _, headers = await self.come(
            "POST", "/login", origin=ORIGIN, parts=(f"password={password}".encode(),)
        )
        self.cookie = headers.get(b"set-cookie", b"").decode().partition(";")[0]
        return status, headers.get(b"set-cookie", b"").decode()


@virtual
async def test_who_comes_to_the_page_itself_comes_in(clock):
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
        assert (await visitor.come(kind="websocket", host=host, origin=f"http://{host}"))[0] == "close"


@virtual
async def test_other_sites_may_neither_post_nor_open_a_line(clock):
    visitor = Visitor(clock)
    for origin in ("http://evil.example", "null", None, "http://127.0.0.1:8000", f"{ORIGIN}.evil.example"):
        assert (await visitor.come("POST", origin=origin))[0] == 403
        assert (await visitor.come("DELETE", origin=origin))[0] == 403
        assert (await visitor.come(kind="websocket", origin=origin))[0] == "close"
    assert (await visitor.come(origin="http://evil.example"))[0] == 200, "reading changes nothing; no header lets it"


@virtual
async def test_what_is_too_large_is_refused_whether_it_says_so_or_not(clock):
    visitor = Visitor(clock)
    for length in (MOST_BODY + 1, "much", "-1"):
        assert (await visitor.come("POST", origin=ORIGIN, length=length))[0] == 413
    half = b"x" * (MOST_BODY // 2)
    assert (await visitor.come("POST", origin=ORIGIN, parts=(half, half)))[0] == 200
    assert (await visitor.come("POST", origin=ORIGIN, parts=(half, half, b"x")))[0] == 413


@virtual
async def test_without_the_password_nobody_comes_in(clock):
    visitor = Visitor(clock, hosts=None, password=PASSWORD)
    for path in ("/", "/line", "/own/page.js", "/_nicegui/3/static/nicegui.js", "/login"):
        status, body, _ = await visitor.come(path=path, host="lab:8765")
        assert status == 401
        assert b"Password" in body
        assert body != b"in"
    assert (await visitor.come(kind="websocket", origin=ORIGIN))[0] == "close"
    visitor.cookie = f"{COOKIE}=guessed"
    assert (await visitor.come())[0] == 401
    visitor.cookie = f"{COOKIE}="
    assert (await visitor.come(kind="websocket", origin=ORIGIN))[0] == "close"


@virtual
async def test_with_the_password_one_comes_in_and_wrong_ones_take_their_time(clock):
    visitor = Visitor(clock, hosts=None, password=PASSWORD)
    assert (await visitor.log_in("wrong"))[0] == 401
    assert (await visitor.log_in("correct+horse"))[0] == 429, "at once after a wrong one"
    await clock.sleep(PAUSE)
    status, cookie = await visitor.log_in("correct+horse")
    assert status == 303
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert "Secure" not in cookie
    assert (await visitor.come())[:2] == (200, b"in")
    assert (await visitor.come(kind="websocket", origin=ORIGIN))[0] == "accept"
    assert (await visitor.come(kind="websocket", origin="http://evil.example"))[0] == "close"


@virtual
async def test_a_login_is_bounded_and_of_this_site_and_its_cookie_is_secret_under_tls(clock):
    visitor = Visitor(clock, hosts=None, password=PASSWORD, tls=True)
    assert (await visitor.come("POST", "/login", parts=(b"password=correct+horse",)))[0] == 403
    parts = (b"x" * MOST_BODY, b"x")
    assert (await visitor.come("POST", "/login", origin=ORIGIN, parts=parts))[0] == 413
    assert "; Secure" in (await visitor.log_in("correct+horse"))[1]


@virtual
async def test_what_is_no_request_goes_through(clock):
    through = asyncio.Event()

    async def app(scope, receive, send):
        through.set()

    await Gate(app, clock, (HOST,))({"type": "lifespan"}, None, None)
    assert through.is_set()


def test_a_visitor_can_fail():
    with pytest.raises(KeyError):
        asyncio.run(read_all({}, None, None))
