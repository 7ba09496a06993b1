"""What the extra `tables` brings: pandas and pyarrow, imported when they are used."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from crazychoir.errors import ConfigError


def import_pandas() -> Any:
    """Return the module pandas.

    Raises ConfigError, with the command that installs it, if it is missing.
    """
    with _naming_extra("pandas"):
        import pandas
    return pandas


def import_parquet() -> tuple[Any, Any]:
    """Return the modules pyarrow and pyarrow.parquet.

    Raises ConfigError, with the command that installs them, if they are missing.
    """
    with _naming_extra("pyarrow"):
        import pyarrow
        import pyarrow.parquet
    return pyarrow, pyarrow.parquet


@contextmanager
def _naming_extra(module: str) -> Iterator[None]:
    """Raise ConfigError in place of an ImportError."""
    try:
        yield
    except ImportError as error:
        do = "pip install 'crazychoir[tables]'"
        allowed = "the extra tables, installed on this machine"
        raise ConfigError("table", f"no module {module}", allowed, do) from error
