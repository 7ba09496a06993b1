import numpy as np
import pytest

from crazychoir.errors import ConfigError
from crazychoir.mocap.frames import PoseFrame
from crazychoir.mocap.recording import (
    RECORDING_COLUMNS,
    FrameRecorder,
    ReplaySource,
    read_recording,
)
from crazychoir.runtime.clock import run_virtual

ROW = "0.5,cf0,1,2,3,0,0,0,1"


def frames(count=5):
    draw = np.random.default_rng(0)
    return [
        PoseFrame(k, 0.25 * k, {"cf0": draw.normal(size=7), "a,b": draw.normal(size=7)})
        for k in range(count)
    ]


def recorded(path, seen):
    with FrameRecorder(path) as recorder:
        for one in seen:
            recorder.write(one, 7.0 + one.time)
    return path


def test_a_recording_gives_back_what_was_seen_to_the_last_digit(tmp_path):
    seen = frames()
    back = read_recording(recorded(tmp_path / "a.csv", seen))
    assert [one.time for one in back] == [one.time for one in seen]
    for one, other in zip(seen, back, strict=True):
        assert list(one.bodies) == list(other.bodies)
        assert all(
            np.array_equal(one.bodies[name], other.bodies[name]) for name in one.bodies
        )


def test_it_is_handed_out_as_fast_as_it_was_recorded_and_then_it_is_over(tmp_path):
    path, said = recorded(tmp_path / "a.csv", frames()), []

    async def main(clock):
        taken = []
        source = ReplaySource(clock, str(path), said.append)
        await clock.sleep(3.0)
        await source.run(
            lambda frame, age: taken.append((clock.now(), frame.time, age))
        )
        return taken, source.state

    taken, state = run_virtual(main)
    assert taken == [(3.0 + 0.25 * k, 0.25 * k, 0.0) for k in range(5)]
    assert state == "over"
    assert said == [f"replay of {path}: it is over after 1.0 s, no more frames"]


def test_a_file_that_is_there_is_not_written_over(tmp_path):
    (tmp_path / "a.csv").write_text("mine")
    with pytest.raises(ConfigError, match="a new file"):
        FrameRecorder(tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text() == "mine"


def test_a_full_disk_ends_the_recording_and_nothing_else(tmp_path, monkeypatch, caplog):
    class Full:
        def writerows(self, rows):
            raise OSError(28, "No space left on device")

    with FrameRecorder(tmp_path / "a.csv") as recorder:
        recorder.write(frames()[0], 0.0)
        monkeypatch.setattr(recorder, "_writer", Full())
        for k in (1, 2, 3):
            recorder.write(frames()[k], 0.1 * k)
    report = recorder.report()
    assert report == {
        "file": str(tmp_path / "a.csv"),
        "frames": 1,
        "error": "No space left on device",
    }
    assert caplog.text.count("No space left on device") == 1


@pytest.mark.parametrize(
    ("text", "where"),
    [
        ("", "line 1: found an empty file"),
        ("t,x\n", "line 1: found t,x"),
        (",".join(RECORDING_COLUMNS), "no row"),
        (f"{','.join(RECORDING_COLUMNS)}\n{ROW}\n1.0,cf0,1,2,3,0,0,0", "line 3"),
        (f"{','.join(RECORDING_COLUMNS)}\n{ROW}\n1.0,cf0,1,2,nan,0,0,0,1", "line 3"),
        (
            f"{','.join(RECORDING_COLUMNS)}\n{ROW}\n0.4,cf0,1,2,3,0,0,0,1",
            "line 3: found t = 0.4",
        ),
    ],
)
def test_a_file_that_is_none_is_refused_with_its_line(tmp_path, text, where):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(ConfigError) as refused:
        read_recording(path)
    assert where in str(refused.value)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="No such file"):
        read_recording(tmp_path / "b.csv")


def written(path, times, names=("cf0",)):
    rows = [f"{t!r},{name},1,2,3,0,0,0,1" for t in times for name in names]
    path.write_text("\n".join([",".join(RECORDING_COLUMNS), *rows]))
    return path


@pytest.mark.parametrize("origin", [0.0, -7.25, 86_400.0, 1.76e9, -1.76e9])
def test_a_replay_takes_any_origin_of_time(tmp_path, origin):
    path = written(tmp_path / "a.csv", [origin + 0.25 * k for k in range(5)])

    async def main(clock):
        taken = []
        await ReplaySource(clock, str(path), lambda text: None).run(
            lambda frame, age: taken.append((clock.now(), frame.time, age))
        )
        return taken

    assert run_virtual(main) == [(0.25 * k, 0.25 * k, 0.0) for k in range(5)]


@pytest.mark.parametrize("origin", [0.0, 1.76e9])
@pytest.mark.parametrize(("unit", "factor"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_times_in_another_unit_are_refused_with_the_unit_that_they_seem_to_have(
    tmp_path, origin, unit, factor
):
    path = written(
        tmp_path / "a.csv", [round((origin + 0.01 * k) * factor) for k in range(5)]
    )
    with pytest.raises(ConfigError) as refused:
        read_recording(path)
    assert "t in s" in str(refused.value)
    assert unit in str(refused.value)
    assert "line " in str(refused.value)


@pytest.mark.parametrize(
    ("jump", "words"),
    [
        (-0.3, "or more, as before"),
        (-1.76e9, "or more, as before"),
        (1.76e9, "after the row before"),
        (3600, "600"),
    ],
)
def test_a_clock_that_is_set_within_a_recording_is_refused_with_its_line(
    tmp_path, jump, words
):
    path = written(
        tmp_path / "a.csv",
        [1.76e9 + 0.01 * k + (jump if k >= 5 else 0.0) for k in range(9)],
    )
    with pytest.raises(ConfigError) as refused:
        read_recording(path)
    assert "line 7: found t = " in str(refused.value)
    assert words in str(refused.value)
    assert "cut the file in two" in str(refused.value)


def test_a_body_that_is_twice_in_a_frame_is_refused_with_both_lines(tmp_path):
    path = written(tmp_path / "a.csv", [0.0, 0.5], names=("cf0", "cf1", "cf0"))
    with pytest.raises(
        ConfigError, match=r"body 'cf0' twice at t = 0\.0, in lines 2 and 4"
    ):
        read_recording(path)


def test_a_row_without_a_name_is_refused_and_blank_lines_are_not(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(
        f"\ufeff{','.join(RECORDING_COLUMNS)}\r\n\r\n   \r\n0.0, cf0 ,1,2,3,0,0,0,1\r\n".encode()
    )
    assert [list(frame.bodies) for frame in read_recording(path)] == [["cf0"]]
    path.write_text(f"{','.join(RECORDING_COLUMNS)}\n0.0,,1,2,3,0,0,0,1\n")
    with pytest.raises(ConfigError, match="line 2"):
        read_recording(path)
