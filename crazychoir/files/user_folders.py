"""Folders of the user who runs this process: for caches, and for what processes of one user leave for each other.

A service, a container or a cron job may run without a home, with a home that is read-only or another user's, on a full
disk, or as a user whom the system does not know. Every function here has an answer for these cases and raises nothing.
"""

import os
import stat
import sys
import uuid
from pathlib import Path

RUNTIME_VARIABLE = "CRAZYCHOIR_RUNTIME_DIR"
"""Environment variable that names another private folder; it must be the same in every shell of the user."""
SHARED_FOLDER = "/tmp"  # noqa: S108 - the private folder below it is checked: its owner, its mode, no symbolic link
"""Where private folders lie. Not TMPDIR or XDG_RUNTIME_DIR: a login shell, cron and sudo set these differently."""
PROBE_SIZE = 1 << 16  # bytes that a folder must have room for
PRIVATE_MODE = 0o700  # permissions of the private folder
WARNING = "cache: "
"""How each warning about a cache begins. A run passes on the first one of its processes about each cache."""
TOLD_VARIABLE = "CRAZYCHOIR_TOLD"
"""Environment variable with the names of the caches about which this process, or its parent, has warned."""


def home() -> Path | None:
    """Return the home of this user, or None if HOME is not set and the system does not know the user."""
    named = os.environ.get("HOME", "")
    if named:
        return Path(named) if os.path.isabs(named) else None
    try:
        return Path.home()
    except RuntimeError:
        return None


def cache_home() -> Path | None:
    """Return the folder for caches of this user, or None if there is none; another user's cache is not used.

    XDG_CACHE_HOME, else ~/.cache. Under `sudo` the home may be that of another user: what lies there could be changed
    by that user, and what root writes there could not be changed by its owner.
    """
    named = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(named):
        folder = Path(named)
    else:
        own = home()
        if own is None:
            return None
        folder = own / ".cache"
    return folder if _is_own_or_roots(folder) else None


def _is_own_or_roots(folder: Path) -> bool:
    """Return whether the folder, or the nearest one above it that exists, belongs to this user or to root."""
    if sys.platform == "win32":
        return True
    for place in (folder, *folder.parents):
        try:
            return place.stat().st_uid in (0, os.getuid())
        except FileNotFoundError:
            continue
        except OSError:
            return False
    return False


def write_fault(folder: Path) -> str:
    """Return why nothing can be written into the folder; it is made if it is missing. Empty if all is well.

    A full disk often still takes an empty file, so a file of PROBE_SIZE is written, and removed.
    """
    probe = folder / f".probe.{uuid.uuid4().hex[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            probe.write_bytes(bytes(PROBE_SIZE))
        finally:
            probe.unlink(missing_ok=True)
    except OSError as error:
        return error.strerror or str(error)
    return ""


def private_folder() -> Path:
    """Return the path of the private folder of this user: the same in every environment of the user on this machine."""
    named = os.environ.get(RUNTIME_VARIABLE, "")
    return Path(named) if os.path.isabs(named) else private_folder_of(os.getuid())


def private_folder_of(uid: int) -> Path:
    """Return the path of the private folder of a user."""
    return Path(SHARED_FOLDER) / f"crazychoir-{uid}"


def owner_fault(folder: Path, uid: int) -> str:
    """Return why a folder is not the private folder of this user; empty if it is. Raises OSError if it is not there."""
    found = folder.lstat()
    if stat.S_ISLNK(found.st_mode):
        return "it is a symbolic link"
    if not stat.S_ISDIR(found.st_mode):
        return "it is no folder"
    if found.st_uid != uid:
        return f"it belongs to {user_name(found.st_uid)}"
    return ""


def make_private(folder: Path) -> str:
    """Make the private folder of this user if it is missing; return why it is not safe to use, empty if it is.

    Raises OSError if it cannot be made.
    """
    try:
        folder.mkdir(mode=PRIVATE_MODE)
    except FileExistsError:
        fault = owner_fault(folder, os.getuid())
        if fault:
            return fault
        mode = stat.S_IMODE(folder.lstat().st_mode)
        if mode == PRIVATE_MODE:
            return ""
        if folder != private_folder_of(
            os.getuid()
        ):  # a folder that was named, such as /tmp
            return f"others may use it, as its mode is {mode:o}"
        folder.chmod(PRIVATE_MODE)
    return ""


def user_name(uid: int) -> str:
    """Return how to call a user: by name and number, or by number where the system does not know the user."""
    try:
        import pwd

        return f"user {pwd.getpwuid(uid).pw_name} ({uid})"
    except (ImportError, KeyError):
        return f"user {uid}"


def first_warning(cache: str) -> bool:
    """Return whether a warning about this cache is the first, of this process and of those that have started it.

    The environment keeps that one was given, so that processes that this one starts do not repeat it.
    """
    told = os.environ.get(TOLD_VARIABLE, "").split(",")
    if cache in told:
        return False
    os.environ[TOLD_VARIABLE] = ",".join(filter(None, [*told, cache]))
    return True


def prepare_matplotlib() -> None:
    """Give matplotlib a folder for its list of fonts where its own choice cannot be written.

    Without it every process warns, leaves a temporary folder behind, and lists all fonts anew.
    """
    if os.environ.get("MPLCONFIGDIR") or sys.platform == "win32":
        return
    own = home()
    configuration = os.environ.get("XDG_CONFIG_HOME") or (own and own / ".config")
    cache = os.environ.get("XDG_CACHE_HOME") or (own and own / ".cache")
    if all(
        place and _may_write(Path(place) / "matplotlib")
        for place in (configuration, cache)
    ):
        return
    folder = private_folder()
    try:
        fault = make_private(folder) or write_fault(folder / "matplotlib")
    except OSError:  # matplotlib looks for a temporary folder itself
        return
    if not fault:
        os.environ["MPLCONFIGDIR"] = str(folder / "matplotlib")


def _may_write(folder: Path) -> bool:
    """Return whether this user may write into the folder, or may make it."""
    for place in (folder, *folder.parents):
        if os.path.exists(place):  # Path.exists raises PermissionError
            return place.is_dir() and os.access(place, os.W_OK)
    return False
