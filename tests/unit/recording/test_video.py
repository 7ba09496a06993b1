"""Films of a few pictures, read back; what cannot be written is refused before."""

import importlib.util
import sys

import numpy as np
import pytest
from PIL import Image

from crazychoir.errors import ConfigError
from crazychoir.recording.video import check_video, write_video


def pictures(n=5):
    """From red to blue, 32 by 16."""
    for k in range(n):
        image = np.zeros((16, 32, 3), np.uint8)
        image[..., 0], image[..., 2] = 255 - 60 * k, 60 * k
        yield image


@pytest.mark.parametrize("ending", ["gif", "webp"])
def test_an_animation_has_all_pictures_at_their_rate(tmp_path, ending):
    path = tmp_path / f"a.{ending}"
    write_video(path, pictures(), fps=10)
    with Image.open(path) as film:
        assert (film.size, film.n_frames) == ((32, 16), 5)
        film.seek(4)
        film.load()
        assert film.info["duration"] == 100
        red, _, blue = np.asarray(film.convert("RGB")).mean(axis=(0, 1))
        assert abs(red - 15) < 12
        assert abs(blue - 240) < 12


@pytest.mark.skipif(
    importlib.util.find_spec("av") is None, reason="the library av is not installed"
)
def test_an_mp4_has_all_pictures_at_their_rate(tmp_path):
    import av

    path = tmp_path / "a.mp4"
    write_video(path, pictures(), fps=10)
    with av.open(str(path)) as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
        assert film.streams.video[0].average_rate == 10
    assert len(frames) == 5
    assert frames[0].shape == (16, 32, 3)
    assert frames[0][..., 0].mean() > 200 > 60 > frames[4][..., 0].mean()


def test_what_cannot_be_written_is_refused(tmp_path, monkeypatch):
    with pytest.raises(
        ConfigError, match=r"a\.avi; allowed: a file that ends in \.mp4, \.gif, \.webp"
    ):
        check_video(tmp_path / "a.avi", 32, 16)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(
        ConfigError, match=r"pip install 'crazychoir\[mujoco\]', or write a \.gif"
    ):
        check_video(tmp_path / "a.mp4", 32, 16)
    monkeypatch.setitem(sys.modules, "av", object())
    with pytest.raises(ConfigError, match="33x16; allowed: even numbers"):
        check_video(tmp_path / "a.mp4", 33, 16)
    check_video(tmp_path / "a.gif", 33, 16)
