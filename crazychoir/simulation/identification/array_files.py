"""Files .npz of a recorded flight."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from crazychoir.errors import ConfigError
from crazychoir.files.text_files import describe_unreadable


def read_array_file(path: Path, allowed: str) -> dict[str, Any]:
    """Return the arrays of a file .npz by their names.

    allowed: what the file should have, for errors
    Raises ConfigError for a file that cannot be read, or is no .npz.
    """
    try:
        loaded = np.load(path, allow_pickle=False)
        if isinstance(loaded, np.lib.npyio.NpzFile):
            with loaded:
                return dict(loaded)
        found = "one array"
    except OSError as error:
        found = describe_unreadable(error)
    except (ValueError, EOFError, zipfile.BadZipFile):
        found = "no arrays"
    raise ConfigError(str(path), found, allowed)
