"""Rules for the JavaScript of the operator's page: comments, names of constants, declarations."""

import re
from collections.abc import Iterator

from prose_rules import hard_words

# Comments; and strings, because a string may look like a comment.
TOKENS = re.compile(
    r"(?P<comment>//[^\n]*|/\*.*?\*/)"
    r'|"(?:[^"\\\n]|\\.)*"'
    r"|'(?:[^'\\\n]|\\.)*'"
    r"|`(?:[^`\\]|\\.)*`",
    re.DOTALL,
)
DECLARATION = re.compile(r"\b(?:const|let|var)\s+(?=[\w$\[{])")
NAME = re.compile(r"[\w$]+")
OPENING = "([{"
CLOSING = ")]}"


def comments(source: str) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of every comment; comments on successive lines are one text."""
    start = 0
    last = -1
    text = ""
    for token in TOKENS.finditer(source):
        if token["comment"] is None:
            continue
        line = source.count("\n", 0, token.start()) + 1
        own_line = not source[: token.start()].rpartition("\n")[2].strip()
        words = token["comment"].strip("/* ")
        if own_line and line == last + 1:
            text = f"{text} {words}"
        else:
            if text:
                yield start, text
            start = line
            text = words
        last = line if own_line else -1
    if text:
        yield start, text


def hard_comments(source: str) -> list[str]:
    """Return `line: word` of each comment that has a word that is hard to read."""
    found = []
    for line, text in comments(source):
        words = hard_words(text)
        if words:
            found.append(f"{line}: {words}")
    return found


def declarations(source: str) -> Iterator[tuple[int, list[str]]]:
    """Yield the line of each declaration and the names, or the patterns, that it declares."""
    code = TOKENS.sub(lambda token: _blank(token[0]), source)
    for found in DECLARATION.finditer(code):
        line = code.count("\n", 0, found.start()) + 1
        yield line, [_declared(part) for part in _parts(code[found.end() :])]


def _blank(token: str) -> str:
    """Return a token with its line breaks, and with spaces in place of all other characters."""
    return re.sub(r"[^\n]", " ", token)


def _parts(code: str) -> list[str]:
    """Return the declarators at the beginning of a text, up to the end of their statement."""
    depth = 0
    parts = [""]
    for character in code:
        if character in CLOSING:
            depth -= 1
        if depth < 0 or (depth == 0 and character == ";"):
            break
        if depth == 0 and character == ",":
            parts.append("")
        else:
            parts[-1] += character
        if character in OPENING:
            depth += 1
    return parts


def _declared(part: str) -> str:
    name = NAME.match(part.strip())
    return name[0] if name else part.partition("=")[0].strip()


def packed_declarations(source: str) -> list[str]:
    """Return `line: names` of each declaration of several variables."""
    return [
        f"{line}: {', '.join(names)}"
        for line, names in declarations(source)
        if len(names) > 1
    ]


def one_word_script_constants(source: str) -> list[str]:
    """Return `line: name` of each upper-case constant of one word."""
    return [
        f"{line}: {name}"
        for line, names in declarations(source)
        for name in names
        if re.fullmatch(r"[A-Z][A-Z0-9]+", name)
    ]
