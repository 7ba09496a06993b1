"""Write files of a user that do not exist yet: `crazychoir new` and `crazychoir examples --copy`."""

from collections.abc import Mapping
from pathlib import Path

from crazychoir.errors import ConfigError


def write_new_files(folder: Path, texts: Mapping[str, str]) -> list[Path]:
    """Write texts by file name into a folder, all or none; return the paths.

    Raises ConfigError if one of the files exists, or the folder cannot be written.
    """
    paths = [folder / name for name in texts]
    for path in paths:
        if path.exists():
            raise ConfigError(
                str(path),
                "a file of this name",
                "a new file",
                "Nothing was written. Choose another name or folder.",
            )
    for path, text in zip(paths, texts.values(), strict=True):
        try:
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise ConfigError(
                str(path), error.strerror or str(error), "a file that can be written"
            ) from error
    return paths
