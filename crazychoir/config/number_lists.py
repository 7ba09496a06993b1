"""Lists of whole numbers as a user writes them: "3,5-7", or with a step "2-82:2"."""

import re

from crazychoir.errors import ConfigError

LAST_DRONE = 9999
"""The largest id that a drone may have."""
_PART = re.compile(r"\s*([0-9]+)\s*(?:-\s*([0-9]+)\s*(?::\s*([0-9]+)\s*)?)?")
_LONGEST = 9
"""Digits of a number; longer ones are larger than whatever is allowed."""


def parse_spans(
    text: str,
    where: str,
    allowed: str,
    last: int = LAST_DRONE,
    ranges: bool = True,
    steps: bool = False,
    repeats: bool = True,
) -> list[int]:
    """Return the numbers of a text such as "3,5-7", each once, in the order of the text.

    where: names the option in errors;  allowed: what an error says is allowed;  last: the largest number;  ranges,
    steps: whether "5-7" and "2-8:2" may stand there;  repeats: whether a number may be there twice.
    Errors: ConfigError for what is no such list, a range that goes down, or a number above `last`; no range is counted
    through before it is known to end there.
    """
    found: dict[int, None] = {}
    for word in text.split(","):
        match = _PART.fullmatch(word)
        if match is None or (match[2] and not ranges) or (match[3] and not steps):
            raise ConfigError(where, _shown(text), allowed, _hint(text))
        first = _number(match[1])
        end = first if match[2] is None else _number(match[2])
        step = 1 if match[3] is None else _number(match[3])
        if end < first:
            raise ConfigError(
                where,
                word.strip(),
                allowed,
                f"Write the lower one first: {end}-{first}.",
            )
        if end > last:
            raise ConfigError(
                where, _shown(word.strip()), allowed, f"The largest number is {last}."
            )
        if step < 1:
            raise ConfigError(where, word.strip(), allowed, "A step is 1 or more.")
        if not repeats and any(first <= number <= end for number in found):
            raise ConfigError(
                where, _shown(text), allowed, f"{word.strip()} is there already."
            )
        found |= dict.fromkeys(range(first, end + 1, step))
    return list(found)


def _hint(text: str) -> str:
    """Return what is wrong in a text that is no list."""
    if not text.strip():
        return "It names none."
    if any(not word.strip() for word in text.split(",")):
        return "There is a comma too many."
    if ";" in text or " " in text.strip():
        return "Write commas between them."
    return ""


def _number(digits: str) -> int:
    stripped = digits.lstrip("0") or "0"
    return int(stripped) if len(stripped) <= _LONGEST else 10**_LONGEST


def _shown(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:60]}..."
