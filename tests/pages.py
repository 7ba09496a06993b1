"""The pages of the documentation, and the parts of them that tests read."""

import re
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
ROOMS = (
    "routing",
    "optimization",
    "safety",
    "radio",
    "mocap",
    "simulation",
    "control",
    "recording",
    "dashboard",
    "bridges",
    "bus",
    "team",
    "flight",
    "guidance",
    "cli",
)
FRONT_PAGE = "README.md"
PAGES = (
    FRONT_PAGE,
    "CONTRIBUTING.md",
    "crazychoir/README.md",
    "agents/README.md",
    "deploy/README.md",
    *(f"crazychoir/{room}/README.md" for room in ROOMS),
)
"""The front page, the page for contributors, and the page of each folder that a user or maintainer enters."""


def page(file: str) -> str:
    """Return the text of a page.

    file: its path in the repository.
    """
    return (REPOSITORY / file).read_text()


def block(file: str, mark: str) -> str:
    """Return the fenced block directly below the line `<!-- mark -->` of a page."""
    found = re.search(
        rf"<!-- {re.escape(mark)} -->\n```\w*\n(.*?)```", page(file), re.DOTALL
    )
    assert found is not None, f"{file} has no fenced block below <!-- {mark} -->"
    return found[1]


def rows(file: str, head: str) -> list[str]:
    """Return the rows of a page's table with `head` as its first column."""
    assert f"\n| {head} |" in page(file), f"{file} has no table | {head} |"
    text = page(file).split(f"\n| {head} |")[1]
    return text.split("\n\n")[0].splitlines()[2:]


def first_column(file: str, head: str) -> list[str]:
    """Return what stands in backticks in the first column of the table that begins with `head`."""
    cells = [row.split(" | ")[0] for row in rows(file, head)]
    return re.findall(r"`([^`]+)`", " ".join(cells))


def printed(file: str, command: str) -> dict[str, str]:
    """Return the rows that a page shows below a command, {figure: text}."""
    found = re.search(rf"\n\$ {re.escape(command)}\n(.*?)\n```", page(file), re.DOTALL)
    assert found is not None, f"{file} does not show {command}"
    return dict(
        line.split(None, 1)
        for line in found[1].splitlines()
        if not line.endswith(": success")
    )
