"""Import a Python file of the user, and say where it is wrong."""

import importlib.util
import sys
import traceback
from pathlib import Path
from types import ModuleType

from crazychoir.errors import ConfigError, Hung, error_text, refuse_exit
from crazychoir.runtime.user_code_guard import USER_CODE_TIMES, limit_duration


def import_from_file(path: Path, kind: str, named_by: str = "") -> ModuleType:
    """Return the module of a user's .py file.

    kind: what errors call the file, such as "mission".
    named_by: what names the file, for errors; empty for `kind`
    Raises ConfigError if the file cannot be imported.
    """
    if not path.is_file():
        raise ConfigError(named_by or kind, str(path), "a Python file that exists")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise ConfigError(kind, str(path), "a Python file")
    module = importlib.util.module_from_spec(spec)
    _allow_neighbor_imports(path)
    try:
        with (
            limit_duration(USER_CODE_TIMES.hook_limit, f"the import of {path}"),
            refuse_exit(f"the {kind} file"),
        ):
            spec.loader.exec_module(module)
    except Exception as error:
        if isinstance(error.__cause__, SystemExit):
            raise
        lines = [
            at.lineno
            for at in traceback.extract_tb(error.__traceback__)
            if at.filename == spec.origin
        ]
        where = f"{kind} {path}{f':{lines[-1]}' if lines else ''}"
        hangs = isinstance(error, Hung)
        found = (
            f"no end within {USER_CODE_TIMES.hook_limit:g} s of its import"
            if hangs
            else error_text(error)
        )
        raise ConfigError(
            where, found, "a file that Python can import", "Correct it."
        ) from error
    return module


def _allow_neighbor_imports(path: Path) -> None:
    """Let a mission file import the files beside it, as a script may.

    Installed modules of the same name come first. The folder stays in the import path, because a
    mission may import during the flight.
    """
    folder = str(path.resolve().parent)
    if folder not in sys.path:
        sys.path.append(folder)
