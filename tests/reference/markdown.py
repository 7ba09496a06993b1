"""Tables in Markdown, and the docstrings of attributes."""

import ast
import inspect
from collections.abc import Iterable, Sequence
from types import ModuleType


def one_line(text: str) -> str:
    """Return a text on one line, with the bars escaped that would end a cell."""
    return " ".join(text.split()).replace("|", "\\|")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(one_line, line))} |" for line in lines)


def attribute_docs(node: ModuleType | type) -> dict[str, str]:
    """Return the docstring below each attribute of a module or a class, by name."""
    (body,) = (
        [ast.parse(inspect.getsource(node))]
        if inspect.ismodule(node)
        else ast.parse(inspect.getsource(node)).body
    )
    found = {}
    for attribute, below in zip(body.body, body.body[1:], strict=False):
        names = (
            attribute.targets
            if isinstance(attribute, ast.Assign)
            else [attribute.target]
            if isinstance(attribute, ast.AnnAssign)
            else []
        )
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            for name in names:
                if isinstance(name, ast.Name):
                    found[name.id] = str(below.value.value)
    return found
