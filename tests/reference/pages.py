"""Which generated part stands in which README, and how it is written there."""

from collections.abc import Callable
from pathlib import Path

from reference import command_lines, flight_modes, safety_rules, swarm_file, topics

BEGIN = "<!-- generated: begin -->"
END = "<!-- generated: end -->"
SOURCES: dict[str, tuple[Callable[[], str], ...]] = {
    "crazychoir/bus/README.md": (topics.table,),
    "crazychoir/cli/README.md": (command_lines.index, command_lines.pages),
    "crazychoir/safety/README.md": (safety_rules.table, flight_modes.table),
    "deploy/REFERENCE.md": (swarm_file.tables,),
}
"""{page: the functions that return its generated parts, in the order of the page}."""


def with_parts(text: str, parts: list[str]) -> str:
    """Return a page with its generated parts replaced.

    text: the page; each part stands between BEGIN and END
    parts: the new text of each part, in the order of the page
    Raises ValueError unless the page has as many marked places as there are parts.
    """
    pieces = text.split(f"{BEGIN}\n")
    if len(pieces) != len(parts) + 1 or any(END not in piece for piece in pieces[1:]):
        raise ValueError(
            f"a page with {len(parts)} generated parts, each from {BEGIN} to {END}"
        )
    page = pieces[0]
    for piece, part in zip(pieces[1:], parts, strict=True):
        page += f"{BEGIN}\n{part}\n{END}{piece.split(END, 1)[1]}"
    return page


def generated(repository: Path, page: str) -> str:
    """Return the text that a page must have now."""
    text = (repository / page).read_text()
    return with_parts(text, [part() for part in SOURCES[page]])
