"""Places for answers: what is refused before a computation, and what is left when writing fails."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from crazychoir.errors import ConfigError
from crazychoir.files.output_files import (
    output_file,
    require_writable_file,
    require_writable_folder,
    save_figure,
)
from crazychoir.optimization.history import History
from crazychoir.optimization.picture import draw_convergence
from crazychoir.recording.video import write_video

FULL = Path("/dev/full")
needs_full = pytest.mark.skipif(
    not FULL.exists(), reason="no /dev/full here, which is a disk without room"
)


@pytest.fixture
def places(tmp_path):
    """Names that no file can be written to, by what is wrong with them."""
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file").write_text("kept")
    (tmp_path / "dangling.png").symlink_to(tmp_path / "none" / "x.png")
    return {
        "it is a folder": tmp_path / "folder.png",
        "its folder is a file": tmp_path / "file" / "x.png",
        "two folders are missing": tmp_path / "a" / "b" / "x.png",
        "its name is too long": tmp_path / f"{'x' * 300}.png",
        "it is a link into no folder": tmp_path / "dangling.png",
        "it has another ending": tmp_path / "x.txt",
        "it is standard output": Path("-"),
        "it has a zero byte": tmp_path / "a\0b.png",
    }


WRONG = (
    "it is a folder",
    "its folder is a file",
    "two folders are missing",
    "its name is too long",
    "it is a link into no folder",
    "it has another ending",
    "it is standard output",
    "it has a zero byte",
)


@pytest.mark.parametrize("wrong", WRONG)
def test_a_place_that_cannot_be_written_is_refused_before_anything(places, wrong):
    with pytest.raises(ConfigError) as refusal:
        require_writable_file(places[wrong], "--picture", (".png",))
    assert str(refusal.value).startswith(f"--picture: found {places[wrong]}")
    assert (places["its folder is a file"].parent).read_text() == "kept"


def test_a_place_that_can_be_written_stays_as_it_is(tmp_path):
    old = tmp_path / "old.png"
    old.write_text("old")
    for path in (old, tmp_path / "new" / "x.PNG"):
        require_writable_file(path, "--picture", (".png",))
    assert old.read_text() == "old"
    assert os.listdir(tmp_path / "new") == []


def test_a_protected_file_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "x.png"
    path.write_text("mine")

    def refuse(*arguments):
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr("crazychoir.files.output_files.os.open", refuse)
    with pytest.raises(ConfigError, match="Permission denied"):
        require_writable_file(path, "--picture")
    with (
        pytest.raises(ConfigError, match="Permission denied"),
        output_file(path, "picture") as place,
    ):
        place.write_text("another")
    assert path.read_text() == "mine"


@needs_full
def test_a_disk_without_room_is_noticed_before_anything(tmp_path, monkeypatch):
    def full(**options):
        return FULL.open("wb", buffering=0)

    monkeypatch.setattr("crazychoir.files.output_files.tempfile.TemporaryFile", full)
    with pytest.raises(ConfigError, match="No space left"):
        require_writable_file(tmp_path / "x.png", "--picture")
    with pytest.raises(ConfigError, match="No space left"):
        require_writable_folder(tmp_path, "--out")


@pytest.mark.parametrize("name", ["file", "file/below"])
def test_a_folder_that_is_a_file_is_refused(tmp_path, name):
    (tmp_path / "file").write_text("kept")
    with pytest.raises(ConfigError, match="--out: found"):
        require_writable_folder(tmp_path / name, "--out")


def write_half(path, error):
    with output_file(path, "history") as place:
        place.write_text("half")
        raise error


def test_what_fails_in_between_leaves_the_old_file_and_no_other(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("old")
    with pytest.raises(
        ConfigError, match=r"x\.csv; allowed: a file that can be written\. Disk quota"
    ):
        write_half(path, OSError(122, "Disk quota exceeded"))
    with pytest.raises(ValueError, match="mine"):
        write_half(path, ValueError("mine"))
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["x.csv"]


def test_a_file_is_replaced_through_a_link_and_keeps_its_mode(tmp_path):
    real = tmp_path / "real.csv"
    real.write_text("old")
    real.chmod(0o640)
    link = tmp_path / "link.csv"
    link.symlink_to(real)
    with output_file(link, "history") as place:
        place.write_text("new")
    assert link.is_symlink()
    assert real.read_text() == "new"
    assert real.stat().st_mode & 0o777 == 0o640


def draw(path):
    draw_convergence({"x": {0: np.zeros((3, 1)), 1: np.ones((3, 1))}}, path, "title")


def save(path):
    values = {0: {"x": np.zeros((3, 1))}}
    History(values, {0: np.zeros(3)}, {0: np.zeros(2)}, 0, 0, 0, 0, 0.0, 0.0).save(path)


def film(path):
    write_video(path, [np.zeros((8, 8, 3), np.uint8)] * 2, 5)


WRITERS = {".png": draw, ".csv": save, ".json": save, ".npz": save, ".gif": film}


@pytest.mark.parametrize("ending", WRITERS)
def test_functions_raise_an_error_of_the_project_where_they_cannot_write(
    tmp_path, ending
):
    (tmp_path / f"folder{ending}").mkdir()
    (tmp_path / "file").write_text("kept")
    for path in (
        tmp_path / f"folder{ending}",
        tmp_path / "file" / f"x{ending}",
        tmp_path / "a" / "b" / f"x{ending}",
    ):
        with pytest.raises(ConfigError):
            WRITERS[ending](path)
    assert sorted(os.listdir(tmp_path)) == ["file", f"folder{ending}"]


@needs_full
@pytest.mark.parametrize("ending", WRITERS)
def test_a_full_disk_is_an_error_of_the_project(tmp_path, ending):
    link = tmp_path / f"x{ending}"
    link.symlink_to(FULL)
    with pytest.raises(ConfigError, match="No space left"):
        WRITERS[ending](link)
    assert os.listdir(tmp_path) == [link.name]
    assert not FULL.with_name(f"full{ending}").exists()


def test_the_suffix_says_the_kind_in_any_case_and_through_a_link(tmp_path):
    (tmp_path / "link.PDF").symlink_to("real.dat")
    save_figure(Figure(), tmp_path / "link.PDF")
    assert (tmp_path / "real.dat").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("error", [errno.EBUSY, errno.EPERM])
def test_a_file_that_cannot_be_replaced_is_written_in_place(
    tmp_path, monkeypatch, error
):
    """Renaming fails for a file that is mounted by itself, and for another user's file in a sticky folder."""

    def refuse(new, place):
        raise OSError(error, os.strerror(error), str(place))

    (tmp_path / "x.json").write_text("before")
    monkeypatch.setattr(Path, "replace", refuse)
    with output_file(tmp_path / "x.json", "history") as place:
        place.write_text("after")
    assert (tmp_path / "x.json").read_text() == "after"
    assert [file.name for file in tmp_path.iterdir()] == ["x.json"]


def test_a_link_that_was_laid_beforehand_is_not_written_through(tmp_path):
    (tmp_path / "victim").write_text("kept")
    (tmp_path / f".{os.getpid()}.x.new.json").symlink_to("victim")
    with output_file(tmp_path / "x.json", "history") as place:
        place.write_text("after")
    assert (tmp_path / "victim").read_text() == "kept"
    assert not (tmp_path / "x.json").is_symlink()


def test_a_new_file_has_the_usual_permissions(tmp_path):
    (tmp_path / "usual").touch()
    with output_file(tmp_path / "x.json", "history") as place:
        place.write_text("after")
    usual = (tmp_path / "usual").stat().st_mode
    assert (tmp_path / "x.json").stat().st_mode == usual
