"""Drones as a user chooses them: by their ids, and by their names in the swarm file."""

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from crazychoir.errors import ConfigError

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig

CHOICE_FORM = "drones with commas between, as 3,5-7 or by their names"
"""Form of a choice, for errors."""
_NAME_PART = re.compile(
    r"\s*([A-Za-z_][A-Za-z0-9_.-]*|[0-9]+[A-Za-z_.][A-Za-z0-9_.-]*)\s*"
)
"""A name of a drone that cannot be an id or a range of ids."""


@dataclass(frozen=True)
class DroneChoice:
    """Drones that an option names; the swarm that they belong to may not be known yet."""

    option: str
    """Name of the option, for errors."""
    words: tuple[int | str, ...]
    """Ids and names, in the order of the text."""

    def find(self, config: "SwarmConfig") -> list[int]:
        """Return the ids of the drones, each once.

        Raises ConfigError for an id or a name that the swarm does not have.
        """
        return config.find_drones(self.words, self.option)


def parse_choice(text: str, option: str) -> DroneChoice:
    """Return the drones of a text such as "3,5-7,cf231".

    A number is an id, also if a drone has it as its name.

    Raises ConfigError for another form.
    """
    from crazychoir.config.number_lists import parse_spans

    words: list[int | str] = []
    for part in text.split(","):
        name = _NAME_PART.fullmatch(part)
        if name is not None:
            words.append(name[1])
            continue
        try:
            words += parse_spans(part, option, CHOICE_FORM)
        except ConfigError:
            parse_spans(text, option, CHOICE_FORM)  # its error shows the whole text
            raise
    return DroneChoice(option, tuple(dict.fromkeys(words)))


def parse_single_drone(text: str, option: str) -> DroneChoice:
    """Return the one drone of a text, an id or a name.

    Raises ConfigError for another form.
    """
    choice = parse_choice(text, option)
    if len(choice.words) != 1:
        raise ConfigError(option, text, "one drone, by its id or its name")
    return choice


def parse_one_drone(text: str | None, option: str) -> DroneChoice | None:
    """Return the one drone of a text, an id or a name; None without a text.

    Raises ConfigError for another form.
    """
    return None if text is None else parse_single_drone(text, option)


def parse_drone_word(text: str | None) -> int | str | None:
    """Return the id or the name that --drone gives; None without a text.

    Raises ConfigError for another form.
    """
    choice = parse_one_drone(text, "--drone")
    return None if choice is None else choice.words[0]
