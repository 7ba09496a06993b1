"""crazychoir render: draw a recorded flight as a picture or a video, with MuJoCo."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.files.output_files import output_file, require_writable_file
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    CommandOutputs,
    exit_with_error,
    set_up_logging,
    warn_of_gaps,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.recording.video import Image


def render(
    file: Annotated[
        Path,
        typer.Argument(help="Recording of `crazychoir run --record`, of any world."),
    ],
    picture: Annotated[Path | None, typer.Option(help="PNG to draw into.")] = None,
    video: Annotated[
        Path | None, typer.Option(help="MP4, GIF or WebP to film into.")
    ] = None,
    at: Annotated[
        float | None,
        options.seconds("s of the flight that the picture shows; else its middle."),
    ] = None,
    size: Annotated[str, typer.Option(help="Pixels, width x height.")] = "960x540",
    fps: Annotated[
        int, options.whole("Pictures a second of the video.", most=100)
    ] = 25,
    speed: Annotated[
        float,
        options.real(
            "Speed, as a multiple of the recorded one.", least=0.01, most=1000.0
        ),
    ] = 1.0,
    camera: Annotated[
        str,
        typer.Option(help="Camera of the scene, by name; else a view of everything."),
    ] = "",
    scene: Annotated[
        Path | None, typer.Option(help="MJCF of the room, instead of the swarm file's.")
    ] = None,
    enlarge: Annotated[
        float,
        options.real("Draw the drones so many times larger.", least=0.1, most=100.0),
    ] = 1.0,
    trail: Annotated[float, options.seconds("s of its way behind each drone.")] = 2.0,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Draw or film a recorded flight in 3D; needs the extra `mujoco`."""
    set_up_logging()
    import numpy as np  # takes 1 s, which --help does not need

    from crazychoir.bus.topics import DRONE_TOPICS
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.recording.analysis.figures import recorded_flight
    from crazychoir.recording.mcap.reading import EXPECTED_RECORDING, read
    from crazychoir.recording.mcap.records import RECORDING_HINT
    from crazychoir.recording.video import check_video, write_video

    outputs = CommandOutputs()
    files: list[Path] = []
    try:
        width, height = _size(size)
        _check(picture, video)
        if video is not None:
            check_video(video, width, height)
            require_writable_file(video, "--video", parents=True)
        recording = read(file, (DRONE_TOPICS.truth.name, DRONE_TOPICS.state.name))
        warn_of_gaps(recording, "what lies before is drawn")
        flight = recorded_flight(recording)
        config = SwarmConfig.loads(recording.swarm, str(file))
        if not flight.tracks:
            raise ConfigError(
                str(file),
                "no two places of any drone",
                EXPECTED_RECORDING,
                RECORDING_HINT,
            )
        from crazychoir.recording.reenactment import (
            Reenactment,
        )  # raises an error with instructions if MuJoCo is missing

        shown = Reenactment(flight, config, scene, enlarge, trail)
        times = np.arange(flight.times[0], flight.times[-1], speed / fps)
        with shown.film(width, height, camera) as film:
            if picture is not None:
                moment = _picture_time(at, times)
                with outputs.writing("--picture"):
                    _save(picture, shown.picture(film, moment))
                    files.append(picture)
            if video is not None:
                ERROR_CONSOLE.print(f"{len(times)} pictures", highlight=False)
                with outputs.writing("--video"):
                    write_video(video, shown.pictures(film, times), fps)
                    files.append(video)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    success = not outputs.failed
    if as_json:
        told = {"file": file, **recording.lacks, "files": files, **outputs.told}
        write_json({"success": success, **told, "seconds": float(times[-1] - times[0])})
    elif files:
        ANSWER_CONSOLE.print(
            f"In {', '.join(map(str, files))}",
            markup=False,
            highlight=False,
            soft_wrap=True,
        )
    outputs.say()
    if not success:
        raise typer.Exit(1)


def _size(text: str) -> tuple[int, int]:
    found = re.fullmatch(r"\s*([0-9]{1,5})\s*[xX×]\s*([0-9]{1,5})\s*", text)
    if found is None:
        raise ConfigError("--size", text, "width x height in pixels, as 960x540")
    return int(found[1]), int(found[2])


def _check(picture: Path | None, video: Path | None) -> None:
    if picture is None and video is None:
        raise ConfigError(
            "crazychoir render",
            "nothing to draw",
            "--picture FILE.png, --video FILE.mp4, or both",
        )
    if picture is not None:
        if picture.suffix.lower() != ".png":
            raise ConfigError("--picture", picture.name, "a file that ends in .png")
        require_writable_file(picture, "--picture", parents=True)


def _picture_time(at: float | None, times: Any) -> float:
    """Return the time of the picture, in s of the recording; at: s, None for the middle."""
    first = float(times[0])
    last = float(times[-1])
    if at is None:
        return 0.5 * (first + last)
    if not first <= at <= last:
        raise ConfigError(
            "--at", at, f"{first:.2f} to {last:.2f} s, while it was recorded"
        )
    return at


def _save(path: Path, image: "Image") -> None:
    import numpy as np
    from PIL import Image as Pillow

    with output_file(path, "--picture") as place:
        Pillow.fromarray(np.ascontiguousarray(image)).save(place, "PNG", optimize=True)
