"""crazychoir radio: find quiet channels, and measure the round trip to a drone."""

import contextlib
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from crazychoir.cli.operate.inspect import JsonOption
from crazychoir.cli.setup.radio_tables import progress_table, row_of, survey_table
from crazychoir.errors import ConfigError, CrazyChoirError
from crazychoir.launch import number_options as options
from crazychoir.launch.console import (
    ANSWER_CONSOLE,
    ERROR_CONSOLE,
    CommandOutputs,
    LiveTable,
    exit_interrupted,
    exit_with_error,
    redirect_prints,
    require_drawable,
    set_up_logging,
    write_json,
)

if TYPE_CHECKING:
    from crazychoir.radio.survey.ping import PingResult
    from crazychoir.radio.survey.simulated_radio import RadioRoom
    from crazychoir.radio.survey.survey import Probe, Survey

app = typer.Typer(
    no_args_is_help=True,
    help="Find quiet channels, and measure round trips to drones.",
)
NEW_DRONE_URI = "radio://0/80/2M/E7E7E7E7E7"
"""Address of a new Crazyflie."""


@dataclass(frozen=True)
class SurveyRequest:
    """The request of the command line."""

    channels: tuple[int, ...]
    """Candidate channels."""
    count: int
    """How many channels to pick."""
    spacing: int
    """MHz between two of them, at least."""
    dongles: Mapping[str, Sequence[str]]
    """The uris of the drones of each dongle in the swarm file, by dongle."""
    drone: str
    """The uri of the drone that answers."""
    simulated: int | None
    """Seed of the simulated radio; None for a real one."""


