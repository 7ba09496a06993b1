"""Folders of a user: without a home, with a read-only one, on a full disk, and where another user was first."""

import errno
import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest
from other_user import as_user, homeless, open_folder, require

from crazychoir.errors import ConfigError
from crazychoir.files import user_folders
from crazychoir.files.private_folder import runtime_folder
from crazychoir.files.user_folders import (
    cache_home,
    first_warning,
    make_private,
    private_folder,
    private_folder_of,
    user_home,
    user_name,
    write_fault,
)


@pytest.fixture(autouse=True)
def own_environment(monkeypatch, tmp_path):
    for name in ("XDG_CACHE_HOME", "CRAZYCHOIR_RUNTIME_DIR", "CRAZYCHOIR_TOLD"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))


def no_home():
    raise RuntimeError("Could not determine home directory.")


def test_a_user_unknown_to_the_system_has_no_home_and_no_cache(monkeypatch):
    monkeypatch.delenv("HOME")
    monkeypatch.setattr(Path, "home", no_home)
    assert user_home() is None
    assert cache_home() is None


@pytest.mark.parametrize("value", ["relative", "~", "."])
def test_a_home_that_depends_on_the_working_folder_is_none(monkeypatch, value):
    monkeypatch.setenv("HOME", value)
    assert user_home() is None


def test_an_empty_home_is_looked_up(monkeypatch):
    monkeypatch.setenv("HOME", "")
    monkeypatch.setattr(Path, "home", lambda: Path("/home/anna"))
    assert user_home() == Path("/home/anna")


def test_the_cache_is_where_the_user_says_else_in_the_home(monkeypatch, tmp_path):
    assert cache_home() == tmp_path / ".cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "caches"))
    assert cache_home() == tmp_path / "caches"
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert cache_home() == tmp_path / ".cache"


def test_the_cache_of_another_user_is_not_used(monkeypatch, tmp_path):
    """`sudo` may keep HOME: root would run what that user wrote there."""
    require("true")
    (tmp_path / ".cache").mkdir()
    os.chown(tmp_path / ".cache", 12345, 12345)
    assert cache_home() is None


def test_a_fault_of_writing_is_told_and_nothing_is_left(tmp_path, monkeypatch):
    assert write_fault(tmp_path / "new" / "folder") == ""
    assert list((tmp_path / "new" / "folder").iterdir()) == []
    (tmp_path / "file").write_text("")
    assert write_fault(tmp_path / "file") != ""
    assert write_fault(tmp_path / "file" / "below") == os.strerror(errno.ENOTDIR)
    assert write_fault(Path("/proc/1")) != ""


def test_a_disk_that_is_full_half_way_is_a_fault(tmp_path, monkeypatch):
    def full(path, content):
        path.touch()
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    assert write_fault(tmp_path) == "No space left on device"
    assert list(tmp_path.iterdir()) == []


def test_the_private_folder_does_not_depend_on_the_environment(monkeypatch):
    expected = Path(f"/tmp/crazychoir-{os.getuid()}")  # noqa: S108 - it is checked before it is used
    for name in ("XDG_RUNTIME_DIR", "TMPDIR", "HOME", "USER"):
        for value in ("/elsewhere", ""):
            monkeypatch.setenv(name, value)
            assert private_folder() == private_folder_of(os.getuid()) == expected


def test_the_private_folder_is_for_its_user_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(user_folders, "SHARED_FOLDER", str(tmp_path))
    folder = user_folders.private_folder_of(os.getuid())
    assert make_private(folder) == ""
    folder.chmod(0o777)
    assert make_private(folder) == ""
    assert folder.stat().st_mode & 0o777 == 0o700


def test_what_another_user_has_put_there_is_not_used(tmp_path):
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(tmp_path)
    (tmp_path / "dangling").symlink_to(tmp_path / "nothing")
    assert make_private(tmp_path / "file") == "it is no folder"
    assert make_private(tmp_path / "link") == "it is a symbolic link"
    assert make_private(tmp_path / "dangling") == "it is a symbolic link"
    require("true")
    (tmp_path / "foreign").mkdir()
    os.chown(tmp_path / "foreign", 12345, 12345)
    assert make_private(tmp_path / "foreign") == "it belongs to user 12345"
    assert (tmp_path / "foreign").stat().st_uid == 12345


def test_a_user_is_named_as_far_as_the_system_knows():
    assert user_name(0) == "user root (0)"
    assert user_name(12345) == "user 12345"


def test_each_cache_is_warned_of_once_in_a_process_and_its_child_processes():
    program = "from crazychoir.files.user_folders import first_warning as f; print(f('laws'), f('tables'), f('tables'))"
    assert [first_warning("laws"), first_warning("laws")] == [True, False]
    said = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert said.stdout.split() == ["False", "True", "False"]


def test_matplotlib_is_given_a_folder_only_where_it_has_none(monkeypatch, tmp_path):
    for name in ("MPLCONFIGDIR", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("CRAZYCHOIR_RUNTIME_DIR", str(tmp_path / "private"))
    user_folders.prepare_matplotlib()
    assert "MPLCONFIGDIR" not in os.environ
    monkeypatch.setenv("HOME", "/proc")
    monkeypatch.setattr(
        user_folders, "_may_write", lambda folder: not str(folder).startswith("/proc")
    )
    user_folders.prepare_matplotlib()
    assert os.environ["MPLCONFIGDIR"] == str(tmp_path / "private" / "matplotlib")
    monkeypatch.setenv("MPLCONFIGDIR", "/own")
    user_folders.prepare_matplotlib()
    assert os.environ["MPLCONFIGDIR"] == "/own"


@pytest.mark.parametrize("place", [None, "/", "/proc"])
def test_no_library_complains_to_a_user_without_a_home(place):
    with open_folder() as folder:
        said = imported(place, folder / "private")
        assert said.stdout.strip() == str(folder / "private" / "matplotlib")
    complaints = [
        line
        for line in said.stderr.splitlines()
        if "building the font cache" not in line  # said where that takes 5 s
    ]
    assert complaints == []


def imported(place, private):
    """What matplotlib says when a mission imports it."""
    environment = homeless(
        PYTHONPATH=os.pathsep.join(sys.path), CRAZYCHOIR_RUNTIME_DIR=str(private)
    )
    if place is not None:
        environment["HOME"] = place
    program = "import crazychoir, matplotlib, matplotlib.figure; print(matplotlib.get_cachedir())"
    command = [*as_user(), sys.executable, "-c", program]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, check=True, cwd="/"
    )


def test_a_named_folder_that_others_may_use_is_refused_and_not_changed(
    tmp_path, monkeypatch
):
    shared = tmp_path / "shared"
    shared.mkdir()
    shared.chmod(0o777)
    monkeypatch.setenv("CRAZYCHOIR_RUNTIME_DIR", str(shared))
    with pytest.raises(
        ConfigError, match=r"others may use it, as its mode is 777.*mkdir -m 700"
    ):
        runtime_folder()
    assert stat.S_IMODE(shared.stat().st_mode) == 0o777


def test_a_private_folder_may_have_the_bit_of_its_parents_group(tmp_path, monkeypatch):
    own = tmp_path / "own"
    own.mkdir(mode=0o700)
    own.chmod(0o2700)
    monkeypatch.setenv("CRAZYCHOIR_RUNTIME_DIR", str(own))
    assert runtime_folder() == own
