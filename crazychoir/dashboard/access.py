"""Access control: every request passes here before any other code sees it.

Refused are
- hosts at which the page is not served, such as a foreign name bound to this address,
- requests of other sites, except a link to the page,
- bodies that are too large, and
- visitors without the password, if there is one.
"""

import asyncio
import hashlib
import hmac
import ipaddress
from collections.abc import Awaitable, Callable, MutableMapping
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs

from crazychoir.runtime.clock import NS_PER_SECOND, Clock

Scope = MutableMapping[str, Any]
Event = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Event]]
Send = Callable[[Event], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]


@dataclass(frozen=True, slots=True)
class PageRequestRules:
    """Rules for every request: its size, its host and its origin."""

    largest_body: int = 1 << 18
    """Largest size in bytes of a request's body and of one message of a page."""
    loopback_names: tuple[str, ...] = ("localhost", "127.0.0.1", "[::1]")
    """Host names of this machine."""
    safe_methods: tuple[str, ...] = ("GET", "HEAD")
    """HTTP methods that change nothing."""
    other_site_values: tuple[str, ...] = ("cross-site", "same-site")
    """Values of Sec-Fetch-Site for a request of another site, on this host too.

    Source: Fetch Metadata, W3C.
    """


PAGE_REQUEST_RULES = PageRequestRules()


@dataclass(frozen=True, slots=True)
class PageSession:
    """The session of a visitor with the password."""

    cookie_name: str = "crazychoir"
    """Name of the session cookie."""
    login_path: str = "/login"
    """Path to which the password is sent."""
    lifetime: int = 12 * 3600
    """Seconds for which a correct password counts."""
    key_salt: bytes = b"crazychoir's page"
    """Salt of the key that signs cookies."""


PAGE_SESSION = PageSession()


@dataclass(frozen=True, slots=True)
class LoginLimits:
    """Limits of the attempts to give the password."""

    network_bits: int = 64
    """Bits of an IPv6 address that the visitor's network fixes; a visitor can choose the others.
    """
    attempt_interval: float = 1.0
    """Seconds between two passwords from one address."""
    longest_wait: float = 3.0
    """Longest time in seconds that a password waits for its turn."""
    most_addresses: int = 1024
    """Number of addresses for which the time of the next password is stored."""
    largest_body: int = 1 << 12
    """Largest size in bytes of a login request's body."""
    body_timeout: float = 5.0
    """Seconds within which that body must arrive."""


LOGIN_LIMITS = LoginLimits()


