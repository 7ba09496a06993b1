"""The page's server: NiceGUI on the common event loop and clock, behind the access check."""

import asyncio
import contextlib
import ipaddress
import socket
import ssl
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import uvicorn
from fastapi import FastAPI, WebSocket, WebSocketDisconnect
from nicegui import ui
from starlette.middleware.gzip import GZipMiddleware
from starlette.staticfiles import StaticFiles
from uvicorn.protocols.http.h11_impl import H11Protocol

from crazychoir.agent.dead_man import ConsoleReporter, is_console
from crazychoir.dashboard.access import PAGE_REQUEST_RULES, AccessGate, network_of
from crazychoir.dashboard.command_place import PagePlace
from crazychoir.dashboard.commands import CommandDesk
from crazychoir.dashboard.event_log import EventLog
from crazychoir.dashboard.model import SwarmModel
from crazychoir.dashboard.operator import PageOperator
from crazychoir.dashboard.page import THREE_JS_FOLDER, Page
from crazychoir.dashboard.polling import Overview, TaskBoard
from crazychoir.dashboard.stream import PageStream
from crazychoir.errors import ConfigError
from crazychoir.runtime.supervisor import Supervisor


@dataclass(frozen=True, slots=True)
class PageServerLimits:
    """Ports and limits of the page's server."""

    first_port: int = 8765
    """First port that is tried if none is given."""
    tried_ports: int = 20
    """Number of ports that are tried; the first free one is used."""
    shutdown_time: int = 1
    """Seconds that open connections get when the server ends."""
    most_connections: int = 512
    """Beyond this number of connections requests are refused; open WebSockets stay open."""


PAGE_SERVER = PageServerLimits()


STATIC_FOLDER = Path(__file__).with_name("static")
"""Folder of the page's own scripts and styles."""
DEFAULT_PORTS = {"http": 80, "https": 443}
"""Default ports, which browsers leave out of an address."""
COMPRESSION_LEVEL = 5
"""Level of gzip for the page's own files; higher ones take longer for little."""
IDLE_CHECK_PERIOD = 5.0
"""Seconds between two checks of a connection.

A request must arrive, and the next one follow an answer, within one to two such intervals.
"""
MOST_CONNECTIONS_PER_ADDRESS = 64
"""Largest number of connections of one address, WebSockets included; a browser has some six."""


