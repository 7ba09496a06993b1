"""Rules that no linter knows: where time is read, and that nothing iterates over a set.

Both look at syntax trees, and both are best effort: they find the ways in which the mistake is usually made.
"""

import ast
from collections.abc import Iterator
from dataclasses import dataclass, field

from syntax_trees import syntax_tree

# Reading the wall clock and sleeping: crazychoir/runtime/clock.py alone, so that virtual time governs everything.
CLOCKS = frozenset(
    {
        "asyncio.sleep",
        "datetime.date.today",
        "datetime.datetime.now",
        "datetime.datetime.today",
        "datetime.datetime.utcnow",
        "time.clock_gettime",
        "time.clock_gettime_ns",
        "time.monotonic",
        "time.monotonic_ns",
        "time.time",
        "time.time_ns",
    }
)
# Measuring what code costs: the clock and the command lines. Elsewhere a measured duration could steer a result.
STOPWATCHES = frozenset(
    {
        "time.perf_counter",
        "time.perf_counter_ns",
        "time.process_time",
        "time.process_time_ns",
    }
)

SET_TYPES = ("set", "frozenset", "AbstractSet", "Set", "MutableSet")
SET_METHODS = ("union", "intersection", "difference", "symmetric_difference")
TAKES_IN_ORDER = (
    "list",
    "tuple",
    "iter",
    "enumerate",
    "zip",
    "map",
    "filter",
    "reversed",
    "next",
    "sum",
)
SET_OPERATORS = (ast.BitOr, ast.BitAnd, ast.Sub, ast.BitXor)


def forbidden_clocks(source: str, banned: frozenset[str]) -> list[str]:
    """`line: name` of each use of a banned function, however it was imported."""
    tree = syntax_tree(source)
    names = _imported_names(tree)
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            found += [
                f"{node.lineno}: {name}"
                for name in _from_imports(node)
                if name in banned
            ]
        elif (
            isinstance(node, ast.Attribute) and (name := _dotted(node, names)) in banned
        ):
            found.append(f"{node.lineno}: {name}")
    return found


def _imported_names(tree: ast.AST) -> dict[str, str]:
    """Local name -> dotted name of what was imported."""
    names: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {
                a.asname: a.name for a in node.names if a.asname
            }  # others keep their name
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {a.asname or a.name: f"{node.module}.{a.name}" for a in node.names}
    return names


def _from_imports(node: ast.ImportFrom) -> list[str]:
    return [f"{node.module}.{alias.name}" for alias in node.names]


def _dotted(node: ast.expr, names: dict[str, str]) -> str:
    if isinstance(node, ast.Attribute):
        return f"{_dotted(node.value, names)}.{node.attr}"
    return names.get(node.id, node.id) if isinstance(node, ast.Name) else ""


def set_iterations(source: str) -> list[str]:
    """`line: expression` of each place that takes the elements of a set in their order, which is the hash order."""
    tree = syntax_tree(source)
    sets = _Sets()
    for _ in range(
        2
    ):  # a name may be assigned from a name that is found to be a set later in the file
        for node in ast.walk(tree):
            sets.learn(node)
    found = [
        e for node in ast.walk(tree) for e in _taken_in_order(node) if sets.holds(e)
    ]
    return [
        f"{e.lineno}: {ast.unparse(e)}"
        for e in sorted(found, key=lambda e: (e.lineno, e.col_offset))
    ]


@dataclass
class _Sets:
    """The names and attributes of one file that hold sets, by annotation or by assignment."""

    names: set[str] = field(default_factory=set)

    def learn(self, node: ast.AST) -> None:
        if isinstance(node, ast.AnnAssign) and _is_set_type(node.annotation):
            self.names.add(ast.unparse(node.target))
            self.names.add(f"self.{ast.unparse(node.target)}")  # a field of a class
        elif (
            isinstance(node, ast.arg)
            and node.annotation
            and _is_set_type(node.annotation)
        ):
            self.names.add(node.arg)
        elif isinstance(node, ast.Assign) and self.holds(node.value):
            self.names |= {ast.unparse(target) for target in node.targets}
        elif isinstance(node, ast.NamedExpr) and self.holds(node.value):
            self.names.add(node.target.id)

    def holds(self, e: ast.expr) -> bool:
        """Whether the expression is a set, as far as this file tells."""
        match e:
            case ast.Set() | ast.SetComp():
                return True
            case ast.Call(func=ast.Name(id="set" | "frozenset")):
                return True
            case ast.Call(func=ast.Attribute(value=value, attr=attr)) if (
                attr in SET_METHODS
            ):
                return True
            case ast.Call(func=ast.Attribute(value=value, attr="copy")):
                return self.holds(value)
            case ast.BinOp(left=left, op=op, right=right) if isinstance(
                op, SET_OPERATORS
            ):
                return any(self.holds(side) or _is_keys(side) for side in (left, right))
            case ast.IfExp(body=body, orelse=orelse):
                return self.holds(body) or self.holds(orelse)
            case ast.Name() | ast.Attribute():
                return ast.unparse(e) in self.names
        return False


def _is_set_type(annotation: ast.expr) -> bool:
    outer = annotation.value if isinstance(annotation, ast.Subscript) else annotation
    return ast.unparse(outer).rpartition(".")[2] in SET_TYPES


def _is_keys(e: ast.expr) -> bool:
    """`d.keys()`: a dictionary view is in order, but its differences and unions are sets."""
    return (
        isinstance(e, ast.Call)
        and isinstance(e.func, ast.Attribute)
        and e.func.attr in ("keys", "items")
    )


def _taken_in_order(node: ast.AST) -> Iterator[ast.expr]:
    """Yield each expression that `node` reads element by element; the order does not matter from a set into a set."""
    match node:
        case ast.For(iter=e) | ast.AsyncFor(iter=e) | ast.YieldFrom(value=e):
            yield e
        case (
            ast.ListComp(generators=parts)
            | ast.GeneratorExp(generators=parts)
            | ast.DictComp(generators=parts)
        ):
            yield from (part.iter for part in parts)
        case ast.List(elts=parts) | ast.Tuple(elts=parts) | ast.Call(args=parts) if any(
            map(_is_starred, parts)
        ):
            yield from (part.value for part in parts if isinstance(part, ast.Starred))
        case ast.Call(func=ast.Name(id=name), args=args) if name in TAKES_IN_ORDER:
            yield from args
        case ast.Call(
            func=ast.Attribute(attr="join" | "extend" | "fromkeys"), args=args
        ):
            yield from args
        case ast.Call(func=ast.Attribute(value=e, attr="pop"), args=[]):
            yield e
        case ast.Assign(targets=[ast.Tuple() | ast.List()], value=e):
            yield e


def _is_starred(e: ast.expr) -> bool:
    return isinstance(e, ast.Starred)
