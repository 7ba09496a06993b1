"""Syntax trees of sources, which several rules look at."""

import ast
from functools import cache


@cache
def syntax_tree(source: str) -> ast.Module:
    """Return the tree of a source, which is parsed once; no rule changes a tree.

    `syntax_tree.cache_clear()` frees the trees: those of the whole package take 200 MB.
    """
    return ast.parse(source)
