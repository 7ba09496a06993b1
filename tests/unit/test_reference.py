"""The generated parts of the README files are what the code says now."""

import re
from dataclasses import replace

import pytest
from reference import command_lines, safety_rules, swarm_file
from reference.pages import BEGIN, END, SOURCES, generated, with_parts

PAGE = f"Before.\n\n{BEGIN}\nold\n{END}\n\nAfter.\n"


@pytest.mark.parametrize("page", SOURCES)
def test_page_shows_what_the_code_says(repository, page):
    stale = f"{page} is not what the code says: run `make reference`"
    assert (repository / page).read_text() == generated(repository, page), stale


def test_only_the_text_between_the_marks_is_replaced():
    assert with_parts(PAGE, ["new"]) == PAGE.replace("old", "new")


def test_a_page_without_its_marks_is_refused():
    with pytest.raises(ValueError, match="2 generated parts"):
        with_parts(PAGE, ["one", "two"])
    with pytest.raises(ValueError, match="1 generated parts"):
        with_parts(PAGE.replace(END, ""), ["new"])


def test_another_limit_of_the_guard_makes_another_table(monkeypatch):
    before = safety_rules.table()
    for name in ("SIMULATED", "RADIO_SAFETY_TABLE", "ON_BOARD_SAFETY_TABLE"):
        first, *others = getattr(safety_rules, name)
        changed = (replace(first, limit=0.17), *others)
        monkeypatch.setattr(safety_rules, name, changed)
    assert "0.17" not in before
    limit = f"| {first.limit:.2f} |"
    assert safety_rules.table() == before.replace(limit, "| 0.17 |", 1)


def test_every_table_of_a_swarm_file_has_a_section():
    text = swarm_file.tables()
    for path in ("[[drones]]", "[[network.edges]]", "[[radio.dongles]]", "[collision]"):
        assert f"\n## `{path}`\n" in text


def test_commands_of_groups_and_programs_are_listed():
    text = command_lines.pages()
    for line in (
        "virtual",
        "virtual faults",
        "mocap calibrate DRONE",
        "bench exchange",
    ):
        assert f"\n### `crazychoir {line}`\n" in text
    assert "\n### `crazychoir-radio`\n" in text


UNIT_OF_VALUE = re.compile(r" in ([\w/]+)")
UNIT_OF_MEANING = re.compile(r"(?:\(\d,\) )?(m/s2|m/s|1/s|rad/s2|m|s|rad|V|Hz)[ :.,]")


def test_the_value_of_a_key_has_the_unit_of_its_meaning():
    """Compare the rows with one of the common units at the start of the meaning."""
    compared = []
    for line in swarm_file.tables().splitlines():
        cells = line.strip("| ").split(" | ")
        meaning = UNIT_OF_MEANING.match(cells[-1])
        if not (line.startswith("| `") and meaning) or " per " in cells[1]:
            continue
        value = UNIT_OF_VALUE.search(cells[1])
        assert value is not None, line
        assert value[1].rstrip(",") == meaning[1], line
        compared.append(cells[0])
    assert len(compared) > 40
