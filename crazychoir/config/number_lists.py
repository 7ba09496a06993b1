"""Lists of whole numbers as a user writes them: "3,5-7", or with a step "2-82:2"."""

import re

from crazychoir.errors import ConfigError

LAST_DRONE = 9999
"""Largest id of a drone."""
_LIST_PART = re.compile(r"\s*([0-9]+)\s*(?:-\s*([0-9]+)\s*(?::\s*([0-9]+)\s*)?)?")
"""One number, a range, or a range with a step."""
_MOST_DIGITS = 9
"""Most digits of a number; longer ones are larger than any limit."""


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

    where: name of the option, for errors
    allowed: description of the allowed values, for errors
    last: largest number
    ranges: True if "5-7" is allowed
    steps: True if "2-8:2" is allowed
    repeats: True if a number may occur twice

    Raises ConfigError if the text is no such list, a range goes down, or a number is above `last`.
    The end of a range is checked before it is counted through.
    """
    found: dict[int, None] = {}
    for word in text.split(","):
        match = _LIST_PART.fullmatch(word)
        if match is None or (match[2] and not ranges) or (match[3] and not steps):
            raise ConfigError(where, _shorten(text), allowed, _hint(text))
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
                where, _shorten(word.strip()), allowed, f"The largest number is {last}."
            )
        if step < 1:
            raise ConfigError(where, word.strip(), allowed, "A step is 1 or more.")
        if not repeats and any(first <= number <= end for number in found):
            raise ConfigError(
                where, _shorten(text), allowed, f"{word.strip()} is there already."
            )
        found |= dict.fromkeys(range(first, end + 1, step))
    return list(found)


def _hint(text: str) -> str:
    """Return a hint about a text that is no list, or an empty text."""
    if not text.strip():
        return "It names none."
    if any(not word.strip() for word in text.split(",")):
        return "There is a comma too many."
    if ";" in text or " " in text.strip():
        return "Write commas between them."
    return ""


def _number(digits: str) -> int:
    stripped = digits.lstrip("0") or "0"
    return int(stripped) if len(stripped) <= _MOST_DIGITS else 10**_MOST_DIGITS


def _shorten(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:60]}..."
