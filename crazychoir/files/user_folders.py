"""Folders of this process's user: caches, and files that processes leave for each other.

A service, a container or a cron job may run without a home, with a home that is read-only or
belongs to another user, on a full disk, or as a user unknown to the system. Every function here
handles these cases; a function that may raise an error says so.
"""

import os
import stat
import sys
import uuid
from dataclasses import dataclass
from pathlib import Path

RUNTIME_VARIABLE = "CRAZYCHOIR_RUNTIME_DIR"
"""Environment variable that names another private folder.

It must be the same in every shell of the user.
"""
SHARED_FOLDER = "/tmp"  # noqa: S108 - the private folder below it is checked: its owner, its mode, no symbolic link
"""The folder that holds the private folders.

It is not TMPDIR or XDG_RUNTIME_DIR: a login shell, cron and sudo set these to different folders.
"""


@dataclass(frozen=True, slots=True)
class FolderRequirements:
    """Room and permissions that the folders of a user need."""

    probe_size: int = 1 << 16
    """Bytes for which a folder must have room."""
    private_mode: int = 0o700
    """Permissions of the private folder."""
    others_mask: int = 0o077
    """Permissions of the group and of all others."""


FOLDER_REQUIREMENTS = FolderRequirements()


CACHE_WARNING = "cache: "
"""Start of every warning about a cache.

A run prints only the first warning of its processes about each cache.
"""
TOLD_VARIABLE = "CRAZYCHOIR_TOLD"
"""Environment variable with the caches about which this process, or its parent, has warned."""


def user_home() -> Path | None:
    """Return the home of this user.

    Returns None if HOME is not set and the system does not know the user.
    """
    named = os.environ.get("HOME", "")
    if named:
        return Path(named) if os.path.isabs(named) else None
    try:
        return Path.home()
    except RuntimeError:
        return None


def cache_home() -> Path | None:
    """Return the cache folder of this user, or None if there is none.

    It is XDG_CACHE_HOME, else ~/.cache. A folder of another user is not used, as root may find it
    under `sudo`: its owner could change the files of root, and could not replace them when needed.
    """
    named = os.environ.get("XDG_CACHE_HOME", "")
    if os.path.isabs(named):
        folder = Path(named)
    else:
        own = user_home()
        if own is None:
            return None
        folder = own / ".cache"
    return folder if _is_own_or_roots(folder) else None


def _is_own_or_roots(folder: Path) -> bool:
    """Return whether a folder belongs to this user or to root.

    If it does not exist, the nearest existing folder above it counts.
    """
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
    """Return why nothing can be written into a folder, or an empty text.

    The folder is made if it is missing. A full disk often still accepts an empty file, so a file of
    FOLDER_REQUIREMENTS.probe_size bytes is written and removed.
    """
    probe = folder / f".probe.{uuid.uuid4().hex[:16]}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            probe.write_bytes(bytes(FOLDER_REQUIREMENTS.probe_size))
        finally:
            probe.unlink(missing_ok=True)
    except OSError as error:
        return error.strerror or str(error)
    return ""


def private_folder() -> Path:
    """Return the path of this user's private folder.

    It is the same in every environment of the user on this machine.
    """
    named = os.environ.get(RUNTIME_VARIABLE, "")
    return Path(named) if os.path.isabs(named) else private_folder_of(os.getuid())


def private_folder_of(uid: int) -> Path:
    """Return the path of the private folder of a user."""
    return Path(SHARED_FOLDER) / f"crazychoir-{uid}"


def owner_fault(folder: Path, uid: int) -> str:
    """Return why the folder is not the private folder of this user, or an empty text if it is.

    Raises OSError if the folder does not exist.
    """
    found = folder.lstat()
    if stat.S_ISLNK(found.st_mode):
        return "it is a symbolic link"
    if not stat.S_ISDIR(found.st_mode):
        return "it is no folder"
    if found.st_uid != uid:
        return f"it belongs to {user_name(found.st_uid)}"
    return ""


def make_private(folder: Path) -> str:
    """Make the private folder of this user if it is missing.

    Returns why it is unsafe, or an empty text.
    Raises OSError if it cannot be made.
    """
    try:
        folder.mkdir(mode=FOLDER_REQUIREMENTS.private_mode)
    except FileExistsError:
        fault = owner_fault(folder, os.getuid())
        if fault:
            return fault
        mode = stat.S_IMODE(folder.lstat().st_mode)
        if not mode & FOLDER_REQUIREMENTS.others_mask:
            return ""
        if folder != private_folder_of(
            os.getuid()
        ):  # a folder that was named, such as /tmp
            return f"others may use it, as its mode is {mode:o}"
        folder.chmod(FOLDER_REQUIREMENTS.private_mode)
    return ""


def user_name(uid: int) -> str:
    """Return a text for a user: name and number.

    It is only the number if the system does not know the user.
    """
    try:
        import pwd

        return f"user {pwd.getpwuid(uid).pw_name} ({uid})"
    except (ImportError, KeyError):
        return f"user {uid}"


def first_warning(cache: str) -> bool:
    """Note a warning about this cache; return whether it is the first.

    A warning of this process or of one of its parents counts. The note is kept in the environment,
    so that child processes do not repeat the warning.
    """
    told = os.environ.get(TOLD_VARIABLE, "").split(",")
    if cache in told:
        return False
    os.environ[TOLD_VARIABLE] = ",".join(filter(None, [*told, cache]))
    return True


def prepare_matplotlib() -> None:
    """Give matplotlib a folder for its list of fonts if its own folder cannot be written.

    Without such a folder every process warns, leaves a temporary folder behind, and lists all fonts
    again.
    """
    if os.environ.get("MPLCONFIGDIR") or sys.platform == "win32":
        return
    own = user_home()
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
    except OSError:  # matplotlib then finds a temporary folder itself
        return
    if not fault:
        os.environ["MPLCONFIGDIR"] = str(folder / "matplotlib")


def _may_write(folder: Path) -> bool:
    """Return whether this user may write into the folder, or may make it."""
    for place in (folder, *folder.parents):
        if os.path.exists(place):  # Path.exists raises PermissionError
            return place.is_dir() and os.access(place, os.W_OK)
    return False
