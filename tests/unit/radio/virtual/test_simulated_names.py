"""The table of the README that counts which names of the firmware are simulated."""

from pathlib import Path

from virtual_drones import Hangar

from crazychoir.radio.virtual.parameter_effects import is_modelled
from crazychoir.radio.virtual.toc import read_firmware_names

README = Path("crazychoir/radio/README.md")


def count_names(decks):
    """Return the counts of a drone with these decks, in the order of the table's columns."""
    drone = Hangar(decks=decks).drone
    logs = drone.logs.toc.entries
    parameters = drone.parameters.toc.entries
    writable = [entry for entry in parameters if not entry.read_only]
    modelled = [entry for entry in writable if is_modelled(entry.full)]
    return (
        len(logs),
        sum(drone.computes(entry.full) for entry in logs),
        len(parameters),
        len(modelled),
        len(writable) - len(modelled),
        len(parameters) - len(writable),
    )


def add_row(label, counts):
    return f"| {label} | " + " | ".join(str(count) for count in counts) + " |"


def make_rows():
    """Return the rows of the table: a drone without decks, then what decks add."""
    bare = count_names(())
    flags = sum(entry.deck == "any" for entry in read_firmware_names()[1])
    rows = [add_row("none", bare)]
    rows.append(add_row("any deck adds", (0, 0, flags, 0, 0, flags)))
    entries = [entry for table in read_firmware_names() for entry in table]
    names = sorted({e.deck for e in entries} - {"", "any", "other"})
    for deck in names:
        with_deck = count_names((deck.split("|")[0],))
        added = [more - less for more, less in zip(with_deck, bare, strict=True)]
        added[2] -= flags
        added[5] -= flags
        rows.append(add_row(f"`{deck.replace('|', '`, `')}` adds", added))
    return rows


def test_a_drone_without_decks_has_the_firmwares_names_and_most_are_simulated():
    logs, computed, parameters, modelled, inert, read_only = count_names(())
    assert (logs, parameters) == (434, 271)
    assert modelled + inert + read_only == parameters
    assert computed >= 266
    assert modelled >= 157


def test_the_readme_counts_what_is_simulated(repository):
    rows = make_rows()
    lines = (repository / README).read_text(encoding="utf-8").splitlines()
    missing = [row for row in rows if row not in lines]
    assert not missing, "write these rows into the table:\n" + "\n".join(rows)
