"""The page: its layout, and the request behind each button. The rest is in static/."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import nicegui
from nicegui import ui

from crazychoir.dashboard import drawing_tab
from crazychoir.dashboard.firmware_tabs import (
    build_console_tab,
    build_parameters_tab,
    list_drone_options,
)
from crazychoir.dashboard.layout import (
    button,
    card,
    choice,
    field,
    hint,
    lines,
    panel,
    row,
    tabs,
    text,
)

THREE_JS_FOLDER = Path(nicegui.__file__).parent / "elements" / "scene" / "dist"
"""Folder of NiceGUI's own three.js."""
COMMAND_LABELS = {
    "arm": "Arm",
    "take-off": "Take off",
    "start": "Start",
    "hold": "Hold",
    "go": "Go on",
    "land": "Land",
    "home": "Fly home",
}
"""Labels of the buttons, by command."""


STICK_HELP = (
    "Choose one drone, and click into the frame. Arrow keys move it along x and y, "
    "Page Up and Page Down up and down; Home and End turn it. On a gamepad, hold a "
    "shoulder button and move the sticks. The drone stops at each release."
)
"""Help for flights by hand."""
FIRST_TAB = "fly"
"""Tab that is shown when the page opens."""
STICK_SPEED = 0.5  # m/s, at first, of flights by hand


@dataclass(frozen=True, slots=True)
class Tab:
    """A tab of the page."""

    label: str
    """Its label."""
    hint: str
    """What an operator does in it, shown until it is dismissed."""
    build: Callable[[], None]
    """Adds its content."""


@dataclass(frozen=True, slots=True)
class PageHtml:
    """Fixed parts of the page in HTML."""

    head: str = """<link rel="stylesheet" href="/own/page.css"><script type="module">
import { start } from "/own/page.js"; start();</script>"""
    """The style sheet and the program."""
    notices: str = """<p id="kept" role="alert" hidden><span id="kept-said"></span>
<button id="kept-send" hidden>Send it
now</button> <button id="kept-withdraw">Withdraw</button></p><p id="stopped" role="alert"></p>
<p id="trouble" role="alert"></p><p id="newest" role="status"></p>"""
    """Places of the notices above the commands."""
    clear_dialog: str = """<dialog id="clear" aria-labelledby="clear-what"><form method="dialog">
<p id="clear-what">Is the
emergency stop to end? Space still stops all.</p><button value="no" autofocus>Cancel</button>
<button value="yes">End it</button></form></dialog>"""
    """Dialog before an emergency stop is cleared."""
    link_legend: str = """<p class="help legend">
Links: <em>simulated</em> loss from green, 0 %, to red, 67 %; grey where an end
is not heard.</p>"""
    """Legend of the links in the scene."""


PAGE_HTML = PageHtml()


