"""Drones as a user chooses them: by their ids, and by their names in the swarm file."""

import re
from dataclasses import dataclass
from difflib import get_close_matches
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
        from crazychoir.team.graph import describe_ids

        id_by_name = {drone.name: drone.id for drone in config.drones if drone.name}
        found: dict[int, None] = {}
        for word in self.words:
            if isinstance(word, str) and word not in id_by_name:
                names = ", ".join(id_by_name) or "no names"
                near = get_close_matches(word, id_by_name, n=1)
                advice = f"Did you mean {near[0]}?" if near else ""
                allowed = f"{names}, or the ids {describe_ids(config.ids)}"
                raise ConfigError(self.option, word, allowed, advice)
            i = id_by_name[word] if isinstance(word, str) else word
            if i not in config.ids:
                raise ConfigError(self.option, f"drone {i}", describe_ids(config.ids))
            found[i] = None
        return list(found)


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
