"""Words that make a text hard to read for an engineer with another first language than English."""

import ast
import re
from collections.abc import Iterator

from syntax_trees import syntax_tree

# Pronouns for people: things are not people, and the reader must guess what is meant.
PEOPLE = re.compile(
    r"\b(who|whom|whose|whoever|nobody|somebody|anybody|himself|his)\b", re.IGNORECASE
)
# Forms that point at something without naming it.
POINTERS = re.compile(
    r"\b(one that|those that|that which|of who|the former|the latter|of whom|of which)\b",
    re.IGNORECASE,
)

# A plain sentence begins with its subject.
BEGINNINGS = re.compile(r"(of|that|the same|as|so)\b")


def hard_words(text: str) -> str | None:
    """Return the first words of a text that make it hard to read; None if there are none."""
    found = PEOPLE.search(text) or POINTERS.search(text)
    return found[0] if found else None


def docstrings(source: str) -> Iterator[tuple[int, str]]:
    """Yield the line and the text of every docstring, those of attributes included."""
    for node in ast.walk(syntax_tree(source)):
        body = getattr(node, "body", None)
        for statement in body if isinstance(body, list) else []:
            if not isinstance(statement, ast.Expr):
                continue
            value = statement.value
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield statement.lineno, value.value


def hard_docstrings(source: str) -> list[str]:
    """Return `line: word` of each docstring that has such a word."""
    found = []
    for line, text in docstrings(source):
        words = hard_words(text)
        if words:
            found.append(f"{line}: {words}")
    return found


def hard_test_names(source: str) -> list[str]:
    """Return `line: name` of each test with a name that is no plain sentence."""
    found = []
    for node in ast.walk(syntax_tree(source)):
        if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        if not node.name.startswith("test_"):
            continue
        sentence = node.name.removeprefix("test_").replace("_", " ")
        if hard_words(sentence) or BEGINNINGS.match(sentence):
            found.append(f"{node.lineno}: {node.name}")
    return found


# Not prose: code, and what `make reference` writes from the code.
NOT_PROSE = re.compile(
    r"^```.*?^```|`[^`\n]*`|<!-- generated: begin -->.*?<!-- generated: end -->",
    re.DOTALL | re.MULTILINE,
)


def hard_lines(page: str) -> list[str]:
    """Return `line: word` of each line of a Markdown page that has such a word."""
    prose = NOT_PROSE.sub(lambda code: "\n" * code[0].count("\n"), page)
    found = []
    for line, text in enumerate(prose.splitlines(), start=1):
        words = hard_words(text)
        if words:
            found.append(f"{line}: {words}")
    return found