class Page:
    """The page, the same for all browsers; about: the result of SwarmModel.about."""

    def __init__(self, about: dict[str, Any]) -> None:
        self.about = about
        self.swarm = str(about["swarm"])
        self.tabs = {
            "fly": Tab(
                "Fly",
                "Choose drones in the table below; without a choice a command is for all. "
                "The space key stops all motors at any time.",
                self._fly,
            ),
            "draw": Tab(
                "Draw",
                drawing_tab.DRAWING_TAB.hint,
                partial(drawing_tab.build_drawing_tab, about),
            ),
            "tasks": Tab(
                "Tasks",
                "Tick the box, and click on the floor of the room to add a task while "
                "the drones fly.",
                _build_tasks,
            ),
            "network": Tab(
                "Network",
                "Move a slider, and press Apply, to see how the swarm flies with losses "
                "and delays.",
                _build_network,
            ),
            "plots": Tab(
                "Plots",
                "Curves begin when you open the page. Choose drones in the table to see "
                "theirs alone.",
                self._plots,
            ),
            "log": Tab(
                "Log",
                "Commands, changes of state and warnings of all drones, the newest first.",
                _build_log,
            ),
            "console": Tab(
                "Console",
                "Lines that the firmware has printed since the server of this page started. "
                "Simulated drones have no firmware; those with a uri have.",
                partial(build_console_tab, about),
            ),
            "parameters": Tab(
                "Parameters",
                "Open a group to read its values. A new value takes effect at once, also "
                "in flight, and is read back.",
                partial(build_parameters_tab, about),
            ),
        }

    def build(self) -> None:
        """Build the page of one browser."""
        ui.add_body_html(PAGE_HTML.head)
        ui.colors(primary="#0b5cad", positive="#1a7f37", negative="#c0182b")
        self._top()
        with ui.element("div").classes("board"):
            with card("view", "view of the room"):
                text(f'<div id="scene"></div>{PAGE_HTML.link_legend}')
            with card("side", "controls"):
                tabs({name: tab.label for name, tab in self.tabs.items()})
                for name, tab in self.tabs.items():
                    with panel(name, is_shown=name == FIRST_TAB):
                        hint(name, tab.hint)
                        tab.build()
            with card("all", "drones"):
                text('<table id="drones"></table>')

    def _top(self) -> None:
        with ui.element("header").classes("top"):
            text(
                f"<h1>{escape(self.swarm)} · {escape(Path(str(self.about['mission'])).stem)}</h1>"
            )
            text('<span id="connection" role="status">connecting</span>')
            ui.element("span").classes("gap")
            button("Light or dark", "turn()", "flat dense")
            button("Clear stop", "clearStop()", "outline")
            button("STOP ALL (space)", "stopAll()", color="negative").classes("stop")
            text(PAGE_HTML.clear_dialog)
            text(PAGE_HTML.notices).classes("said")

    def _fly(self) -> None:
        text('<h2>Commands <span id="chosen" role="status"></span></h2>')
        with row():
            for verb, label in COMMAND_LABELS.items():
                button(label, f"order('{verb}')")
            button("Motors off", "stopChosen()", "outline", color="negative")
        text("<h3>Go to a place</h3>")
        with row():
            text(
                field("goal_x", "Place x", 0, "m", step=0.1)
                + field("goal_y", "Place y", 0, "m", step=0.1)
                + field("goal_z", "Place z", self.about["height"], "m", step=0.1)
                + field("apart_y", "Offset y from drone to drone", 0.5, "m", step=0.1)
            )
            button("Go there", "goTo()")
            text(
                '<span class="field"><label for="pick">A click on the floor says where</label>'
                '<input id="pick" type="checkbox"></span>'
            )
        self._stick()
        text('<h3>Receipts</h3><ul id="receipts" class="lines"></ul>')

    def _stick(self) -> None:
        fast = self.about["speed_limit"]
        text(
            f'<h3>Fly by hand</h3><p class="help" id="stick-help">{STICK_HELP}</p>'
            '<div id="stick" tabindex="0" role="application" aria-label="Fly by hand" '
            'aria-describedby="stick-help"><span id="stick-said" role="status"></span></div>'
        )
        with row():
            speed = field(
                "stick_speed",
                "Speed",
                min(STICK_SPEED, fast),
                "m/s",
                step=0.1,
                min=0.1,
                max=fast,
            )
            text(speed)

    def _plots(self) -> None:
        ids = list_drone_options(self.about)
        text(
            '<h2>Batteries and links of the drones</h2><div id="swarm-plots"></div>'
            f'<h2>One drone</h2>{choice("plotted", "Of", ids)}<div id="plots"></div>'
        )


def _build_tasks() -> None:
    text('<h2>Tasks</h2><p id="tasks-said" role="status"></p>')
    with row():
        text(
            '<span class="field"><label for="placing">Clicks on the floor: pickup, then delivery</label>'
            '<input id="placing" type="checkbox"></span>'
            + choice(
                "task_kind",
                "A task is",
                {"two": "pickup and delivery", "one": "done at one place"},
            )
            + field("pickup_x", "Pickup x", 0, "m", step=0.1)
            + field("pickup_y", "Pickup y", 0, "m", step=0.1)
            + field("delivery_x", "Delivery x", 1, "m", step=0.1)
            + field("delivery_y", "Delivery y", 1, "m", step=0.1)
            + field("load", "Load", 1, "", min=0, step=0.5)
        )
        button("Add task", "tasks.add()")
    text('<ul id="tasks" class="lines"></ul>')


def _build_network() -> None:
    text(
        '<h2>Simulated network</h2><p class="help">None chosen: all links. One drone: its links. Two: the link '
        'between them.</p><p>In force: <span id="network-said">not known yet</span></p>'
    )
    with row():
        text(
            field("loss", "Loss", 0, "%", "range", min=0, max=100, step=1)
            + field("delay", "Delay", 0, "ms", "range", min=0, max=500, step=5)
        )
        button("Apply", "network.apply()")
    with row():
        button("Cut the chosen off", "network.cut()", "outline")
        button("Take everything back", "network.clear()", "outline")


def _build_log() -> None:
    levels = choice(
        "level", "From level", {name: name for name in ("info", "warning", "error")}
    )
    text(f"<h2>Log</h2>{levels}{lines('log', 'log')}")
