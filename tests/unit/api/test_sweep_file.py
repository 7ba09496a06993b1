"""The file of a sweep: interrupted or not, it has the same bytes at the end."""

import pytest

from crazychoir.api.sweep_file import SweepFile
from crazychoir.errors import ConfigError

MISSION = "figure"
KEYS = ["a", "b", "c"]
RUNS = {key: {"seed": key} for key in KEYS}


def row(key):
    return {"seed": key, "value": key * 2}


def whole(path, order=KEYS):
    with SweepFile(path, MISSION, RUNS) as file:
        for key in order:
            file.add(key, row(key))
        file.finish()
    return path.read_bytes()


def test_the_order_in_which_runs_end_does_not_matter(tmp_path):
    assert whole(tmp_path / "1.jsonl") == whole(tmp_path / "2.jsonl", ["c", "a", "b"])


@pytest.mark.parametrize("cut", [0, 1, 5])
def test_an_interrupted_sweep_goes_on(tmp_path, cut):
    path = tmp_path / "a.jsonl"
    with SweepFile(path, MISSION, RUNS) as file:
        file.add("c", row("c"))
        file.add("a", row("a"))
    path.write_bytes(path.read_bytes()[: -cut or None])
    with SweepFile(path, MISSION, RUNS) as file:
        assert list(file.rows) == (["c", "a"] if cut <= 1 else ["c"])
        for key in KEYS:
            if key not in file.rows:
                file.add(key, row(key))
        file.finish()
    assert path.read_bytes() == whole(tmp_path / "b.jsonl")


def test_a_sweep_that_is_interrupted_twice_keeps_what_ran_between(tmp_path):
    path = tmp_path / "a.jsonl"
    with SweepFile(path, MISSION, RUNS) as file:
        file.add("c", row("c"))
        file.add("a", row("a"))
    path.write_bytes(path.read_bytes()[:-5])
    with SweepFile(path, MISSION, RUNS) as file:
        file.add("b", row("b"))
    with SweepFile(path, MISSION, RUNS) as file:
        assert list(file.rows) == ["c", "b"]


def test_a_first_line_that_was_cut_is_no_fault(tmp_path):
    path = tmp_path / "a.jsonl"
    path.write_text('{"key": "a", "va')
    assert whole(path) == whole(tmp_path / "b.jsonl")


def test_a_sweep_may_get_more_runs_and_read_some_of_them(tmp_path):
    path = tmp_path / "a.jsonl"
    all_rows = whole(path)
    with SweepFile(path, MISSION, RUNS | {"d": {"seed": "d"}}) as file:
        assert list(file.rows) == KEYS
    with SweepFile(path, MISSION, {key: RUNS[key] for key in "bc"}) as file:
        assert list(file.rows) == ["b", "c"]
        file.finish()
    assert sorted(path.read_bytes().splitlines()) == sorted(all_rows.splitlines())
    with SweepFile(path, MISSION, RUNS) as file:
        file.finish()
    assert path.read_bytes() == all_rows


def test_a_row_of_another_sweep_with_the_same_inputs_is_refused(tmp_path):
    path = tmp_path / "a.jsonl"
    before = whole(path)
    changed = {"new": RUNS["b"]}
    with pytest.raises(ConfigError, match=r"found 1 runs of another sweep.*remove it"):
        SweepFile(path, MISSION, changed).__enter__()
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    "text", ["x,y\n1,2\n", '{"other": 1}\n', "[1]\n", '{"key": [3]}\n']
)
def test_another_file_is_not_touched(tmp_path, text):
    path = tmp_path / "a.jsonl"
    path.write_text(text)
    with pytest.raises(ConfigError, match="found another file"):
        SweepFile(path, MISSION, RUNS).__enter__()
    assert path.read_text() == text


def test_a_damaged_line_is_named_and_the_rows_after_it_are_kept(tmp_path, caplog):
    path = tmp_path / "a.jsonl"
    before = whole(path)
    first, second, third = before.splitlines(keepends=True)
    path.write_bytes(first + b'\xff{"key' + second[9:] + third)
    with SweepFile(path, MISSION, RUNS) as file:
        assert list(file.rows) == ["a", "c"]
        file.add("b", row("b"))
        file.finish()
    assert f"{path}: line 2 is damaged: it is left out" in caplog.text
    assert path.read_bytes() == before


def test_rows_of_another_mission_are_refused_whatever_their_inputs_are(tmp_path):
    path = tmp_path / "a.jsonl"
    before = whole(path)
    found = r"found runs of another mission: 3 of figure;.*This sweep flies grid\."
    with pytest.raises(ConfigError, match=found):
        SweepFile(path, "grid", {"d": {"seed": "d"}}).__enter__()
    assert path.read_bytes() == before


def test_a_last_line_without_its_end_is_kept_if_it_is_whole(tmp_path):
    path = tmp_path / "a.jsonl"
    before = whole(path)
    path.write_bytes(before.rstrip(b"\n"))
    with SweepFile(path, MISSION, RUNS) as file:
        assert list(file.rows) == list(RUNS)
    assert path.read_bytes() == before
    path.write_bytes(before.rstrip(b"\n"))
    with pytest.raises(ConfigError, match="runs of another mission"):
        SweepFile(path, "grid", {"d": {"seed": "d"}}).__enter__()


def test_a_figure_may_have_the_name_of_a_field_of_its_line(tmp_path):
    path = tmp_path / "a.jsonl"
    named = row("a") | {"mission": "mine", "key": 3}
    with SweepFile(path, MISSION, {"a": RUNS["a"]}) as file:
        file.add("a", named)
        file.finish()
    with SweepFile(path, MISSION, {"a": RUNS["a"]}) as file:
        assert file.rows == {"a": named}


def test_runs_of_the_same_mission_by_another_name_are_kept(tmp_path):
    path = tmp_path / "a.jsonl"
    whole(path)
    with SweepFile(path, "agents/figure.py", RUNS) as file:
        assert list(file.rows) == list(RUNS)


def test_two_sweeps_do_not_write_one_file(tmp_path):
    path = tmp_path / "a.jsonl"
    with (
        SweepFile(path, MISSION, RUNS),
        pytest.raises(ConfigError, match="another sweep writes"),
    ):
        SweepFile(path, MISSION, RUNS).__enter__()