@dataclass(frozen=True)
class PageAddress:
    """The address of a page, and the conditions to open it.

    Raises ConfigError if other machines could open it without a password or certificate, or if
    options or files do not fit together.
    """

    host: str = "127.0.0.1"
    """Address to listen at."""
    port: int | None = None
    """Port, None for the first free one of PAGE_SERVER.tried_ports."""
    password: str | None = None
    """Password of the page, None for none."""
    certificate: Path | None = None
    """PEM file of the certificate, for https."""
    key: Path | None = None
    """PEM file of its key, for https."""
    authority: Path | None = None
    """PEM file of certificates. A browser must then have a certificate signed by one of them."""

    def __post_init__(self) -> None:
        if self.password is not None and len(self.password) < 8:
            raise ConfigError(
                "password", f"{len(self.password)} characters", "8 or more"
            )
        if not self.loopback and self.password is None and self.authority is None:
            do = "Name --password-file or --authority, or leave --host out and use `ssh -L` to come from elsewhere."
            allowed = (
                "a password or an authority, where others than this machine can come in"
            )
            raise ConfigError("--host", self.host, allowed, do)
        if (self.certificate is None) != (self.key is None):
            raise ConfigError(
                "--certificate", "without --key, or --key without it", "both, or none"
            )
        if self.authority is not None and self.certificate is None:
            raise ConfigError(
                "--authority",
                "no --certificate and no --key",
                "https, in which browsers show theirs",
            )
        self._check_files()

    def _check_files(self) -> None:
        """Raise ConfigError if the certificate, key or authority file cannot be used."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        if self.certificate is not None:
            with _refuse_unreadable(
                "--certificate",
                f"{self.certificate}, {self.key}",
                "a PEM certificate and its own key",
            ):
                context.load_cert_chain(
                    self.certificate, self.key, lambda: ""
                )  # an empty password, so that OpenSSL never asks for one
        if self.authority is not None:
            with _refuse_unreadable(
                "--authority", str(self.authority), "a PEM file of certificates"
            ):
                context.load_verify_locations(self.authority)

    @property
    def loopback(self) -> bool:
        """Whether only this machine can open the page."""
        try:
            return (
                self.host == "localhost" or ipaddress.ip_address(self.host).is_loopback
            )
        except ValueError:
            return False

    @property
    def scheme(self) -> str:
        """Scheme of the page's address: http or https."""
        return "http" if self.certificate is None else "https"

    @property
    def name(self) -> str:
        """The host as written in an address."""
        return f"[{self.host}]" if ":" in self.host else self.host

    def hosts(self, port: int) -> tuple[str, ...] | None:
        """Return the host names that browsers of this machine may use at this port.

        Returns None, for any name, if other machines may open the page.
        """
        if not self.loopback:
            return None
        names = tuple(dict.fromkeys((*PAGE_REQUEST_RULES.loopback_names, self.name)))
        bare = names if port == DEFAULT_PORTS[self.scheme] else ()
        return (*(f"{name}:{port}" for name in names), *bare)

    def bound(self) -> socket.socket:
        """Return a listening socket.

        Raises ConfigError if the address is not one of this machine, or if the port is taken.
        """
        ports = (
            [self.port]
            if self.port is not None
            else range(
                PAGE_SERVER.first_port, PAGE_SERVER.first_port + PAGE_SERVER.tried_ports
            )
        )
        for port in ports:
            try:
                family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
                return socket.create_server((self.host, port), family=family)
            except OSError as error:
                problem = error.strerror or str(error)
        where = (
            f"{self.host}:{self.port}"
            if self.port is not None
            else f"{self.host}:{PAGE_SERVER.first_port} to {PAGE_SERVER.first_port + PAGE_SERVER.tried_ports - 1}"
        )
        raise ConfigError(
            "--port",
            where,
            "an address of this machine and a free port",
            problem=problem,
        )


@contextlib.contextmanager
def _refuse_unreadable(option: str, found: str, allowed: str) -> Iterator[None]:
    try:
        yield
    except ssl.SSLError as error:
        reason = (error.reason or str(error)).replace("_", " ").lower()
        raise ConfigError(
            option, found, allowed, problem=f"OpenSSL says {reason}"
        ) from error
    except OSError as error:
        raise ConfigError(
            option, found, allowed, problem=str(error.strerror)
        ) from error


async def serve(
    place: PagePlace, served: PageAddress, say: Callable[[str], None]
) -> None:
    """Serve the page of a swarm until a signal ends it.

    place: the place on the network.
    served: where the page is served.
    say: prints a line for the operator.
    """
    bus = place.link.bus
    clock = place.clock
    config = place.config
    watch = EventLog(clock)
    model = SwarmModel(bus, place.address, config, watch, EventLog(clock))
    desk = CommandDesk(place, watch)
    overview = Overview(desk)
    board = TaskBoard(desk, model)
    stream = PageStream(model, desk, watch, overview, board)
    listening = served.bound()
    port = listening.getsockname()[1]
    app = _make_app(
        stream, lambda: PageOperator(config, desk, board), Page(model.about())
    )
    gate = AccessGate(
        app, clock, served.hosts(port), served.password, tls=served.scheme == "https"
    )
    server = uvicorn.Server(
        uvicorn.Config(
            gate,
            http=GuestConnection,
            log_level="warning",
            lifespan="on",
            ws_max_size=PAGE_REQUEST_RULES.largest_body,
            ws_per_message_deflate=False,
            ws_max_queue=8,
            timeout_graceful_shutdown=PAGE_SERVER.shutdown_time,
            server_header=False,
            proxy_headers=False,
            limit_concurrency=PAGE_SERVER.most_connections,
            ssl_certfile=served.certificate,
            ssl_keyfile=served.key,
            ssl_ca_certs=served.authority,
            ssl_cert_reqs=ssl.CERT_NONE
            if served.authority is None
            else ssl.CERT_REQUIRED,
        )
    )
    if served.port is None and port != PAGE_SERVER.first_port:
        say(
            f"port {PAGE_SERVER.first_port} is taken, as by the page of another swarm: this one is at {port}"
        )
    say(
        f"page of swarm {config.name}: {served.scheme}://{served.name}:{port}; Ctrl-C ends it, and the swarm flies on"
    )
    console = (
        [ConsoleReporter(place.commander, config.ids)]
        if not place.replays and is_console(config, bus.host)
        else []
    )
    streaming = asyncio.create_task(
        Supervisor(clock, "page").run([stream, overview, board, *console])
    )
    try:
        await server.serve(sockets=[listening])
    finally:
        desk.close()
        streaming.cancel()
        await asyncio.wait([streaming])
        listening.close()


