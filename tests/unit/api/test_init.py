"""The names of the Python interface: imported when they are used, and known to type checkers."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

from crazychoir import api


@pytest.mark.parametrize("name", api.__all__)
def test_every_name_is_there(name):
    assert getattr(api, name).__name__ == name
    assert name in dir(api)


def test_no_module_has_a_public_name_which_its_import_would_replace():
    folder = Path(api.__file__).parent
    assert not {path.stem for path in folder.iterdir()} & set(api.__all__)


def test_a_name_that_is_none():
    with pytest.raises(AttributeError, match="no attribute 'Nothing'"):
        api.Nothing  # noqa: B018


def test_type_checkers_see_the_same_names():
    tree = ast.parse(Path(api.__file__).read_text())
    blocks = [node for node in tree.body if isinstance(node, ast.If)]
    for_checkers = next(
        node for node in blocks if ast.unparse(node.test) == "TYPE_CHECKING"
    )
    seen = {
        alias.name: node.module for node in for_checkers.body for alias in node.names
    }
    assert seen == {name: getattr(api, name).__module__ for name in api.__all__}


def test_the_import_of_the_interface_alone_loads_no_numbers():
    program = "import sys, crazychoir.api; print('numpy' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True
    )
    assert done.stdout.strip() == "False"
