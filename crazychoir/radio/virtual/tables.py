"""The tables of contents of a drone; all drones with the same decks and batteries share them."""

from dataclasses import dataclass, replace
from functools import cache

from crazychoir.platforms import Firmware
from crazychoir.radio.virtual.logs import make_log_toc
from crazychoir.radio.virtual.parameters import make_parameter_toc
from crazychoir.radio.virtual.toc import Toc, TocEntry, read_firmware_names


@dataclass(frozen=True)
class DroneTables:
    """The tables of contents of one drone."""

    logs: Toc
    """Table of the log variables."""
    parameters: Toc
    """Table of the parameters."""


@cache
def make_tables(decks: tuple[str, ...], low: float, critical: float) -> DroneTables:
    """Return the tables of a drone.

    decks: decks that it carries
    low: V: battery voltage below which the battery is low
    critical: V: battery voltage below which the drone shuts down
    """
    logs, parameters = read_firmware_names()
    levels = {"pm.lowVoltage": low, "pm.criticalLowVoltage": critical}
    return DroneTables(
        make_log_toc(tuple(e for e in logs if e.is_on_board(decks))),
        make_parameter_toc(
            tuple(_set_level(e, levels) for e in parameters if e.is_on_board(decks))
        ),
    )


def tables_of(decks: tuple[str, ...], firmware: Firmware) -> DroneTables:
    """Return the tables of a drone with these decks and the levels of its platform's firmware."""
    return make_tables(decks, firmware.low, firmware.critical)


def _set_level(entry: TocEntry, levels: dict[str, float]) -> TocEntry:
    """Return the entry with the level of the platform, if it is a level."""
    if entry.full not in levels:
        return entry
    level = levels[entry.full]
    return replace(entry, boot=level, default=level)