class _PageSocket:
    """A WebSocket that raises ConnectionError when it has ended, in every case; see Socket."""

    def __init__(self, websocket: WebSocket) -> None:
        self.websocket = websocket

    async def send_bytes(self, data: bytes) -> None:
        """Send one binary message."""
        with _ending():
            await self.websocket.send_bytes(data)

    async def send_text(self, data: str) -> None:
        """Send one text."""
        with _ending():
            await self.websocket.send_text(data)

    async def receive_text(self) -> str:
        """Return the next text."""
        with _ending():
            text: str = await self.websocket.receive_text()
            return text

    async def close(self, code: int, reason: str | None = None) -> None:
        """Close the WebSocket."""
        with _ending():
            await self.websocket.close(code, reason)


@contextlib.contextmanager
def _ending() -> Iterator[None]:
    try:
        yield
    except (
        WebSocketDisconnect,
        RuntimeError,
        KeyError,
    ) as error:  # raised after the end; KeyError if bytes come instead of a text
        raise ConnectionError(str(error)) from error


def _make_app(
    stream: PageStream, operator: Callable[[], PageOperator], page: Page
) -> FastAPI:
    app = FastAPI(openapi_url=None, docs_url=None, redoc_url=None)

    async def line(websocket: WebSocket) -> None:
        await websocket.accept()
        await stream.serve(_PageSocket(websocket), operator())

    app.add_api_websocket_route("/line", line)
    for path, folder in (("/own", STATIC_FOLDER), ("/three", THREE_JS_FOLDER)):
        files = StaticFiles(directory=folder)
        app.mount(path, GZipMiddleware(files, compresslevel=COMPRESSION_LEVEL))
    ui.page("/", title=f"{page.swarm} · crazychoir")(page.build)
    ui.run_with(
        app,
        binding_refresh_interval=None,
        show_welcome_message=False,
        dark=None,
        language="en-US",
        reconnect_timeout=5.0,
        tailwind=False,
        cache_control_directives="no-cache",
    )
    return app


class GuestConnection(H11Protocol):  # type: ignore[misc]
    """One HTTP connection; it is no longer checked once it has become a WebSocket."""

    _answered: Any = None  # the request that had been answered at the last check
    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:
        """Accept the connection, or close it if its address has too many."""
        super().connection_made(transport)
        mine = _network_of_connection(self)
        if (
            sum(_network_of_connection(one) == mine for one in self.connections)
            > MOST_CONNECTIONS_PER_ADDRESS
        ):
            transport.close()
            return
        self._timer = self.loop.call_later(IDLE_CHECK_PERIOD, self._look)

    def connection_lost(self, exc: Exception | None) -> None:
        """Stop the checks."""
        if self._timer is not None:
            self._timer.cancel()
        super().connection_lost(exc)

    def _look(self) -> None:
        """Close the connection if no request has been active since the last check."""
        if self not in self.connections:  # it has become a WebSocket
            return
        idle = self.cycle is None or self.cycle.response_complete
        if idle and self.cycle is self._answered:
            self.transport.close()
            return
        self._answered = self.cycle
        self._timer = self.loop.call_later(IDLE_CHECK_PERIOD, self._look)


def _network_of_connection(connection: Any) -> str:
    return network_of(connection.client[0]) if connection.client else ""
