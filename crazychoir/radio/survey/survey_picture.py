"""A picture of a survey for a page or a paper."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from crazychoir.files.output_files import save_figure
from crazychoir.optimization.picture import PICTURE_STYLE
from crazychoir.radio.protocol.channels import RADIO_BAND, WIFI_CENTRES, frequency
from crazychoir.radio.survey.survey import ChannelResult

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, slots=True)
class SurveyColours:
    """Colours of the picture."""

    measured: str = PICTURE_STYLE.colours[0]
    """Colour of measured channels: blue."""
    picked: str = PICTURE_STYLE.colours[1]
    """Colour of picked channels: vermilion."""
    wifi_band: str = "#f0f0f0"
    """Colour of WiFi bands."""


SURVEY_COLOURS = SurveyColours()


def draw_survey(
    rows: Sequence[ChannelResult],
    chosen: Sequence[int],
    path: str | Path,
    expected: Mapping[int, float] | None = None,
) -> None:
    """Write a picture, in the format of the suffix of `path`.

    Above: the share of acknowledged packets by channel, from the worst pass to the best, and the
      mean. Below: how strongly
    the drone receives the dongle.

    rows: results by channel
    chosen: picked channels
    expected: {channel: true share} of a simulated radio, drawn as a line
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 4.6), dpi=200, layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1))
    _draw_rates(above, rows, chosen, expected or {})
    _draw_rssi(below, rows, chosen)
    for axes in (above, below):
        _draw_bands(axes)
        axes.grid(axis="y", color="#e6e6e6", linewidth=0.6)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
    below.set_xlabel("channel (2400 MHz + channel)")
    low = rows[0].channel - 2
    high = rows[-1].channel + 2
    below.set_xlim(low, high)
    _name_bands(above, low, high)
    figure.legend(loc="outside upper center", ncols=4, frameon=False, fontsize=8)
    save_figure(figure, path, bbox_inches="tight")


def _draw_rates(
    axes: "Axes",
    rows: Sequence[ChannelResult],
    chosen: Sequence[int],
    expected: Mapping[int, float],
) -> None:
    """Draw a bar for each channel, and label the picked ones."""
    for colour, label, those in _by_choice(rows, chosen):
        at = [row.channel for row in those]
        low = [100.0 * row.worst for row in those]
        high = [100.0 * max(row.passes) for row in those]
        axes.vlines(at, low, high, color=colour, linewidth=2.4, alpha=0.45)
        axes.plot(
            at,
            [100.0 * row.mean for row in those],
            "o",
            color=colour,
            markersize=3.6,
            label=label,
        )
        axes.plot(at, low, "_", color=colour, markersize=5.5, markeredgewidth=1.6)
    if expected:
        at = sorted(expected)
        axes.plot(
            at,
            [100.0 * expected[c] for c in at],
            color=PICTURE_STYLE.ink,
            linewidth=0.8,
            label="truth of the model",
        )
    for channel in chosen:
        axes.annotate(
            str(channel),
            (channel, 101.5),
            ha="center",
            va="bottom",
            color=SURVEY_COLOURS.picked,
            fontsize=8,
            weight="bold",
            annotation_clip=False,
        )
    axes.set_ylim(-3.0, 111.0)
    axes.set_yticks(range(0, 101, 20))
    axes.set_ylabel("acknowledged [%]\nworst, mean, best pass")


def _draw_rssi(
    axes: "Axes", rows: Sequence[ChannelResult], chosen: Sequence[int]
) -> None:
    for colour, _, those in _by_choice(rows, chosen):
        heard = [(row.channel, *row.rssi) for row in those if row.rssi is not None]
        if heard:
            at, mean, std = zip(*heard, strict=True)
            axes.errorbar(
                at,
                mean,
                yerr=std,
                fmt="o",
                color=colour,
                markersize=3.2,
                elinewidth=1.2,
                capsize=0.0,
            )
    axes.set_ylabel("rssi [dBm]\nmean ± std")


def _by_choice(
    rows: Sequence[ChannelResult], chosen: Sequence[int]
) -> list[tuple[str, str, list[ChannelResult]]]:
    """Return colour, label and rows: of the other channels, and of the picked ones."""
    free = [row for row in rows if row.channel not in chosen]
    taken = [row for row in rows if row.channel in chosen]
    return [
        (SURVEY_COLOURS.measured, "measured", free),
        (SURVEY_COLOURS.picked, "picked", taken),
    ]


def _draw_bands(axes: "Axes") -> None:
    """Draw the bands of WiFi."""
    for middle in WIFI_CENTRES.values():
        axes.axvspan(
            middle - RADIO_BAND.wifi_half_width,
            middle + RADIO_BAND.wifi_half_width,
            color=SURVEY_COLOURS.wifi_band,
            zorder=0,
            linewidth=0,
        )


def _name_bands(axes: "Axes", low: int, high: int) -> None:
    """Label the WiFi bands that have their centre inside the picture, above its upper edge."""
    for number, middle in WIFI_CENTRES.items():
        name = f"WiFi {number}, {frequency(middle)} MHz"
        if low < middle < high:
            axes.text(
                middle,
                113.0,
                name,
                ha="center",
                va="bottom",
                fontsize=7.5,
                color="#606060",
            )
