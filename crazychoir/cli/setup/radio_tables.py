"""The tables and texts of `crazychoir radio survey`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from crazychoir.radio.protocol.channels import frequency

if TYPE_CHECKING:
    from crazychoir.radio.survey.survey import ChannelResult, Survey, Visit


@dataclass(frozen=True, slots=True)
class ShareScale:
    """How a share of acknowledged packets is shown."""

    blocks: str = " ▁▂▃▄▅▆▇█"
    """Blocks of the live picture: the share of acknowledged packets, from none to all."""
    good_share: float = 0.95
    """Smallest share of acknowledged packets that is shown in green."""
    fair_share: float = 0.8
    """Smallest share of acknowledged packets that is shown in yellow."""


SHARE_SCALE = ShareScale()


def progress_table(seen: "tuple[Survey, Visit]") -> Group:
    """Return the progress, and the worst pass of each channel so far as a row of blocks."""
    found, visit = seen
    rows = found.measured()
    done = sum(len(row.passes) for row in rows) / (found.passes * len(found.channels))
    head = f"pass {visit.number + 1} of {found.passes}, channel {visit.channel:3d}: {done:4.0%}"
    bars = Text(f"{rows[0].channel} ")
    for row in rows:
        bars.append(
            SHARE_SCALE.blocks[round(row.worst * (len(SHARE_SCALE.blocks) - 1))],
            _colour(row.worst),
        )
    bars.append(f" {rows[-1].channel}")
    return Group(Text(head), bars, Text("worst pass of each channel so far", "dim"))


def _colour(share: float) -> str:
    if share >= SHARE_SCALE.good_share:
        return "green"
    return "yellow" if share >= SHARE_SCALE.fair_share else "red"


def row_of(
    row: "ChannelResult", chosen: Sequence[int], expected: Mapping[int, float]
) -> dict[str, Any]:
    """Return a channel as a JSON object; expected: true share by channel, of a simulated radio."""
    p50, p95 = row.round_trip or (None, None)
    mean, std = row.rssi or (None, None)
    known = (
        {"expected_ack_rate": expected[row.channel]} if row.channel in expected else {}
    )
    return {
        "channel": row.channel,
        "frequency_mhz": frequency(row.channel),
        "chosen": row.channel in chosen,
        "worst_pass": row.worst,
        "ack_rate": row.mean,
        "passes": list(row.passes),
        "retries": list(row.retries[:-1]),
        "lost_with_retries": row.retries[-1],
        "round_trip_p50_s": p50,
        "round_trip_p95_s": p95,
        "rssi_dbm": mean,
        "rssi_std_db": std,
        **known,
    }


def survey_table(rows: "Sequence[ChannelResult]", result: Mapping[str, Any]) -> Group:
    """Return a table with one row a channel, and the result as text."""
    chosen = result["chosen"]
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    heads = (
        "\nchannel",
        "",
        "worst\npass %",
        "\nmean %",
        "0/1/2/3 retries,\nlost %",
        "50/95 %\nms",
        "\nrssi dBm",
    )
    for name in heads:
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(
            *_cells(row, row.channel in chosen),
            style="bold" if row.channel in chosen else "",
        )
    return Group(table, *(Text(line) for line in _lines(result)))


def _cells(row: "ChannelResult", chosen: bool) -> tuple[str | Text, ...]:
    packets = sum(row.retries)
    *counts, lost = (f"{100 * n / packets:.0f}" for n in row.retries)
    trip = (
        ""
        if row.round_trip is None
        else "/".join(f"{1000 * s:.1f}" for s in row.round_trip)
    )
    rssi = "" if row.rssi is None else f"{row.rssi[0]:.0f} ± {row.rssi[1]:.1f}"
    return (
        str(row.channel),
        "◀" if chosen else "",
        Text(f"{100 * row.worst:.0f}", _colour(row.worst)),
        f"{100 * row.mean:.1f}",
        f"{'/'.join(counts)}, {lost}",
        trip,
        rssi,
    )


def _lines(result: Mapping[str, Any]) -> list[str]:
    """Return lines with the picked channels, their dongles and the files written."""
    worst = result["worst_ack_rate"]
    names = ", ".join(
        f"{channel} ({frequency(channel)} MHz)" for channel in result["chosen"]
    )
    of = " of the worst of them" if len(result["chosen"]) > 1 else ""
    lines = [f"Picked: {names}. In the worst pass{of} {worst:.0%} came through."]
    if worst < SHARE_SCALE.fair_share:
        lines.append(
            "This is a low share: use fewer dongles, a smaller spacing, more --channels, or another room."
        )
    pairs = ", ".join(
        f"dongle {name}: {channel}" for name, channel in result["dongles"].items()
    )
    if pairs:
        done = (
            f"Written into {result['written']}"
            if result["written"]
            else "Not written (see --write)"
        )
        lines.append(f"{done}: {pairs}")
    return lines + ([f"Picture: {result['picture']}"] if result["picture"] else [])
