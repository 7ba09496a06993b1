"""The page in a real browser, and the line between it and its server, which can be cut or swallow what is said."""

import contextlib
import json
import re
import shutil
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from playwright.async_api import Page, TimeoutError, WebSocketRoute, async_playwright

TABS = ("fly", "draw", "tasks", "network", "plots", "log", "console", "parameters")
CHROMIUM = shutil.which("chromium")
Row = dict[str, Any]
FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


class Wire:
    """Between a page and its server.

    asked: what the page has sent;  lines: how many there were;  dead: nothing passes, of lines that begin meanwhile
    later neither;  deaf: nothing passes to the server;  frame: what the page gets for a frame;  drones: for a table;
    news: what it gets in place of what the server tells of these.
    """

    def __init__(self) -> None:
        self.asked: list[dict[str, Any]] = []
        self.lines = 0
        self.dead = self.deaf = False
        self.frame: Callable[[bytes], bytes] = lambda data: data
        self.drones: Callable[[list[Row]], list[Row]] = lambda rows: rows
        self.news: dict[str, Any] = {}
        self.page: WebSocketRoute

    def lay(self, page: WebSocketRoute) -> None:
        server, born_dead = page.connect_to_server(), self.dead
        self.lines += 1
        self.page = page

        def up(text: str | bytes) -> None:
            self.asked.append(json.loads(text))
            if not (born_dead or self.dead or self.deaf):
                server.send(text)

        def down(told: str | bytes) -> None:
            if not (born_dead or self.dead):
                page.send(
                    self.frame(told) if isinstance(told, bytes) else self.told(told)
                )

        page.on_message(up)
        server.on_message(down)

    def told(self, text: str) -> str:
        news: dict[str, Any] = json.loads(text)
        if "drones" in news:
            news["drones"] = self.drones(news["drones"])
        return json.dumps(
            {kind: self.news.get(kind, value) for kind, value in news.items()}
        )

    def tell(self, **news: Any) -> None:
        """Tell the page news, as its server would."""
        self.page.send(json.dumps(news))

    async def cut(self) -> None:
        await self.page.close()

    def of(self, ask: str) -> list[dict[str, Any]]:
        return [message for message in self.asked if message["ask"] == ask]


@contextlib.asynccontextmanager
async def browser(
    address: str,
    shots: Path,
    wire: Wire | None = None,
    strict: bool = True,
    **options: Any,
) -> AsyncIterator[Page]:
    """A page in the browser; its pictures are kept in a folder.  strict: without an error on its console."""
    async with async_playwright() as playwright:
        chromium = await playwright.chromium.launch(
            executable_path=CHROMIUM, args=FLAGS
        )
        page = await chromium.new_page(
            **{"viewport": {"width": 1400, "height": 900}, **options}
        )
        page.set_default_timeout(30_000)
        errors: list[str] = []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on(
            "console",
            lambda line: errors.append(line.text) if line.type == "error" else None,
        )
        page.on("requestfailed", lambda request: errors.append(request.url))
        page.on(
            "request",
            lambda request: (
                None if address[5:] in request.url else errors.append(request.url)
            ),
        )
        page.shot = lambda name: page.screenshot(path=shots / f"{name}.png")
        if wire is not None:
            await page.route_web_socket(re.compile("/line$"), wire.lay)
        await page.goto(address)
        await page.wait_for_function(
            "window.choir?.seen.received > 5 && choir.seen.drones.length"
        )
        yield page
        await chromium.close()
        assert (
            not strict
            or [error for error in errors if not error.startswith(("data:", "blob:"))]
            == []
        )


async def says(page: Page, region: str, text: str, seconds: float = 30.0) -> str:
    """What a region that is seen says, when it says so."""
    found = page.locator(f"{region}:visible", has_text=text)
    await found.wait_for(timeout=1000.0 * seconds)
    return await found.inner_text()


async def receipt(page: Page, text: str, seconds: float = 60.0) -> str:
    """The newest receipt, when it says so."""
    newest = "#receipts li >> nth=0"
    try:
        await page.wait_for_function(NEWEST, arg=text, timeout=1000 * seconds)
    except TimeoutError as error:
        raise AssertionError(await page.text_content(newest)) from error
    return await page.inner_text(newest)


NEWEST = "text => document.querySelector('#receipts li')?.textContent.includes(text)"


async def draw_word(page: Page) -> None:
    """`hi`, by mouse, in the middle of the canvas."""
    await page.evaluate(
        "document.querySelector('#panel-draw').scrollTop = 0; scrollTo(0, 0)"
    )
    box = await page.locator("#sketch").bounding_box()
    x0, y0 = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    h_line = [(-70, -50), (-70, 40)]
    h_arch = [(-70, 5), (-60, -12), (-45, -15), (-30, -5), (-28, 15), (-28, 40)]
    for stroke in (h_line, h_arch, [(20, -15), (20, 40)], [(20, -45), (23, -45)]):
        await page.mouse.move(x0 + stroke[0][0], y0 + stroke[0][1])
        await page.mouse.down()
        for x, y in stroke[1:]:
            await page.mouse.move(x0 + x, y0 + y, steps=8)
        await page.mouse.up()
