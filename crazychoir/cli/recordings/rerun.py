"""crazychoir rerun: fly a recorded flight in virtual time again, and compare the two."""

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    LiveTable,
    build_status_table,
    exit_with_error,
    redirect_prints,
    set_up_logging,
    warn_of_gaps,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.recording.mcap.reading import Recording

UNSEEN_DIFFERENCE = "in no recorded message: in truth between two of them, or in messages that are not recorded"


def rerun(
    file: Annotated[
        Path, typer.Argument(help="Recording of `crazychoir run --fast --record`.")
    ],
    record: Annotated[
        Path | None,
        typer.Option(help="New file to record the repetition into (.mcap)."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Repeat a recorded flight in virtual time, and compare the two.

    Prints whether they are equal, or where they first differ.
    """
    set_up_logging()
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.guidance.mission import (
        load_mission,
    )  # takes 1 s, which --help does not need
    from crazychoir.launch.flight import fly_fast
    from crazychoir.launch.recording import (
        FILES_KEY,
        list_changed_files,
        open_recording_file,
        read_mission_text,
    )
    from crazychoir.recording.analysis.comparison import first_difference
    from crazychoir.recording.mcap.reading import read_header

    try:
        recording = read_header(file)
        _check(recording)
        with redirect_prints(), _repetition_file(record) as path:
            config = SwarmConfig.loads(recording.swarm, f"{file}: swarm.json")
            mission = load_mission(str(config.mission))
            others = _other_versions(recording)
            if read_mission_text(mission) != recording.mission:
                others["mission"] = f"the text of {config.mission} has changed"
            others |= list_changed_files(
                json.loads(recording.about.get(FILES_KEY, "{}")), config, mission
            )
            with LiveTable(build_status_table, enabled=not as_json) as progress:
                for what, text in others.items():
                    progress.say(f"{what}: {text}")
                with open_recording_file(
                    path, config, mission, virtual=True
                ) as repeated:
                    result = fly_fast(config, mission, progress, repeated)
            broken = "" if repeated is None else repeated.error
            difference = None if broken else first_difference(file, path)
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    digest = recording.outcome.get("digest")
    same = difference is None and digest in (None, result["digest"])
    where = UNSEEN_DIFFERENCE if difference is None else str(difference)
    whole = recording.lacks["complete"]
    told = {
        "success": same and whole and not broken,
        "same": same,
        "mission": config.mission,
        "seed": config.seed,
        **recording.lacks,
        "recorded_digest": digest,
        "digest": result["digest"],
        "first_difference": None if same else where,
        "others": others,
        "simulated_s": result["simulated_s"],
        "wall_s": result["wall_s"],
        "recording": record,
    } | ({"not_written": {"--record": broken}} if broken else {})
    if as_json:
        write_json(told)
    else:
        _show(told)
    if broken:
        text = f"Not complete: --record: {broken}; only the digests are compared"
        ERROR_CONSOLE.print(
            text, style="red", markup=False, highlight=False, soft_wrap=True
        )
    raise typer.Exit(0 if told["success"] else 1)


def _check(recording: "Recording") -> None:
    """Raise ConfigError for a flight that cannot be repeated."""
    if recording.about.get("time") != "virtual":
        do = "Record one with `crazychoir run ... --fast --record FILE`; `crazychoir replay` shows this one again."
        raise ConfigError(
            str(recording.path),
            "a flight in real time",
            "one in virtual time, which repeats itself",
            do,
        )
    warn_of_gaps(recording, "it is compared as far as it goes")


@contextlib.contextmanager
def _repetition_file(record: Path | None) -> Iterator[Path]:
    """Yield the file for the repetition: the given one, or a temporary file."""
    from crazychoir.files.private_folder import scratch_folder

    with scratch_folder("crazychoir-rerun-") as folder:
        yield record or folder / "again.mcap"


def _other_versions(recording: "Recording") -> dict[str, str]:
    """Return the versions that have changed since the recording and may round differently."""
    from crazychoir.launch.recording import list_versions

    pairs = {
        name: (recording.about.get(name, "unknown"), now)
        for name, now in list_versions().items()
    }
    return {
        name: f"{then} then, {now} now"
        for name, (then, now) in pairs.items()
        if then != now
    }


def _show(told: dict[str, Any]) -> None:
    if told["success"]:
        verdict = "the same"
    elif told["same"]:
        verdict = "the same, so far"
    else:
        verdict = "not the same"
    title = f"{Path(told['mission']).name}, seed {told['seed']}: {verdict}"
    table = Table("figure", "value", title=title)
    table.add_row(
        "recorded digest", told["recorded_digest"] or "none: the recording was cut off"
    )
    table.add_row("digest", told["digest"])
    table.add_row("simulated_s", f"{told['simulated_s']:.2f} s")
    table.add_row("wall_s", f"{told['wall_s']:.2f} s")
    if told["first_difference"]:
        table.add_row("they differ first", Text(told["first_difference"], "red"))
    ANSWER_CONSOLE.print(table)
