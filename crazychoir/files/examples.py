"""The swarm files that come with the package, by name: the files of deploy/."""

import re
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

from crazychoir.errors import ConfigError

EXAMPLES_FOLDER = Path(__file__).parents[1] / "examples"
"""Folder with the swarm files; in a clone a link to deploy/."""
DATA_REFERENCE = re.compile(r"\.\./agents/data/([\w.-]+)")
"""How a swarm file names a file of the missions' data."""
DATA_FOLDER = Path(__file__).parents[1] / "agents" / "data"
"""Folder with the files that swarm files name."""


@dataclass(frozen=True, slots=True)
class ExampleCopy:
    """A file of an example, as it is written into a folder of the user."""

    name: str
    """Name of the file."""
    text: str
    """Its text."""


def list_examples() -> dict[str, str]:
    """Return the summary of each example by its name: the first sentence of its file."""
    return {
        file.stem: _summarise(file.read_text(encoding="utf-8"))
        for file in sorted(EXAMPLES_FOLDER.glob("*.toml"))
    }


def find_example(name: str) -> Path | None:
    """Return the swarm file of the example of this name; None if there is none."""
    file = EXAMPLES_FOLDER / f"{name}.toml"
    return file if Path(name).name == name and file.is_file() else None


def require_example(name: str) -> Path:
    """Return the swarm file of the example of this name.

    Raises ConfigError if there is none.
    """
    file = find_example(name)
    if file is None:
        names = list(list_examples())
        raise ConfigError("example", name, ", ".join(names), suggest_name(name, names))
    return file


def describe_shipped_file(name: str) -> str:
    """Return where the file of this name is that comes with the missions; empty if there is none."""
    file = DATA_FOLDER / name
    return f"This file comes with the package: {file}." if file.is_file() else ""


def suggest_name(name: str, names: list[str]) -> str:
    """Return a question for the name that was meant; empty if none is near."""
    near = get_close_matches(name, names, n=1)
    return f"Did you mean {near[0]}?" if near else ""


def list_copies(file: Path) -> list[ExampleCopy]:
    """Return the files of an example as a user's folder gets them, all beside each other."""
    text = file.read_text(encoding="utf-8")
    data = dict.fromkeys(DATA_REFERENCE.findall(text))
    return [
        ExampleCopy(file.name, DATA_REFERENCE.sub(r"\1", text)),
        *(
            ExampleCopy(name, (DATA_FOLDER / name).read_text(encoding="utf-8"))
            for name in data
        ),
    ]


def _summarise(text: str) -> str:
    """Return the first sentence of the comment at the top of a swarm file, without its command."""
    comment = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        comment.append(line.lstrip("# "))
    sentence = re.split(r"(?<=\.)\s|: crazychoir ", " ".join(comment))[0]
    return sentence.rstrip(".:")
