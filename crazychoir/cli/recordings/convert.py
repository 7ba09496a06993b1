"""crazychoir convert: turn a recording into a bag of ROS 2."""

from pathlib import Path
from typing import Annotated

import typer

from crazychoir.errors import CrazyChoirError
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    exit_with_error,
    set_up_logging,
    warn_of_gaps,
    write_json,
)


def convert(
    file: Annotated[
        Path,
        typer.Argument(
            help="Recording of `crazychoir run --record` or `crazychoir record`."
        ),
    ],
    rosbag2: Annotated[Path, typer.Option(help="New folder for the bag.")],
    partial: Annotated[
        bool,
        typer.Option(
            "--partial", help="Exit with 0 even if only a part could be converted."
        ),
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Convert a recording to a ROS 2 bag.

    The bag has standard messages only, so ROS needs no package of crazychoir.
    If the recording is cut off or damaged, the bag ends there, and the exit
    code is 1.
    """
    set_up_logging()
    from crazychoir.recording.mcap.reading import read_header
    from crazychoir.recording.ros import (
        rosbag2 as bags,
    )  # takes 1 s, which --help does not need

    try:
        recording = read_header(file)
        warn_of_gaps(recording, "the bag has what lies before")
        bag = bags.convert(file, rosbag2)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    success = recording.complete or partial
    if as_json:
        topics = {
            topic: {"type": channel.type, "messages": channel.count}
            for topic, channel in bag.channels.items()
        }
        told = {**recording.lacks, "folder": rosbag2, "messages": bag.count}
        write_json({"success": success, **told, "topics": topics})
    else:
        text = f"{rosbag2}: {bag.count} messages of {len(bag.channels)} topics"
        ANSWER_CONSOLE.print(text, markup=False, highlight=False, soft_wrap=True)
    raise typer.Exit(0 if success else 1)