ANSWER_HEADERS = [
    (b"x-frame-options", b"DENY"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"same-origin"),
    (
        b"content-security-policy",
        b"frame-ancestors 'none'; base-uri 'self'; form-action 'self'; object-src 'none'",
    ),
]
"""Headers of every answer: no frames, no foreign scripts, no referrer to other sites."""
LOGIN_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1"><title>crazychoir</title>
<style>:root{color-scheme:light dark}body{font:1.1rem system-ui;max-width:20rem;margin:15vh auto;padding:1rem}
input,button{font:inherit;width:100%;padding:.5rem;margin:.3rem 0;box-sizing:border-box}</style>
<form method="post" action="/login"><h1>crazychoir</h1><p role="alert">SAID</p>
<label for="password">Password of this page</label>
<input id="password" name="password" type="password" autocomplete="current-password" autofocus required>
<button>Come in</button></form></html>"""
"""Page that asks for the password; SAID is replaced by a message."""


class BodyTooLarge(Exception):
    """A body is larger than allowed."""


class AccessGate:
    """Access control in front of an application.

    app: the application behind it.
    clock: clock of the pauses and sessions.
    hosts: names, with the port, at which the page is served; None for any.
    password: None for none.
    tls: whether cookies must travel encrypted.
    """

    def __init__(
        self,
        app: App,
        clock: Clock,
        hosts: tuple[str, ...] | None,
        password: str | None = None,
        tls: bool = False,
    ) -> None:
        self.app = app
        self.clock = clock
        self.hosts = hosts
        self.password = password
        self.tls = tls
        self._key = hashlib.scrypt(
            (password or "").encode(),
            salt=PAGE_SESSION.key_salt,
            n=1 << 14,
            r=8,
            p=1,
            dklen=32,
        )
        self._next: dict[
            str, float
        ] = {}  # s, by address: when its next password may be checked

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Handle one connection."""
        if scope["type"] not in ("http", "websocket"):
            await self.app(scope, receive, send)
            return
        headers = {
            name.decode("latin-1"): value.decode("latin-1")
            for name, value in scope["headers"]
        }
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
        """Return status and reason of a refusal; status 0 if the request is allowed."""
        host = headers.get("host", "")
        origin = headers.get("origin")
        if self.hosts is not None and host not in self.hosts:
            return 421, f"not served at {host!r}; at {', '.join(self.hosts)}"
        asks = (
            scope["type"] == "websocket"
            or scope["method"] not in PAGE_REQUEST_RULES.safe_methods
        )
        own = origin is not None and origin.partition("://")[2] == host
        if asks and not own:
            return (
                403,
                "a request of another site, or of none, which only pages of this one may make",
            )
        if not own and (origin is not None or _is_of_another_site(headers)):
            return (
                403,
                "a request of another site, which may do no more than link to this one",
            )
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > PAGE_REQUEST_RULES.largest_body:
            return 413, f"more than {PAGE_REQUEST_RULES.largest_body} bytes"
        return 0, ""

    def _known(self, headers: dict[str, str]) -> bool:
        try:
            cookie = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            return False
        until, _, signed = (
            cookie[PAGE_SESSION.cookie_name].value.partition(".")
            if PAGE_SESSION.cookie_name in cookie
            else ("", "", "")
        )
        genuine = hmac.compare_digest(signed.encode(), self._signed(until).encode())
        return genuine and self._today < int(until)

    @property
    def _today(self) -> int:
        """Seconds since 1970, so that a session survives a restart of the server."""
        return (self.clock.now_ns() + self.clock.epoch_ns) // NS_PER_SECOND

    def _signed(self, until: str) -> str:
        return hmac.new(self._key, until.encode(), hashlib.sha256).hexdigest()

    async def _through(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the request to the application, with at most `largest_body` bytes of body."""
        size = 0
        begun = False

        async def bounded() -> Event:
            nonlocal size
            event = await receive()
            if event["type"] == "http.request":
                size += len(event.get("body", b""))
                if size > PAGE_REQUEST_RULES.largest_body:
                    raise BodyTooLarge
            return event

        async def with_headers(event: Event) -> None:
            nonlocal begun
            if event["type"] == "http.response.start":
                begun = True
                event = {
                    **event,
                    "headers": [*event.get("headers", []), *ANSWER_HEADERS],
                }
            await send(event)

        try:
            await self.app(scope, bounded, with_headers)
        except BodyTooLarge:
            if not begun:
                await _refuse(
                    scope,
                    send,
                    413,
                    f"more than {PAGE_REQUEST_RULES.largest_body} bytes",
                )

    async def _login(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["method"] != "POST" or scope["path"] != PAGE_SESSION.login_path:
            await _send_password_page(send, 401)
            return
        try:
            async with asyncio.timeout(LOGIN_LIMITS.body_timeout):
                body = await _read_body(receive, LOGIN_LIMITS.largest_body)
        except BodyTooLarge:
            await _refuse(
                scope, send, 413, f"more than {LOGIN_LIMITS.largest_body} bytes"
            )
            return
        except TimeoutError:
            await _refuse(
                scope,
                send,
                408,
                f"no whole request within {LOGIN_LIMITS.body_timeout:g} s",
            )
            return
        address = network_of(scope["client"][0]) if scope.get("client") else ""
        wait = self._turn(address)
        if wait > LOGIN_LIMITS.longest_wait:
            await _send_password_page(send, 429, "Too many tries: wait a moment.")
            return
        await self.clock.sleep(wait)
        given = parse_qs(body.decode("utf-8", "replace")).get("password", [""])[0]
        if self.password is not None and hmac.compare_digest(
            given.encode(), self.password.encode()
        ):
            self._next.pop(address, None)
            await self._welcome(send)
        else:
            await _send_password_page(send, 401, "That is not the password.")

    def _turn(self, address: str) -> float:
        """Return the seconds until a password that this address sends now is checked.

        Each address waits only for its own earlier passwords.
        """
        now = self.clock.now()
        wait = max(0.0, self._next.pop(address, 0.0) - now)
        self._next[address] = (
            now
            + wait
            + (
                LOGIN_LIMITS.attempt_interval
                if wait <= LOGIN_LIMITS.longest_wait
                else 0.0
            )
        )
        while len(self._next) > LOGIN_LIMITS.most_addresses:
            del self._next[next(iter(self._next))]
        return wait

    async def _welcome(self, send: Send) -> None:
        until = str(self._today + PAGE_SESSION.lifetime)
        limits = f"Max-Age={PAGE_SESSION.lifetime}; Path=/; HttpOnly; SameSite=Strict{'; Secure' if self.tls else ''}"
        cookie = f"{PAGE_SESSION.cookie_name}={until}.{self._signed(until)}; {limits}"
        await _answer(
            send,
            303,
            b"",
            b"text/plain",
            [(b"location", b"/"), (b"set-cookie", cookie.encode())],
        )


def network_of(address: str) -> str:
    """Return the address, or for IPv6 the network within which a visitor can choose addresses."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if found.version == 4 or found.ipv4_mapped is not None:
        return str(found)
    return str(
        ipaddress.ip_network(
            (
                int(found)
                >> (128 - LOGIN_LIMITS.network_bits)
                << (128 - LOGIN_LIMITS.network_bits),
                LOGIN_LIMITS.network_bits,
            )
        )
    )


def _is_of_another_site(headers: dict[str, str]) -> bool:
    """Return whether another site makes the request, as the browser says, without a link to the page."""
    link = (
        headers.get("sec-fetch-mode") == "navigate"
        and headers.get("sec-fetch-dest") == "document"
    )
    return (
        headers.get("sec-fetch-site") in PAGE_REQUEST_RULES.other_site_values
        and not link
    )


async def _read_body(receive: Receive, most: int) -> bytes:
    """Return the whole body, or the part that came before the visitor left.

    Raises BodyTooLarge beyond `most` bytes.
    """
    body = b""
    more = True
    while more:
        event = await receive()
        body += event.get("body", b"")
        more = event.get("more_body", False)
        if len(body) > most:
            raise BodyTooLarge
    return body


async def _send_password_page(send: Send, status: int, said: str = "") -> None:
    await _answer(
        send,
        status,
        LOGIN_PAGE.replace("SAID", said).encode(),
        b"text/html; charset=utf-8",
    )


async def _refuse(scope: Scope, send: Send, status: int, why: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": why})
    else:
        unread = [(b"connection", b"close")] if status in (408, 413) else []
        await _answer(
            send,
            status,
            f"crazychoir: {why}\n".encode(),
            b"text/plain; charset=utf-8",
            unread,
        )


async def _answer(
    send: Send,
    status: int,
    body: bytes,
    kind: bytes,
    more: list[tuple[bytes, bytes]] | None = None,
) -> None:
    headers = [
        (b"content-type", kind),
        (b"content-length", str(len(body)).encode()),
        *(more or []),
        *ANSWER_HEADERS,
    ]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
