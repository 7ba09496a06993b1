"""The file of a sweep: interrupted or not, it has the same bytes at the end."""

import pytest

from crazychoir.api.sweep_file import SweepFile
from crazychoir.errors import ConfigError

KEYS = ["a", "b", "c"]


def whole(path, order=KEYS):
    with SweepFile(path, KEYS) as file:
        for key in order:
            file.add(key, {"value": key * 2})
        file.finish()
    return path.read_bytes()


def test_the_order_in_which_runs_end_does_not_matter(tmp_path):
    assert whole(tmp_path / "1.jsonl") == whole(tmp_path / "2.jsonl", ["c", "a", "b"])


@pytest.mark.parametrize("cut", [0, 1, 5])
def test_an_interrupted_sweep_goes_on(tmp_path, cut):
    path = tmp_path / "a.jsonl"
    with SweepFile(path, KEYS) as file:
        file.add("c", {"value": "cc"})
        file.add("a", {"value": "aa"})
    path.write_bytes(path.read_bytes()[: -cut or None])
    with SweepFile(path, KEYS) as file:
        assert list(file.rows) == (["c", "a"] if cut == 0 else ["c"])
        for key in KEYS:
            if key not in file.rows:
                file.add(key, {"value": key * 2})
        file.finish()
    assert path.read_bytes() == whole(tmp_path / "b.jsonl")


def test_a_first_line_that_was_cut_is_no_fault(tmp_path):
    path = tmp_path / "a.jsonl"
    path.write_text('{"key": "a", "va')
    assert whole(path) == whole(tmp_path / "b.jsonl")


def test_a_sweep_may_get_more_runs_and_not_fewer(tmp_path):
    path = tmp_path / "a.jsonl"
    whole(path)
    with SweepFile(path, [*KEYS, "d"]) as file:
        assert list(file.rows) == KEYS
    with pytest.raises(ConfigError, match=r"found 1 runs of another sweep.*remove it"):
        SweepFile(path, KEYS[:2]).__enter__()


@pytest.mark.parametrize("text", ["x,y\n1,2\n", '{"other": 1}\n', "[1]\n"])
def test_another_file_is_not_touched(tmp_path, text):
    path = tmp_path / "a.jsonl"
    path.write_text(text)
    with pytest.raises(ConfigError, match="found another file"):
        SweepFile(path, KEYS).__enter__()
    assert path.read_text() == text


def test_two_sweeps_do_not_write_one_file(tmp_path):
    path = tmp_path / "a.jsonl"
    with (
        SweepFile(path, KEYS),
        pytest.raises(ConfigError, match="another sweep writes"),
    ):
        SweepFile(path, KEYS).__enter__()
