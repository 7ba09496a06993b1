"""The table of flight modes in safety/README.md, from safety/rules/modes.py."""

from crazychoir.safety.rules.modes import MODE_TABLE, Mode, ModeEvent
from reference.markdown import table as markdown_table


def table() -> str:
    """Return a row for each event, a column for each mode: the next mode, or "-" if refused."""
    rows = []
    for event in ModeEvent:
        cells = [MODE_TABLE[mode][event] for mode in Mode]
        rows.append(
            [
                f"`{event.value}`",
                *(c.value if isinstance(c, Mode) else "-" for c in cells),
            ]
        )
    return markdown_table(["event", *(f"*{mode.value}*" for mode in Mode)], rows)
