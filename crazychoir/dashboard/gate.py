"""Who may come in: every request passes here before anything else sees it.

Refused: hosts that the page is not served at (a name that was bound to this address), other sites' requests, bodies
that are too large, and, where a password is wanted, whoever has not given it.
"""

import hmac
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from crazychoir.runtime.clock import Clock

Scope = MutableMapping[str, Any]
Event = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Event]]
Send = Callable[[Event], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

MOST_BODY = 1 << 18
"""Bytes of a request's body, and of one message of a page."""
COOKIE, LOGIN = "crazychoir", "/login"
MOST_SESSIONS = 256
PAUSE = 1.0
"""s after a wrong password in which no other is looked at."""
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
SAFE = ("GET", "HEAD")
HEADERS = [
    (b"x-frame-options", b"DENY"), (b"x-content-type-options", b"nosniff"), (b"referrer-policy", b"same-origin"),
    (b"content-security-policy", b"frame-ancestors 'none'; base-uri 'self'; form-action 'self'; object-src 'none'"),
]  # fmt: skip
FORM = """<!doctype html><html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1"><title>crazychoir</title>
<style>:root{color-scheme:light dark}body{font:1.1rem system-ui;max-width:20rem;margin:15vh auto;padding:1rem}
input,button{font:inherit;width:100%;padding:.5rem;margin:.3rem 0;box-sizing:border-box}</style>
<form method="post" action="/login"><h1>crazychoir</h1><p role="alert">SAID</p>
<label for="password">Password of this page</label>
<input id="password" name="password" type="password" autocomplete="current-password" autofocus required>
<button>Come in</button></form></html>"""


class TooLarge(Exception):
    """A body went on beyond MOST_BODY."""


class Gate:
    """Before an application.

    hosts: names that it is served at, with its port, None for any;  password: None for none;  tls: whether cookies
    may travel encrypted only.
    """

    def __init__(
        self, app: App, clock: Clock, hosts: tuple[str, ...] | None, password: str | None = None, tls: bool = False
    ) -> None:
        self.app, self.clock, self.hosts, self.password, self.tls = app, clock, hosts, password, tls
        self._sessions: dict[str, None] = {}
        self._next = 0.0  # s, when a password is looked at again

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One connection."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in scope["headers"]}
        status, why = self._refused(scope, headers)
        if status:
            await _refuse(scope, send, status, why)
        elif self.password is None or self._known(headers):
            await self._through(scope, receive, send)
        elif scope["type"] == "http":
            await self._login(scope, receive, send)
        else:
            await _refuse(scope, send, 401, "the password of this page is wanted")

    def _refused(self, scope: Scope, headers: dict[str, str]) -> tuple[int, str]:
        """Status and reason; 0 if it is none."""
        host, origin = headers.get("host", ""), headers.get("origin")
        if self.hosts is not None and host not in self.hosts:
            return 421, f"not served at {host!r}; at {', '.join(self.hosts)}"
        asks = scope["type"] == "websocket" or scope["method"] not in SAFE
        if asks and (origin is None or origin.partition("://")[2] != host):
            return 403, "a request of another site, or of none, which only pages of this one may make"
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > MOST_BODY:
            return 413, f"more than {MOST_BODY} bytes"
        return 0, ""

    def _known(self, headers: dict[str, str]) -> bool:
        try:
            cookie = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            return False
        return COOKIE in cookie and cookie[COOKIE].value in self._sessions

    async def _through(self, scope: Scope, receive: Receive, send: Send) -> None:
        """To the application, which gets no more than MOST_BODY bytes."""
        size, begun = 0, False

        async def bounded() -> Event:
            nonlocal size
            event = await receive()
            if event["type"] == "http.request":
                size += len(event.get("body", b""))
                if size > MOST_BODY:
                    raise TooLarge
            return event

        async def with_headers(event: Event) -> None:
            nonlocal begun
            if event["type"] == "http.response.start":
                begun = True
                event = {**event, "headers": [*event.get("headers", []), *HEADERS]}
            await send(event)

        try:
            await self.app(scope, bounded, with_headers)
        except TooLarge:
            if not begun:
                await _refuse(scope, send, 413, f"more than {MOST_BODY} bytes")

    async def _login(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["method"] != "POST" or scope["path"] != LOGIN:
            await _answer(send, 401, FORM.replace("SAID", "").encode(), b"text/html; charset=utf-8")
            return
        body = b""
        while True:
            event = await receive()
            body += event.get("body", b"")
            if len(body) > MOST_BODY:
                await _refuse(scope, send, 413, f"more than {MOST_BODY} bytes")
                return
            if not event.get("more_body"):
                break
        given = parse_qs(body.decode("utf-8", "replace")).get("password", [""])[0]
        now = self.clock.now()
        if now < self._next:
            said, status = "Too many tries: wait a moment.", 429
        elif self.password is not None and hmac.compare_digest(given.encode(), self.password.encode()):
            await self._welcome(send)
            return
        else:
            self._next = now + PAUSE
            said, status = "That is not the password.", 401
        await _answer(send, status, FORM.replace("SAID", said).encode(), b"text/html; charset=utf-8")

    async def _welcome(self, send: Send) -> None:
        session = secrets.token_urlsafe(32)
        while len(self._sessions) >= MOST_SESSIONS:
            del self._sessions[next(iter(self._sessions))]
        self._sessions[session] = None
        cookie = f"{COOKIE}={session}; Path=/; HttpOnly; SameSite=Strict{'; Secure' if self.tls else ''}"
        await _answer(send, 303, b"", b"text/plain", [(b"location", b"/"), (b"set-cookie", cookie.encode())])


async def _refuse(scope: Scope, send: Send, status: int, why: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": why})
    else:
        await _answer(send, status, f"crazychoir: {why}\n".encode(), b"text/plain; charset=utf-8")


async def _answer(
    send: Send, status: int, body: bytes, kind: bytes, more: list[tuple[bytes, bytes]] | None = None
) -> None:
    headers = [(b"content-type", kind), (b"content-length", str(len(body)).encode()), *(more or []), *HEADERS]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
