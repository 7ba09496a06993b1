"""Elements of the page: labelled fields, buttons, panels of tabs."""

import contextlib
from collections.abc import Iterator
from html import escape
from typing import Any

from nicegui import ui


def text(html: str) -> Any:
    """Add trusted HTML; in a row, each of its elements is an element of the row."""
    return ui.html(html, sanitize=False).classes("loose")


def field(
    name: str,
    label: str,
    value: float | str,
    unit: str = "",
    kind: str = "number",
    **more: float,
) -> str:
    """Return an input with its label as HTML; a range also shows its value."""
    limits = " ".join(f'{key}="{number:g}"' for key, number in more.items())
    shown = f'<output for="{name}"></output>' if kind == "range" else ""
    unit = f" ({unit})" if unit else ""
    return (
        f'<span class="field"><label for="{name}">{escape(label)}{escape(unit)}</label>'
        f'<input id="{name}" type="{kind}" value="{value}" {limits}>{shown}</span>'
    )


def choice(name: str, label: str, options: dict[str, str]) -> str:
    """Return a list of options with its label as HTML."""
    rows = "".join(
        f'<option value="{value}">{escape(shown)}</option>'
        for value, shown in options.items()
    )
    return f'<span class="field"><label for="{name}">{escape(label)}</label><select id="{name}">{rows}</select></span>'


def lines(name: str, label: str) -> str:
    """Return a list of lines as HTML; a screen reader tells the new ones."""
    return f'<div role="log" aria-label="{label}"><ul id="{name}" class="lines"></ul></div>'


def button(label: str, action: str, look: str = "", **more: Any) -> Any:
    """Add a button that calls a function of static/page.js."""
    made = ui.button(label, **more).props(f'no-caps {look} data-action="{action}"')
    made.on("click", js_handler=f"() => window.choir.{action}")
    return made


@contextlib.contextmanager
def row() -> Iterator[None]:
    """Place the content side by side, as far as there is room."""
    with ui.element("div").classes("row"):
        yield


@contextlib.contextmanager
def card(kind: str, label: str) -> Iterator[None]:
    """Place the content in a region of the page."""
    with ui.element("section").classes(f"card {kind}").props(f'aria-label="{label}"'):
        yield


@contextlib.contextmanager
def panel(name: str, is_shown: bool) -> Iterator[None]:
    """Place the content in the panel of the tab `name`; `is_shown`: when the page opens."""
    props = (
        f'id="panel-{name}" role="tabpanel" aria-labelledby="tab-{name}" tabindex="0"'
        f"{'' if is_shown else ' hidden'}"
    )
    with ui.element("div").classes("panel").props(props):
        yield


def hint(name: str, words: str) -> None:
    """Add the hint of the tab `name`; static/hints.js shows it until it is dismissed."""
    text(
        f'<p class="hint" data-hint="{name}" hidden>{escape(words)} '
        '<button type="button">Got it</button></p>'
    )


def tabs(names: dict[str, str]) -> None:
    """Add the tabs, by the names of their panels."""
    buttons = "".join(
        f'<button role="tab" id="tab-{name}" aria-controls="panel-{name}">{label}</button>'
        for name, label in names.items()
    )
    text(f'<div class="tabs" role="tablist" aria-label="controls">{buttons}</div>')
