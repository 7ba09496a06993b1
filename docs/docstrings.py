"""Docstrings as Markdown, for the pages of the API.

The docstrings of crazychoir are plain text: equations are indented, arguments stand one a line, and
`Returns`, `Raises` and `Source` begin a line. Characters that mean something in Markdown mean
themselves.
"""

import re
from collections.abc import Iterator
from inspect import cleandoc
from typing import Any

import griffe

ARGUMENT = re.compile(r"([A-Za-z_]\w*'?(?:, [A-Za-z_]\w*'?)*): (.*)", re.DOTALL)
SENTENCE = re.compile(r"(Returns|Raises|Yields|Source:|With |Without |Else )")
ITEM = re.compile(r"[-*] |\d+\. ")
DRAWN = re.compile("[│├└─]")
CODE = re.compile(r"(`[^`]+`)")
SPECIAL = re.compile(r"([\\*_<>\[\]#~|{}$])")


def as_markdown(text: str) -> str:
    """Return a docstring as Markdown."""
    return "\n\n".join(
        block
        for part in re.split(r"\n\s*\n", cleandoc(text))
        for block in _blocks(part)
    )


def _blocks(part: str) -> Iterator[str]:
    """Yield the blocks of a part of a docstring that has no empty line."""
    lines = part.splitlines()
    if part.startswith(" ") or any(DRAWN.search(line) for line in lines):
        yield _literal(lines)
        return
    if part.startswith(">>> "):
        yield f"```pycon\n{part}\n```"
        return
    items: list[str] = []
    for piece in _pieces(lines):
        argument = ARGUMENT.fullmatch(piece)
        item = ITEM.match(piece)
        if argument and not SENTENCE.match(piece):
            items.append(f"- `{argument[1]}`: {_escaped(argument[2])}")
        elif item:
            items.append(f"- {_escaped(piece[item.end() :])}")
        else:
            if items:
                yield "\n".join(items)
                items = []
            yield _escaped(piece)
    if items:
        yield "\n".join(items)


def _pieces(lines: list[str]) -> Iterator[str]:
    """Yield the sentences and arguments of a paragraph, each on one line."""
    piece = ""
    for line in lines:
        starts = not line.startswith(" ") and bool(
            ARGUMENT.fullmatch(line) or SENTENCE.match(line) or ITEM.match(line)
        )
        if starts and piece:
            yield piece
            piece = ""
        piece = f"{piece} {line.strip()}".strip()
    if piece:
        yield piece


def _literal(lines: list[str]) -> str:
    """Return lines that keep their layout, such as an equation."""
    indent = min(len(line) - len(line.lstrip()) for line in lines)
    body = "\n".join(line[indent:] for line in lines)
    return f"```text\n{body}\n```"


def _escaped(text: str) -> str:
    """Return plain text in which only code between backticks is marked."""
    return "".join(
        part if CODE.fullmatch(part) else SPECIAL.sub(r"\\\1", part)
        for part in CODE.split(text)
    )


class PlainDocstrings(griffe.Extension):
    """Turn each docstring into Markdown as griffe reads it."""

    def on_instance(self, *, obj: griffe.Object, **_: Any) -> None:
        """Replace the docstring of an object."""
        if obj.docstring is not None:
            obj.docstring.value = as_markdown(obj.docstring.value)
