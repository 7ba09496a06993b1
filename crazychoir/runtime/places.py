"""Where processes of one user leave word for each other."""

import os
import tempfile
from pathlib import Path


def runtime_folder() -> Path | None:
    """This user's alone; None if there can be no such place."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    folder = Path(runtime) / "crazychoir" if runtime else Path(tempfile.gettempdir()) / f"crazychoir-{os.getuid()}"
    try:
        folder.mkdir(mode=0o700, exist_ok=True)
        return folder if folder.stat().st_uid == os.getuid() and os.access(folder, os.W_OK) else None
    except OSError:
        return None
