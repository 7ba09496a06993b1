"""The drawing tab: canvas, pen, limits, the planned flight, and the drones that fly it."""

from dataclasses import dataclass
from typing import Any

from crazychoir.dashboard.layout import button, choice, field, row, text


@dataclass(frozen=True, slots=True)
class DrawingTabDefaults:
    """The texts of the drawing tab, and the default height of a drawing."""

    hint: str = (
        "Draw, in one stroke or several; straight flights join them. Thin is what was drawn, "
        "thick what the drones fly that you choose in the table."
    )
    """Hint of the tab."""
    file_help: str = "A trajectory of Crazyswarm (CSV) starts at the height above."
    """Help for files."""
    height_above_hover: float = 0.7
    """m: default height of a drawing above drones that hover where they took off."""
    distance_below_fence: float = 0.3
    """m: a drawing's default height is at least this far below the top of the fence."""


DRAWING_TAB = DrawingTabDefaults()


def build_drawing_tab(about: dict[str, Any]) -> None:
    """Build the whole tab."""
    v_max = about["speed_limit"]
    a_max = about["acceleration_limit"]
    height = round(
        min(
            about["height"] + DRAWING_TAB.height_above_hover,
            about["fence"][1][2] - DRAWING_TAB.distance_below_fence,
        ),
        2,
    )
    text(
        '<canvas id="sketch" role="img" '
        'aria-label="Drawing of a path, x to the right, y up; a file can be loaded instead"></canvas>'
    )
    with row():
        button("Fly it with the chosen drones", "sketch.fly()", color="positive")
        button("Undo stroke", "sketch.undo()", "outline")
        button("Clear", "sketch.clear()", "outline")
    text(
        '<p id="plan" role="status">Nothing is drawn.</p><canvas id="profile" role="img" '
        'aria-label="Speed and acceleration on the way"></canvas>'
    )
    text("<h2>How it is flown</h2>")
    with row():
        text(
            field("height", "Height", height, "m", step=0.1)
            + field("lift", "Lift between strokes", 0, "m", min=0, max=5, step=0.1)
            + choice(
                "yaw",
                "Looks",
                {"0": "along x", "along": "along the path", "1.5708": "along y"},
            )
            + choice(
                "timing",
                "Timing",
                {"even": "as fast as limits allow", "drawn": "as it was drawn"},
            )
            + field(
                "smoothing", "Smoothing", 0.02, "m", "range", min=0, max=0.1, step=0.005
            )
            + field(
                "v_max",
                "Speed limit",
                min(0.5, v_max),
                "m/s",
                "range",
                min=0.05,
                max=v_max,
                step=0.05,
            )
            + field(
                "a_max",
                "Acceleration limit",
                min(1.0, a_max),
                "m/s²",
                "range",
                min=0.1,
                max=a_max,
                step=0.1,
            )
            + field("slower", "Times as long", 1, "", "range", min=1, max=10, step=0.1)
            + field("offset_x", "Offset x from drone to drone", 0, "m", step=0.1)
            + field("offset_y", "Offset y", 0.5, "m", step=0.1)
            + field("offset_z", "Offset z", 0, "m", step=0.1)
        )
    text("<h2>The drawing</h2>")
    with row():
        text(field("area", "Shown", 4, "m", "range", min=1, max=20, step=1))
        button("Save CSV", "sketch.save('csv')", "outline")
        button("Save SVG", "sketch.save('svg')", "outline")
        text(
            '<span class="field"><label for="file">Load CSV or SVG</label>'
            '<input id="file" type="file" accept=".csv,.svg"></span>'
        )
    text(f'<p class="help">{DRAWING_TAB.file_help}</p>')
