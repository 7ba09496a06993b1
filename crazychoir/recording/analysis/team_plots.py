"""Pictures of a team's work: activity over time, rates of messages, and convergence."""

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from crazychoir.guidance.feedback import LAW_TASK
from crazychoir.optimization.picture import PICTURE_STYLE
from crazychoir.recording.analysis.activity import ON_GROUND, FlightActivity
from crazychoir.recording.analysis.communication import MESSAGE_STATISTICS, TeamMessages
from crazychoir.recording.analysis.figures import RecordedFlight
from crazychoir.recording.analysis.plots import (
    REFERENCE_BAND_STYLE,
    Pictures,
    Reasons,
    add_drone_legend,
    add_flight_legend,
    line_styles,
    set_time_axis,
    styled_tracks,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PHASE_COLOURS = {
    ON_GROUND: "#e0e0e0",
    "taking off": "#56B4E9",
    "mission": "#0072B2",
    "hovering": "#F0E442",
    "returning": "#CC79A7",
    "landing": "#009E73",
    "stopped": "#D55E00",
}
"""Colours of the phases: those of Okabe and Ito, and a grey.

They also differ in lightness, for print without colours.
"""


@dataclass(frozen=True, slots=True)
class TeamPlotLimits:
    """Limits of the pictures of a team's work."""

    most_labelled_stops: int = 60
    """Largest number of stops that are labelled; more labels would cover each other."""
    letter_width: float = 0.017
    """Width of a letter of a stop's name, as a share of the picture's width."""
    most_channels: int = 4
    """Largest number of channels drawn in one picture."""
    least_value: float = 1e-6
    """Least value on a logarithmic axis, in m or in the units of messages; smaller values are
    raised.
    """
    averaged_end: float = 1.0
    """Seconds at the end of a drone's law over which its final position is averaged."""


TEAM_PLOT_LIMITS = TeamPlotLimits()


COUNTER_LABELS = {"lost": "lost (simulated)"}
"""Names in the legend of counters that need another name; a real network's losses are not counted.
"""
COST_LABELS = {"m": "length of all routes [m]", "s": "time until all are back [s]"}
"""Label of the cost, by its unit."""


def team_pictures(
    flight: RecordedFlight, work: FlightActivity, talk: TeamMessages
) -> tuple[Pictures, Reasons]:
    """Return the pictures that the recording has data for, and why others cannot be drawn."""
    pictures: Pictures = {}
    missing: Reasons = {}
    if work.flown:
        pictures["tasks"] = (
            max(1.6, 0.75 + 0.27 * len(work.drones)),
            partial(_draw_tasks, work=work),
        )
    else:
        missing["tasks"] = (
            "no drone has left the ground" if work.spans else "no status of any drone"
        )
    if len(talk.t):
        pictures["messages"] = (2.0, partial(_draw_messages, talk=talk))
    else:
        missing["messages"] = "no two statuses of a drone"
    times = law_times(work)
    if talk.history:
        pictures["convergence"] = (2.4, partial(_draw_history, talk=talk))
    elif any(track.drone in times for track in flight.tracks):
        pictures["convergence"] = (2.4, partial(_draw_law, flight=flight, work=work))
    elif talk.channels:
        pictures["convergence"] = (2.0, partial(_draw_rounds, talk=talk))
    else:
        missing["convergence"] = (
            "no result with planned routes, no law with truth or state, no rounds"
        )
    return pictures, missing


def law_times(work: FlightActivity) -> dict[int, tuple[float, float]]:
    """Return the interval in s in which each drone flew by a law."""
    spans = {
        i: [span for span in work.spans if span.drone == i and span.task == LAW_TASK]
        for i in work.drones
    }
    return {i: (of[0].begin, of[-1].end) for i, of in spans.items() if of}


def _draw_tasks(figure: "Figure", work: FlightActivity) -> None:
    """Draw a bar a drone in the colours of its phases, and a labelled mark at each completed stop."""
    axes = figure.add_subplot()
    rows = {i: -k for k, i in enumerate(work.drones)}
    for span in work.spans:
        bar: Any = {
            "color": PHASE_COLOURS.get(span.phase, PICTURE_STYLE.ink),
            "height": 0.5,
            "linewidth": 0.0,
        }
        axes.barh(rows[span.drone], span.end - span.begin, left=span.begin, **bar)
    for stop in work.stops:
        row = rows[stop.drone]
        axes.plot(
            [stop.t, stop.t],
            [row - 0.25, row + 0.33],
            color="black",
            linewidth=0.7,
            solid_capstyle="butt",
        )
    last = max(span.end for span in work.spans)
    if len(work.stops) <= TEAM_PLOT_LIMITS.most_labelled_stops:
        _name_stops(axes, work, rows, last)
    axes.set_yticks(list(rows.values()), [str(i) for i in rows])
    axes.set_ylim(min(rows.values()) - 0.65, 0.85)
    axes.grid(visible=False, axis="y")
    set_time_axis(axes, last, "drone")
    seen = [
        phase
        for phase in PHASE_COLOURS
        if any(span.phase == phase for span in work.spans)
    ]
    _name_phases(figure, seen, bool(work.stops))


def _name_stops(
    axes: Any, work: FlightActivity, rows: dict[int, int], last: float
) -> None:
    """Write the stops' names above the bars, or below where the previous name would be covered."""
    ends: dict[int, float] = {}
    for stop in work.stops:
        row = rows[stop.drone]
        half = 0.5 * TEAM_PLOT_LIMITS.letter_width * last * len(stop.label)
        above = stop.t - half >= ends.get(stop.drone, 0.0)
        if above:
            ends[stop.drone] = stop.t + half
        y, to = (row + 0.33, "bottom") if above else (row - 0.27, "top")
        axes.text(
            stop.t, y, stop.label, fontsize=5.5, color="black", ha="center", va=to
        )


def _name_phases(figure: "Figure", seen: list[str], stopped: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [
        Patch(color=PHASE_COLOURS[phase], label=phase) for phase in seen
    ]
    if stopped:
        mark: Any = {"color": "black", "marker": "|", "linestyle": "", "markersize": 6}
        handles.append(Line2D([], [], label="stop done", **mark))
    figure.legend(
        handles=handles, loc="outside upper center", ncols=3, handlelength=1.2
    )


def _draw_messages(figure: "Figure", talk: TeamMessages) -> None:
    axes = figure.add_subplot()
    for label, rate, colour, dash in zip(
        MESSAGE_STATISTICS.counters,
        talk.rates.T,
        PICTURE_STYLE.colours,
        PICTURE_STYLE.dashes,
        strict=False,
    ):
        axes.plot(
            talk.t,
            rate,
            color=colour,
            linestyle=dash,
            label=COUNTER_LABELS.get(label, label),
        )
    axes.set_ylim(bottom=0.0)
    set_time_axis(axes, float(talk.t[-1]), "messages of all [1/s]")
    figure.legend(loc="outside upper center", ncols=3)


def _draw_history(figure: "Figure", talk: TeamMessages) -> None:
    """Draw what each drone knew in each round: value of the relaxation, cost of the best plan."""
    axes = figure.add_subplot()
    last = max(float(own[-1, 0]) for own in talk.history.values())
    for line, (_, own) in zip(
        line_styles(len(talk.history)), sorted(talk.history.items()), strict=True
    ):
        rounds = np.append(own[:, 0], last + 1)
        axes.step(rounds, np.append(own[:, 1], own[-1, 1]), where="post", **line)
        axes.step(
            rounds,
            np.append(own[:, 2], own[-1, 2]),
            where="post",
            **REFERENCE_BAND_STYLE,
        )
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("round")
    axes.set_ylabel(COST_LABELS[talk.unit])
    add_drone_legend(figure, [str(i) for i in sorted(talk.history)], band="best plan")


def _draw_law(figure: "Figure", flight: RecordedFlight, work: FlightActivity) -> None:
    """Draw how far each drone is from its position at the end of its law, on a logarithmic axis."""
    axes = figure.add_subplot()
    times = law_times(work)
    last = 0.0
    for line, track in styled_tracks(flight):
        if track.drone not in times:
            continue
        begin, end = times[track.drone]
        during = (track.t >= begin) & (track.t <= end)
        if np.any(during):
            p = track.p[during]
            there = p[track.t[during] >= end - TEAM_PLOT_LIMITS.averaged_end].mean(
                axis=0
            )
            axes.semilogy(
                track.t[during] - begin,
                np.maximum(
                    np.linalg.norm(p - there, axis=1), TEAM_PLOT_LIMITS.least_value
                ),
                **line,
            )
            last = max(last, end - begin)
    set_time_axis(axes, last, "distance from end [m]")
    axes.set_xlabel("$t$ since the law began [s]")
    add_flight_legend(figure, flight)


def _draw_rounds(figure: "Figure", talk: TeamMessages) -> None:
    """Draw how the messages of a round converge.

    The quantity is their spread if all are numbers, else the count of different messages.
    """
    axes = figure.add_subplot()
    chosen = sorted(talk.channels, key=lambda channel: -len(channel.rounds))[
        : TEAM_PLOT_LIMITS.most_channels
    ]
    numbers = all(channel.spread is not None for channel in chosen)
    for channel, colour, dash in zip(
        chosen, PICTURE_STYLE.colours, PICTURE_STYLE.dashes, strict=False
    ):
        look: Any = {"color": colour, "linestyle": dash, "label": channel.name}
        if numbers and channel.spread is not None:
            axes.semilogy(
                channel.rounds,
                np.maximum(channel.spread, TEAM_PLOT_LIMITS.least_value),
                **look,
            )
        else:
            axes.step(channel.rounds, channel.different, where="mid", **look)
    if not numbers:
        axes.set_ylim(
            0.0, max(float(channel.different.max()) for channel in chosen) + 0.5
        )
    axes.set_xlabel("round")
    axes.set_ylabel("distance from the mean" if numbers else "different messages")
    figure.legend(loc="outside upper center", ncols=2)
