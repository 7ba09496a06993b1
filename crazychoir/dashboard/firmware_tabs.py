"""The tabs of the firmware of drones: the lines of its console, and its parameters."""

from typing import Any

from crazychoir.dashboard.layout import button, choice, lines, row, text


def build_console_tab(about: dict[str, Any]) -> None:
    """Build the tab with the lines of the consoles."""
    drones = {"": "all drones", **list_drone_options(about)}
    text(
        f"<h2>Console of the firmware</h2>{choice('console-drone', 'Lines of', drones)}"
        f"{lines('console', 'console')}"
    )


def build_parameters_tab(about: dict[str, Any]) -> None:
    """Build the tab in which the parameters of a drone are found, read and set."""
    text("<h2>Parameters of the firmware</h2>")
    with row():
        text(
            choice("parameter-drone", "Of", list_drone_options(about))
            + '<span class="field"><label for="parameter-filter">Filter</label>'
            '<input id="parameter-filter" type="search" placeholder="part of a name"></span>'
        )
        button("List again", "parameters.list()", "outline")
    text(
        '<p id="parameters-said" role="status"></p><div id="parameters" tabindex="0" '
        'role="region" aria-label="parameters"></div>'
    )


def list_drone_options(about: dict[str, Any]) -> dict[str, str]:
    """Return the drones of a list to choose from: the text of each by its id."""
    return {i: f"drone {name}" for i, name in about["names"].items()}
