"""Fly a mission from Python, or read a recording: both give a Flight."""

import os
import shutil
import tempfile
import weakref
from collections.abc import Mapping
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from crazychoir.api.flight_request import FlightRequest
from crazychoir.api.flying import (
    ChosenFlight,
    fly_in_real_time,
    fly_in_virtual_time,
    require_flyable,
)
from crazychoir.api.recorded_data import RecordedData, read_data, restore_ids
from crazychoir.api.tracks import Track, build_frame, build_track
from crazychoir.bus.json_view import to_plain_values
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, refuse_exit
from crazychoir.files.output_files import output_file
from crazychoir.guidance.mission import check_before_flight
from crazychoir.launch.fork_server import ForkServer
from crazychoir.recording.mcap.file import RECORDING_FORMAT

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

SHOWN_FIGURES = (
    "mission",
    "drones",
    "simulated_s",
    "min_separation_m",
    "formation_error_m",
    "settling_s",
    "cost",
    "messages",
    "digest",
)
"""Figures of the short table in a notebook, where a flight has them."""


class Flight:
    """A flight that has ended: its figures, the tracks of its drones, and its recording.

    `fly` and `read` make it.

    path: its recording
    figures: what `crazychoir run --json` prints; of a recording without times of the wall clock.
        Dictionaries of drones have their ids as keys
    """

    def __init__(self, path: Path, figures: dict[str, Any]) -> None:
        self.path = path
        self.figures = figures

    @property
    def success(self) -> bool:
        """Whether the mission succeeded."""
        return bool(self.figures["success"])

    @property
    def reasons(self) -> dict[int, str]:
        """{drone id: why it failed}."""
        return dict(self.figures["reasons"])

    @property
    def digest(self) -> str | None:
        """Digest of the flight: equal flights in virtual time have the same; None in real time."""
        digest: str | None = self.figures["digest"]
        return digest

    @property
    def ids(self) -> tuple[int, ...]:
        """The drones with a track."""
        return tuple(track.drone for track in self.data.flight.tracks)

    @cached_property
    def data(self) -> RecordedData:
        """All that the recording holds, as `crazychoir plot` reads it."""
        return read_data(self.path)

    def track(self, i: int) -> Track:
        """Return the track of drone i as a structured array (n,) of TRACK_DTYPE.

        `flight.track(3)["position"]` is (n, 3), in m. The fields are in api/README.md.
        Raises ConfigError if the recording has no drone i.
        """
        for track in self.data.flight.tracks:
            if track.drone == i:
                return build_track(track)
        raise ConfigError("track", f"drone {i}", f"drones {list(self.ids)}")

    def frame(self) -> "DataFrame":
        """Return the tracks of all drones as one table of pandas, a row a drone and time.

        Raises ConfigError if pandas is not installed.
        """
        return build_frame(self.data.flight.tracks)

    def plot(self, *names: str) -> "Figure":
        """Return a figure of matplotlib with one panel a name, side by side.

        names: of "top", "space", "tracking", "heights", "separation", "tasks", "messages" and
            "convergence"; without any, "top" and "heights"
        Raises ConfigError for a panel that cannot be drawn.
        """
        from crazychoir.api.pictures import draw_panels

        pictures, missing = self.data.pictures()
        return draw_panels(pictures, missing, names or ("top", "heights"))

    def save(self, path: str | Path) -> None:
        """Write the recording (MCAP) to a file; an existing file is replaced.

        Raises ConfigError if the name does not end in .mcap, or if the file cannot be written.
        """
        if Path(path).suffix != RECORDING_FORMAT.suffix:
            allowed = f"a name that ends in {RECORDING_FORMAT.suffix}"
            raise ConfigError("save", str(path), allowed)
        with output_file(path, "save") as place:
            shutil.copyfile(self.path, place)

    def __repr__(self) -> str:
        ended = "success" if self.success else "failed"
        return f"<Flight of {Path(str(self.figures['mission'])).name}: {ended}>"

    def _repr_html_(self) -> str:
        """Return a short table for a notebook."""
        rows = {"success": "yes" if self.success else "no"}
        rows |= {
            name: _format_figure(self.figures[name])
            for name in SHOWN_FIGURES
            if self.figures.get(name) is not None
        }
        if self.figures.get("reason"):
            rows["reason"] = str(self.figures["reason"])
        rows |= {f"drone {i}": text for i, text in self.reasons.items()}
        cells = "".join(
            f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>"
            for name, text in rows.items()
        )
        return f"<table>{cells}</table>"


def fly(
    mission: object,
    *,
    drones: int | None = None,
    swarm: str | Path | SwarmConfig | None = None,
    seed: int | None = None,
    loss: float | None = None,
    options: Mapping[str, Any] | None = None,
    fast: bool = True,
    record: str | Path | None = None,
    processes: int | None = None,
) -> Flight:
    """Fly a mission, and return the flight when all drones have landed.

    It works in a script and in a notebook.

    mission: name of a mission, path of a mission file (.py) or of a swarm file (.toml), a class of
        guidance, a function guidance(i, config), or a module or object that has one
    drones: number of drones, if the mission allows it
    swarm: swarm file or swarm, instead of the mission's own swarm
    seed: seed, instead of the swarm's
    loss: share of the messages between drones that is lost
    options: mission options by name; "network.delay" names a key in a table of the swarm file
    fast: True for virtual time in this process, False for real time in several processes
    record: new file (.mcap) for the recording; None: it lives as long as the flight
    processes: number of processes in real time; None: one a drone
    Raises ConfigError for a mission or value that is not allowed. A flight that fails raises nothing:
    see `Flight.success`.
    """
    what = os.fspath(mission) if isinstance(mission, os.PathLike) else mission
    source = os.fspath(swarm) if isinstance(swarm, os.PathLike) else swarm
    request = FlightRequest(what, drones, source, loss, seed, options or {})
    if fast and processes:
        allowed = "fast=False: virtual time is one process"
        raise ConfigError("processes", f"{processes} with fast=True", allowed)
    with refuse_exit("the mission"):
        config, chosen = request.choose()
        if not (fast or isinstance(what, str)):
            do = "Save it as a file: each process imports the mission by itself."
            raise ConfigError(
                "mission", repr(what), "in real time, a name or a file", do
            )
        require_flyable(config, config.ids, fast)
        check_before_flight(chosen, config)
    folder = None
    if record is None:
        folder = tempfile.mkdtemp(prefix="crazychoir-flight-")
        record = Path(folder) / f"flight{RECORDING_FORMAT.suffix}"
    named = what if isinstance(what, str) else str(config.mission)
    flight = ChosenFlight(named, request.swarm_file, chosen, config.ids, Path(record))
    try:
        if fast:
            _, result = fly_in_virtual_time(flight, config)
        else:
            with ForkServer() as server:
                _, result = fly_in_real_time(server, flight, config, processes)
    except BaseException:
        if folder is not None:
            shutil.rmtree(folder, ignore_errors=True)
        raise
    del result["tracks"]
    flown = Flight(Path(record), restore_ids(to_plain_values(result)))
    if folder is not None:
        weakref.finalize(flown, shutil.rmtree, folder, ignore_errors=True)
    return flown


def read(path: str | Path) -> Flight:
    """Return the flight of a recording, of simulated or of real drones.

    path: file of `fly(record=...)`, `crazychoir run --record` or `crazychoir record`
    Raises ConfigError if the file is no recording of a flight.
    """
    data = read_data(Path(path))
    flight = Flight(Path(path), data.run_figures())
    flight.data = data
    return flight


def _format_figure(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key}: {_format_figure(one)}" for key, one in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)
