"""crazychoir convert: a recording for the tools of ROS 2."""

from pathlib import Path
from typing import Annotated

import typer

from crazychoir.cli.show import STDOUT, fail, set_up_logging, write_json
from crazychoir.errors import CrazyChoirError


def convert(
    file: Annotated[Path, typer.Argument(help="Recording of `crazychoir run --record` or `crazychoir record`.")],
    rosbag2: Annotated[Path, typer.Option(help="New folder for the bag.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object, nothing else.")] = False,
) -> None:
    """Make a bag of ROS 2 of standard messages, which needs none of our packages to be played."""
    set_up_logging()
    from crazychoir.recording import rosbag2 as bags  # numerics: 1 s that --help does not need
    from crazychoir.recording.reading import header

    try:
        header(file)
        bag = bags.convert(file, rosbag2)
    except CrazyChoirError as error:
        fail(error, as_json)
    if as_json:
        topics = {topic: {"type": channel.type, "messages": channel.count} for topic, channel in bag.channels.items()}
        write_json({"success": True, "folder": rosbag2, "messages": bag.count, "topics": topics})
    else:
        text = f"{rosbag2}: {bag.count} messages of {len(bag.channels)} topics"
        STDOUT.print(text, markup=False, highlight=False, soft_wrap=True)
