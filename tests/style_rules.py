"""Rules of style that no linter knows: sizes of classes, arguments, constants, assignments, conditions, class names."""

import ast
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path

from syntax_trees import syntax_tree

MOST_CLASS_LINES = 300
MOST_CLASS_METHODS = 30
MOST_CLASS_ATTRIBUTES = 20
MOST_ARGUMENTS = 7
MOST_TUPLE_VALUES = 2

Functions = ast.FunctionDef | ast.AsyncFunctionDef


def large_classes(source: str) -> Iterator[tuple[str, str]]:
    """Yield the name and the size of each class that is too large for one responsibility."""
    for node in ast.walk(syntax_tree(source)):
        if not isinstance(node, ast.ClassDef):
            continue
        lines = (node.end_lineno or node.lineno) - node.lineno + 1
        methods = sum(isinstance(part, Functions) for part in node.body)
        attributes = len(_own_attributes(node))
        if (
            lines > MOST_CLASS_LINES
            or methods > MOST_CLASS_METHODS
            or attributes > MOST_CLASS_ATTRIBUTES
        ):
            yield (
                node.name,
                f"{lines} lines, {methods} methods, {attributes} attributes",
            )


def _own_attributes(node: ast.ClassDef) -> set[str]:
    """Return the attributes that a class sets on itself, and its annotated fields."""
    found = set()
    for part in ast.walk(node):
        if (
            isinstance(part, ast.Attribute)
            and isinstance(part.ctx, ast.Store)
            and isinstance(part.value, ast.Name)
            and part.value.id == "self"
        ):
            found.add(part.attr)
    for part in node.body:
        if isinstance(part, ast.AnnAssign) and isinstance(part.target, ast.Name):
            found.add(part.target.id)
    return found


def wide_functions(source: str) -> Iterator[tuple[str, int]]:
    """Yield the name and the number of arguments of each function that has too many.

    Compiled functions are excepted, because numba takes no parameter objects, and so are the
    functions behind a command line, because each argument is an option.
    """
    for owner, node in _functions(syntax_tree(source)):
        arguments = node.args
        count = len(
            [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs]
        ) - bool(owner and not _is_static(node))
        if count > MOST_ARGUMENTS and not _is_compiled(node) and not _is_command(node):
            yield f"{owner}.{node.name}" if owner else node.name, count


def _functions(tree: ast.AST, owner: str = "") -> Iterator[tuple[str, Functions]]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, Functions):
            yield owner, node
        inside = node.name if isinstance(node, ast.ClassDef) else ""
        yield from _functions(node, inside)


def _decorators(node: Functions) -> str:
    return " ".join(ast.unparse(decorator) for decorator in node.decorator_list)


def _is_static(node: Functions) -> bool:
    return "staticmethod" in _decorators(node)


def _is_compiled(node: Functions) -> bool:
    return "kernel" in _decorators(node) or "njit" in _decorators(node)


def _is_command(node: Functions) -> bool:
    """Return whether the arguments are options of a command line."""
    every = [*node.args.args, *node.args.kwonlyargs]
    return any("typer" in ast.unparse(argument) for argument in every)


def constants(source: str) -> Iterator[str]:
    """Yield the names of the module's constants."""
    for node in syntax_tree(source).body:
        for target in _targets(node):
            for name in ast.walk(target):
                if isinstance(name, ast.Name) and name.id.lstrip("_").isupper():
                    yield name.id


def _targets(node: ast.stmt) -> list[ast.expr]:
    if isinstance(node, ast.Assign):
        return node.targets
    return [node.target] if isinstance(node, ast.AnnAssign) else []


def one_word_constants(source: str) -> list[str]:
    """Return the constants of one word; type variables have one letter."""
    return [
        name
        for name in constants(source)
        if "_" not in name.strip("_") and len(name.strip("_")) > 1
    ]


def packed_assignments(source: str) -> Iterator[str]:
    """Yield the lines that set several constants, or more than two independent values."""
    tree = syntax_tree(source)
    for node in ast.walk(tree):
        if not isinstance(node, ast.Assign) or not isinstance(
            node.targets[0], ast.Tuple
        ):
            continue
        count = len(node.targets[0].elts)
        names = [ast.unparse(name) for name in node.targets[0].elts]
        # Values that a function returns together are unpacked.
        unpacked = isinstance(node.value, ast.Call) and not _counts(node.value)
        constants = sum(name.lstrip("_").isupper() for name in names)
        several = node in tree.body and constants > 1 and not unpacked
        independent = isinstance(node.value, ast.Tuple) and count > MOST_TUPLE_VALUES
        if several or independent:
            yield f"{node.lineno}: {', '.join(names)}"


def _counts(call: ast.Call) -> bool:
    return ast.unparse(call.func) in ("range", "itertools.count", "count")


def nested_conditions(source: str) -> list[str]:
    """Return the lines of the conditional expressions that contain another one."""
    return [
        f"{node.lineno}: {ast.unparse(node)}"
        for node in ast.walk(syntax_tree(source))
        if isinstance(node, ast.IfExp)
        and sum(isinstance(part, ast.IfExp) for part in ast.walk(node)) > 1
    ]


def shared_class_names(files: Iterable[Path]) -> dict[str, list[str]]:
    """Return the names that several classes have, with their files."""
    found = defaultdict(list)
    for file in files:
        for node in ast.walk(syntax_tree(file.read_text())):
            if isinstance(node, ast.ClassDef):
                found[node.name].append(str(file))
    return {name: places for name, places in found.items() if len(places) > 1}
