"""The missions and their options as `crazychoir missions` lists them."""

import pytest

from crazychoir.guidance.mission import list_mission_names
from crazychoir.guidance.mission_listing import (
    describe_mission,
    list_summaries,
    read_summary,
)

MISSION = '''"""Hover somewhere.

More about it.
"""

from crazychoir import CFDistributedFeedback
from crazychoir.config.tables import SwarmTable
from crazychoir.guidance.mission_options import Length


class Options(SwarmTable, frozen=True, kw_only=True):
    above: Length = 1.2
    """m: height of
    the flight."""
    size: Length
    count: int = 3


class Hover(CFDistributedFeedback):
    def step(self, me, heard):
        return None


def guidance(i, config):
    return Hover()
'''


@pytest.mark.parametrize("name", list_mission_names())
def test_every_option_of_a_mission_has_its_meaning(name):
    found = describe_mission(name)
    assert found.summary == list_summaries()[name]
    for entry in (*found.mission_options, *found.drone_options):
        assert entry.value, entry
        assert entry.meaning, entry


def test_options_of_a_users_file_are_found(tmp_path):
    file = tmp_path / "hover_somewhere.py"
    file.write_text(MISSION)
    found = describe_mission(str(file))
    above, size, count = found.mission_options
    assert found.summary == "Hover somewhere."
    assert (above.option, above.default) == ("above", 1.2)
    assert above.meaning == "m: height of the flight."
    assert (size.option, size.default, size.meaning) == ("size", None, "")
    assert (count.value, count.default) == ("int", 3)
    assert found.drone_options == ()


def test_a_file_without_a_docstring_has_no_summary(tmp_path):
    file = tmp_path / "empty.py"
    file.write_text("x = 1\n")
    assert read_summary(file) == ""
