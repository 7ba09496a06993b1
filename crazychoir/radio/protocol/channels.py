"""The Crazyradio's channels 0 to 125, and the choice of the k best.

Channel c is at 2400 + c MHz.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from crazychoir.config.number_lists import parse_spans
from crazychoir.errors import ConfigError


@dataclass(frozen=True, slots=True)
class RadioBand:
    """The Crazyradio's channels, and the widths of its links and of WiFi."""

    highest_channel: int = 125
    """Highest channel."""
    licence_free_channel: int = 83
    """Highest channel in the licence-free 2.4 GHz band of many countries, which ends at 2483.5
    MHz.
    """
    least_spacing: int = 2
    """MHz between two links of 2 Mbit/s: each is so wide."""
    wifi_half_width: int = 11
    """MHz by which a WiFi channel extends to each side of its centre."""


RADIO_BAND = RadioBand()


WIFI_CENTRES = {1: 12, 6: 37, 11: 62}
"""Crazyradio channel at the centre of each of the WiFi channels that do not overlap."""


def frequency(channel: int) -> int:
    """Return the frequency of a channel in MHz."""
    return 2400 + channel


def parse_channels(text: str, where: str = "--channels") -> tuple[int, ...]:
    """Return the channels of a text, sorted, each once.

    "2-82:2" is every second channel from 2 to 82; another example is "4,20-30,76".
    """
    allowed = f"channels 0 to {RADIO_BAND.highest_channel}, as 2-82:2 (each second) or 4,20-30,76"
    return tuple(
        sorted(
            parse_spans(text, where, allowed, RADIO_BAND.highest_channel, steps=True)
        )
    )


def pick_channels(
    scores: Mapping[int, Sequence[float]], k: int, spacing: int
) -> tuple[int, ...]:
    """Return the k channels with the largest minimal score; no two are closer than `spacing` MHz.

        max_C  min_{c in C} s_c[0]     over  |C| = k,  |c - d| >= spacing  for c, d in C, c /= d

    Among equal sets C it takes the one with the largest sum of second scores s_c[1], then the one
    with the lowest channels. The channels are returned in increasing order.

    scores: {channel: (score that counts, score that decides between equals)}
    spacing: MHz
    Raises ConfigError if there is no such set.
    """
    channels = sorted(scores)
    least = _bottleneck({c: scores[c][0] for c in channels}, k, spacing)
    return _best_sum(
        {c: scores[c][1] for c in channels if scores[c][0] >= least}, k, spacing
    )


def _bottleneck(scores: Mapping[int, float], k: int, spacing: int) -> float:
    """Return the largest score such that k channels with at least this score have the spacing."""
    for least in sorted(set(scores.values()), reverse=True):
        if len(_leftmost([c for c in scores if scores[c] >= least], spacing)) >= k:
            return least
    most = len(_leftmost(list(scores), spacing))
    do = "Let it try more channels, or take fewer dongles or a smaller spacing."
    raise ConfigError(
        f"{k} channels with {spacing} MHz between them",
        f"room for {most}",
        f"at most {most}",
        do,
    )


def _leftmost(channels: Sequence[int], spacing: int) -> list[int]:
    """Return as many of the increasing channels as the spacing allows.

    It always takes the lowest that is far enough.
    """
    taken: list[int] = []
    for c in channels:
        if not taken or c - taken[-1] >= spacing:
            taken.append(c)
    return taken


def _best_sum(values: Mapping[int, float], k: int, spacing: int) -> tuple[int, ...]:
    """Return the k channels with the spacing and the largest sum; among equals the lowest.

    There must be k such channels. best[n][m] holds the sum and channels of the best m among the
    last n channels. A solution that contains the next channel is that channel with the best m - 1
    of the channels that are far enough.
    """
    channels = list(values)
    best: list[dict[int, tuple[float, tuple[int, ...]]]] = [{0: (0.0, ())}]
    for n, c in enumerate(reversed(channels), start=1):
        far = sum(d - c >= spacing for d in channels)
        with_c = {
            m + 1: (values[c] + rest, (c, *those))
            for m, (rest, those) in best[far].items()
        }
        without = best[n - 1]
        best.append(
            without
            | {
                m: one
                for m, one in with_c.items()
                if m not in without or one[0] >= without[m][0]
            }
        )
    return best[-1][k][1]
