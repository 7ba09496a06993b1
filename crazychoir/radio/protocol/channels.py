"""Channels of the Crazyradio, and which k of them to take: channel c lies at 2400 + c MHz, 0 to 125."""

from collections.abc import Mapping, Sequence

from crazychoir.config.number_lists import parse_spans
from crazychoir.errors import ConfigError

LAST = 125
LICENSED = 83
"""Above it lies outside the licence-free 2.4 GHz band of many countries, which ends at 2483.5 MHz."""
LEAST_SPACING = 2
"""MHz that two links of 2 Mbit/s need: each is so wide."""
WIFI = {1: 12, 6: 37, 11: 62}
"""The Crazyradio's channel in the middle of each WiFi channel that does not overlap another."""
WIFI_HALF = 11
"""MHz to each side that a WiFi channel is wide."""


def frequency(channel: int) -> int:
    """MHz."""
    return 2400 + channel


def parse_channels(text: str, where: str = "--channels") -> tuple[int, ...]:
    """The channels of a text such as "2-82:2", each second from 2 to 82, or "4,20-30,76"; increasing, each once."""
    allowed = f"channels 0 to {LAST}, as 2-82:2 (each second) or 4,20-30,76"
    return tuple(sorted(parse_spans(text, where, allowed, LAST, steps=True)))


def pick(
    scores: Mapping[int, Sequence[float]], k: int, spacing: int
) -> tuple[int, ...]:
    """The k channels, increasing, no two closer than `spacing` MHz, that maximise the least score among them.

        max_C  min_{c in C} s_c[0]     over  |C| = k,  |c - d| >= spacing  for c, d in C, c /= d

    Of several such C the one whose further scores s_c[1], added up, are most; of those the one with the lowest
    channels. scores: {channel: (what counts, what decides between equals)}.
    Raises ConfigError where there are no such k.
    """
    channels = sorted(scores)
    least = _bottleneck({c: scores[c][0] for c in channels}, k, spacing)
    return _best_sum(
        {c: scores[c][1] for c in channels if scores[c][0] >= least}, k, spacing
    )


def _bottleneck(scores: Mapping[int, float], k: int, spacing: int) -> float:
    """The largest score such that k channels of at least that have the spacing."""
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
    """As many of the increasing channels as the spacing allows: each time the lowest that is far enough."""
    taken: list[int] = []
    for c in channels:
        if not taken or c - taken[-1] >= spacing:
            taken.append(c)
    return taken


def _best_sum(values: Mapping[int, float], k: int, spacing: int) -> tuple[int, ...]:
    """The k channels with the spacing of the largest sum, of those the lowest; k of them there must be.

    best[n][m]: sum and channels of the best m of the last n;  with the channel before: it and the best m - 1 of those
    that are far enough.
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
