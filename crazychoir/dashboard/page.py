"""The page: what is where, and which button asks for what. The rest is in static/."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import nicegui
from nicegui import ui

from crazychoir.dashboard.asks import Message, Order, Stop
from crazychoir.dashboard.operator import Operator
from crazychoir.dashboard.watch import Watch
from crazychoir.errors import CrazyChoirError

THREE = Path(nicegui.__file__).parent / "elements" / "scene" / "dist"
"""The folder of NiceGUI's own three.js."""
VERBS = {
    "take-off": "Take off", "start": "Start", "hold": "Hold", "go": "Go on", "land": "Land", "home": "Fly home",
}  # fmt: skip
TABS = {"fly": "Fly", "log": "Log"}
HEAD = """<link rel="stylesheet" href="/own/page.css"><script type="module">
import { start } from "/own/page.js"; start();</script>"""


class Pages:
    """Makes a page for each browser that comes."""

    def __init__(self, swarm: str, operator: Callable[[], Operator], watch: Watch) -> None:
        self.swarm, self.operator, self.watch = swarm, operator, watch

    def build(self) -> None:
        """One page."""
        Page(self.swarm, self.operator(), self.watch).build()


class Page:
    """One browser's page: its widgets, and the drones that it has chosen."""

    def __init__(self, swarm: str, operator: Operator, watch: Watch) -> None:
        self.swarm, self.operator, self.watch = swarm, operator, watch
        self.drones: tuple[int, ...] | None = None

    def build(self) -> None:
        """Everything."""
        ui.add_body_html(HEAD)
        ui.on("selected", self._select)
        self._top()
        with ui.element("main").classes("board"):
            with ui.element("section").classes("card view").props('aria-label="view of the room"'):
                ui.html('<div id="scene"></div>', sanitize=False)
            with ui.element("section").classes("card side").props('aria-label="controls"'):
                self._tabs()
                with _panel("fly"):
                    self._fly()
                with _panel("log"):
                    self._log()
            with ui.element("section").classes("card all").props('aria-label="drones"'):
                ui.html('<table id="drones"></table>', sanitize=False)

    def _select(self, event: Any) -> None:
        ids = event.args if isinstance(event.args, list) else None
        self.drones = tuple(i for i in ids or () if isinstance(i, int)) or None

    async def ask(self, message: Message) -> None:
        """Do it, or say why not."""
        try:
            await self.operator.asked(message)
        except CrazyChoirError as error:
            self.watch.add(f"not done: {error}", "warning")
            ui.notify(str(error), type="negative")

    def _top(self) -> None:
        with ui.element("header").classes("top"):
            ui.html(f"<h1>{self.swarm} · crazychoir</h1>", sanitize=False)
            ui.html('<span id="connection" role="status">connecting</span>', sanitize=False)
            ui.element("span").classes("gap")
            theme = ui.button("Light or dark").props("flat dense no-caps")
            theme.on("click", js_handler="() => Quasar.Dark.toggle()")
            ui.button("Clear stop", on_click=lambda: self.ask(Stop(clear=True))).props("outline no-caps")
            stop = ui.button("STOP ALL (space)", color="negative").props("no-caps").classes("stop")
            stop.on("click", js_handler="() => window.choir.stopAll()")

    def _tabs(self) -> None:
        buttons = "".join(
            f'<button role="tab" id="tab-{name}" aria-controls="panel-{name}">{text}</button>'
            for name, text in TABS.items()
        )
        ui.html(f'<div class="tabs" role="tablist" aria-label="controls">{buttons}</div>', sanitize=False)

    def _fly(self) -> None:
        ui.html('<h2>Commands <span id="chosen"></span></h2>', sanitize=False)
        with ui.element("div").classes("row"):
            for verb, text in VERBS.items():
                ui.button(text, on_click=partial(self._order, verb)).props("no-caps").mark(verb)
            ui.button("Motors off", color="negative", on_click=self._stop).props("no-caps outline")
        ui.html('<h3>Receipts</h3><ul id="receipts" class="lines" aria-live="polite"></ul>', sanitize=False)

    async def _order(self, verb: str) -> None:
        await self.ask(Order(verb, self.drones))  # type: ignore[arg-type]  # a key of VERBS

    async def _stop(self) -> None:
        await self.ask(Stop(self.drones))

    def _log(self) -> None:
        ui.html(
            '<h2>Log</h2><label>from level <select id="level"><option>info</option><option>warning</option>'
            '<option>error</option></select></label><ul id="log" class="lines" role="log"></ul>', sanitize=False,
        )  # fmt: skip


def _panel(name: str) -> ui.element:
    return ui.element("div").classes("panel").props(
        f'id="panel-{name}" role="tabpanel" aria-labelledby="tab-{name}" tabindex="0"'
    )  # fmt: skip