@app.command()
def survey(
    dongles: Annotated[
        int | None,
        options.whole(
            "Number of channels to pick; else the number of dongles of the swarm file, or 1.",
            most=126,
        ),
    ] = None,
    spacing: Annotated[
        int,
        options.whole("MHz between two of them; 2M links need 2 at least.", most=126),
    ] = 5,
    passes: Annotated[
        int, options.whole("Visits of each channel, each time in another order.")
    ] = 20,
    packets: Annotated[
        int, options.whole("Packets a visit, without retries, and with them.")
    ] = 50,
    channels: Annotated[
        str, typer.Option(help="Candidates, as 2-82:2 (each second) or 4,20-30,76.")
    ] = "2-82:2",
    drone: Annotated[
        str | None,
        typer.Option(
            help=f"Uri of the drone that answers; else the first of the swarm file, or {NEW_DRONE_URI}."
        ),
    ] = None,
    swarm: Annotated[
        Path | None,
        typer.Option(help="Swarm file with the radio:// drones that need channels."),
    ] = None,
    write: Annotated[
        bool, typer.Option("--write", help="Write the channels into that file.")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(help="Where to draw the survey (PNG).")
    ] = None,
    simulated: Annotated[
        int | None,
        options.seed("No hardware: a simulated radio among interference of this seed."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Find quiet channels: one drone, on the ground where it will fly, answers on
    each.

    Passes are interleaved, so that a burst of WiFi hits all channels alike. A
    channel is as good as its worst pass.
    The survey takes some minutes. By default it covers channels 2 to 82: what
    lies below 2400 MHz or above channel 83 is outside the licence-free band of
    many countries.

    It then picks the k channels with the best worst pass, with the given spacing.
    With --write each radio:// drone of the swarm file gets the channel of its
    dongle, and nothing else in the file changes. The drones keep their old
    channels until you change them there too, for example with Bitcraze's client.
    """
    set_up_logging()
    outputs = CommandOutputs()
    try:
        require_drawable(picture)
        if write and swarm is None:
            raise ConfigError("--write", "no --swarm", "a swarm file to write into")
        if write and simulated is not None:
            do = "Leave --write out to look at a simulated room; measure the channels for real drones with a dongle."
            raise ConfigError(
                "--write", "--simulated beside it", "what a dongle has measured", do
            )
        wanted = _survey_request(
            dongles, spacing, channels, drone, swarm, write, simulated
        )
        with redirect_prints():
            found, expected = _measure_channels(wanted, passes, packets, as_json)
            result = _result(wanted, found, expected)
            if picture is not None:
                from crazychoir.radio.survey.survey_picture import draw_survey

                with outputs.writing("--picture"):
                    draw_survey(found.measured(), result["chosen"], picture, expected)
                    result["picture"] = picture
            if write and swarm is not None and result["success"]:
                from crazychoir.radio.protocol.addresses import write_channels

                with outputs.writing("--write"):
                    write_channels(swarm, result["dongles"])
                    result["written"] = swarm
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    except KeyboardInterrupt:
        exit_interrupted(as_json)
    if as_json:
        write_json(result | outputs.told)
    else:
        ANSWER_CONSOLE.print(survey_table(found.measured(), result))
    outputs.say()
    raise typer.Exit(0 if result["success"] and not outputs.failed else 1)


def _survey_request(
    count: int | None,
    spacing: int,
    channels: str,
    drone: str | None,
    swarm: Path | None,
    write: bool,
    simulated: int | None,
) -> SurveyRequest:
    """Return the request, after a check of the options against each other."""
    from crazychoir.radio.protocol.channels import (
        RADIO_BAND,
        parse_channels,
        pick_channels,
    )

    those = {} if swarm is None else _dongles(swarm, write)
    count = count or len(those) or 1
    if write and count != len(those):
        found = f"{count} for the dongles {', '.join(those)} of {swarm}"
        raise ConfigError(
            "--dongles",
            found,
            f"{len(those)}, or leave it out: that is how many the file has",
        )
    candidates = parse_channels(channels)
    # Raises ConfigError if the candidates have no room for so many channels.
    pick_channels(dict.fromkeys(candidates, (0.0, 0.0)), count, spacing)
    if simulated is not None and drone is not None:
        raise ConfigError(
            "--drone",
            "--simulated beside it",
            "one of them: no real drone hears a simulated radio",
        )
    if candidates[-1] > RADIO_BAND.licence_free_channel:
        ERROR_CONSOLE.print(
            f"Channels above {RADIO_BAND.licence_free_channel} lie outside the licence-free band of many countries."
        )
    if count > 1 and spacing < RADIO_BAND.least_spacing:
        ERROR_CONSOLE.print(
            f"Links of 2 Mbit/s disturb each other if there is less than {RADIO_BAND.least_spacing} MHz between them."
        )
    first = next((uris[0] for uris in those.values()), NEW_DRONE_URI)
    return SurveyRequest(candidates, count, spacing, those, drone or first, simulated)


def _dongles(swarm: Path, write: bool) -> dict[str, list[str]]:
    """Return the dongles of a valid swarm file, each with the uris of its drones.

    Raises ConfigError if the file must be written and cannot be.
    """
    from crazychoir.config.swarm_config import SwarmConfig
    from crazychoir.radio.protocol.addresses import (
        find_dongle_uris,
        read_swarm_text,
        require_writable,
    )

    SwarmConfig.load(swarm)
    if write:
        require_writable(swarm)
    return find_dongle_uris(read_swarm_text(swarm), str(swarm))


def _measure_channels(
    wanted: SurveyRequest, passes: int, packets: int, as_json: bool
) -> "tuple[Survey, dict[int, float]]":
    """Measure while a live table shows the progress.

    Returns the survey and, for a simulated radio, the true share of each channel.
    """
    from crazychoir.radio.survey.survey import Survey
    from crazychoir.radio.survey.survey import run_survey as measure

    found = Survey(wanted.channels, passes, packets, seed=wanted.simulated or 0)
    shown = LiveTable(progress_table, enabled=ERROR_CONSOLE.is_terminal and not as_json)
    with _probe(wanted) as (probe, room), shown as progress:
        measure(found, probe, lambda found, visit: progress((found, visit)))
    return found, {} if room is None else {
        channel: room.expected(channel) for channel in wanted.channels
    }


def _result(
    wanted: SurveyRequest, found: "Survey", expected: dict[int, float]
) -> dict[str, Any]:
    """Return the JSON object.

    The survey succeeds if some packets came through in each pass on each picked channel.
    """
    chosen = found.pick(wanted.count, wanted.spacing)
    rows = found.measured()
    worst = min(row.worst for row in rows if row.channel in chosen)
    return {
        "success": worst > 0.0,
        "chosen": list(chosen),
        "worst_ack_rate": worst,
        "spacing_mhz": wanted.spacing,
        "dongles": dict(zip(wanted.dongles, chosen, strict=False)),
        "channels": [row_of(row, chosen, expected) for row in rows],
        "simulated": wanted.simulated,
        "picture": None,
        "written": None,
    }


@contextlib.contextmanager
def _probe(wanted: SurveyRequest) -> "Iterator[tuple[Probe, RadioRoom | None]]":
    if wanted.simulated is not None:
        from crazychoir.radio.survey.simulated_radio import SimulatedRadio, random_room

        room = random_room(wanted.simulated, wanted.channels)
        yield SimulatedRadio(room, wanted.simulated), room
        return
    from crazychoir.radio.survey.survey_radio import open_probe

    with open_probe(wanted.drone, time.perf_counter) as probe:
        yield probe, None


@app.command()
def ping(
    uris: Annotated[
        list[str],
        typer.Argument(
            help="Drones, as udp://127.0.0.1:19850 or radio://0/80/2M/E7E7E7E701."
        ),
    ],
    count: Annotated[int, options.whole("Echoes to each.")] = 100,
    deadline: Annotated[
        float, options.seconds("s after which it ends.", least=0.1)
    ] = 20.0,
    as_json: JsonOption = False,
) -> None:
    """Measure the round trip to drones by echoes, all at once. Exits with 0 only if
    none is lost.

    It opens links of its own, so do not use it on a drone in flight.
    """
    set_up_logging()
    from crazychoir.radio.survey import ping as echo

    try:
        wanted = [echo.require_uri(uri) for uri in uris]
        with redirect_prints():
            found = echo.ping(
                list(dict.fromkeys(wanted)), time.perf_counter, count, deadline
            )
    except CrazyChoirError as error:
        exit_with_error(error, as_json)
    except KeyboardInterrupt:
        exit_interrupted(as_json)
    success = all(not one.error and one.lost == 0 for one in found)
    if as_json:
        write_json({"success": success, "links": [_link(one) for one in found]})
    else:
        ANSWER_CONSOLE.print(_ping_table(found))
    raise typer.Exit(0 if success else 1)


def _link(one: "PingResult") -> dict[str, Any]:
    times = {f"p{share}_s": one.percentile(share) for share in (50, 95, 99)}
    return {
        "uri": one.uri,
        "sent": one.sent,
        "lost": one.lost,
        **times,
        "error": one.error,
    }


def _ping_table(found: "Sequence[PingResult]") -> Group:
    """Return a table with one row a drone, and the errors."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    table.add_column("drone")
    for name in ("sent", "lost", "50 %", "95 %", "99 %"):
        table.add_column(name, justify="right")
    for one in found:
        times = [one.percentile(share) for share in (50, 95, 99)]
        table.add_row(
            one.uri,
            str(one.sent),
            str(one.lost),
            *("" if s is None else f"{1e3 * s:.2f} ms" for s in times),
        )
    return Group(
        table, *(Text(f"{one.uri}: {one.error}", "red") for one in found if one.error)
    )
