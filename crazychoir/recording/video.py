"""Write a sequence of pictures as MP4 (with the library av, of the extra `mujoco`), GIF or WebP."""

from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from crazychoir.errors import ConfigError
from crazychoir.files.output_files import output_file

Image = npt.NDArray[np.uint8]
VIDEO_SUFFIXES = (".mp4", ".gif", ".webp")


def check_video(path: Path, width: int, height: int) -> None:
    """Raise ConfigError for a file that cannot be written, before hours of drawing are lost."""
    ending = path.suffix.lower()
    if ending not in VIDEO_SUFFIXES:
        raise ConfigError(
            "--video", path.name, f"a file that ends in {', '.join(VIDEO_SUFFIXES)}"
        )
    if ending == ".mp4":
        _import_av()
        if width % 2 or height % 2:
            raise ConfigError(
                "--size",
                f"{width}x{height}",
                "even numbers of pixels in an MP4",
                "Add one.",
            )


def write_video(path: Path, images: Iterable[Image], fps: int) -> None:
    """Write images of equal size (height, width, 3) as a video with `fps` pictures a second."""
    with output_file(path, "video") as place:
        if path.suffix.lower() == ".mp4":
            _write_mp4(place, images, fps)
        else:
            _write_animation(place, images, fps, path.suffix.lower())


def _import_av() -> Any:
    try:
        import av
    except ImportError as error:
        do = "pip install 'crazychoir[mujoco]', or write a .gif or .webp."
        raise ConfigError("an MP4", str(error), "the library av", do) from error
    return av


def _write_mp4(path: Path, images: Iterable[Image], fps: int) -> None:
    av = _import_av()
    with av.open(str(path), "w", format="mp4") as container:
        stream: Any = None
        for image in images:
            if stream is None:
                stream = container.add_stream(
                    "libx264", rate=Fraction(fps), options={"crf": "23"}
                )
                stream.height, stream.width = image.shape[:2]
                stream.pix_fmt = "yuv420p"
            container.mux(
                stream.encode(
                    av.VideoFrame.from_ndarray(
                        np.ascontiguousarray(image), format="rgb24"
                    )
                )
            )
        if stream is not None:
            container.mux(stream.encode())


def _write_animation(
    path: Path, images: Iterable[Image], fps: int, ending: str
) -> None:
    from PIL import Image as Pillow

    def shown() -> Iterator[Any]:
        for image in images:
            one = Pillow.fromarray(np.ascontiguousarray(image))
            yield one.quantize(128) if ending == ".gif" else one

    frames = shown()
    next(frames).save(
        path,
        ending[1:].upper(),
        save_all=True,
        append_images=frames,
        duration=round(1000 / fps),
        loop=0,
    )
