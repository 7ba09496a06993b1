"""A key in the wrong table: the error names the table that it belongs to."""

import msgspec
import pytest

from crazychoir.config.misplaced_keys import table_label
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.config.tables import Swarm
from crazychoir.errors import ConfigError
from crazychoir.guidance.mission_options import NoOptions, given

NAME = 'name = "x"\n'
DRONES = "[[drones]]\nid = 0\nhome = [0.0, 0.0, 0.0]\n"
ABOVE = "write it above the first table"
TABLES = [
    "network",
    "flight",
    "fence",
    "mocap",
    "radio",
    "plant",
    "motors",
    "collision",
    "control",
    "security",
]
PLAIN = {
    "mission": '"figure"',
    "seed": "3",
    "graph": '"ring"',
    "base_port": "7500",
    "start": '"all"',
    "lost_after": "5.0",
}


def refusal(text):
    with pytest.raises(ConfigError) as error:
        SwarmConfig.loads(text, "s.toml")
    return str(error.value)


@pytest.mark.parametrize("table", [*TABLES, "drones"])
@pytest.mark.parametrize("key", PLAIN)
def test_a_key_of_the_file_below_a_table_is_to_be_written_above_the_first(key, table):
    head = "" if table == "drones" else f"[{table}]\n"
    said = refusal(f"{NAME}{DRONES}{head}{key} = {PLAIN[key]}\n")
    assert ABOVE in said
    assert (
        f"Every line below {table_label('drones[0]' if table == 'drones' else table)} is a key of that table"
        in said
    )
    assert "Remove it" not in said


def every_key_of_a_table():
    for entry in msgspec.structs.fields(Swarm):
        if isinstance(entry.type, type) and issubclass(entry.type, msgspec.Struct):
            yield from (
                (entry.encode_name, inner.encode_name)
                for inner in msgspec.structs.fields(entry.type)
            )


@pytest.mark.parametrize(("table", "key"), list(every_key_of_a_table()))
def test_a_key_of_a_table_that_stands_in_the_file_or_in_another_table_names_its_own(
    table, key
):
    top = {entry.encode_name for entry in msgspec.structs.fields(Swarm)}
    if key not in top:
        assert f"[{table}]" in refusal(f"{key} = 1\n{NAME}{DRONES}")
    fence = refusal(f"{NAME}{DRONES}[fence]\n{key} = 1\n")
    if key not in ("min", "max"):
        assert f"[{table}]" in fence
        assert "Remove it" not in fence


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            f"{DRONES}name = 'x'\n",
            r"name: found nothing.* It stands in \[\[drones\]\].* above the first table",
        ),
        (f"[network]\nloss = 0.1\nname = 'x'\n{DRONES}", r"It stands in \[network\]"),
        (f"[hosts]\nname = 'x'\n{DRONES}", r"It stands in \[hosts\]"),
        (
            f"{NAME}{DRONES}[flight]\nbase_prt = 7000\n",
            "Did you mean base_port\\? .* above the first table",
        ),
        (
            f"{NAME}uri = 'sim://'\n{DRONES}",
            r"It is a key of \[\[drones\]\], \[defaults\]: write it in the table",
        ),
        (
            f"{NAME}{DRONES}[flight.fence]\nmin = [-1, -1, 0]\n",
            r"write \[fence\], not \[flight.fence\]",
        ),
        (
            f"{NAME}[mission_options]\na = 1\n[[mission_options.drones]]\nid = 0\n",
            r"write \[\[drones\]\], not \[\[mis",
        ),
        (
            f"{NAME}{DRONES}[[flight]]\nspeed_limit = 1.0\n",
            r"Write it once, as \[flight\]",
        ),
        (
            f"{NAME}{DRONES}[control]\nname = 'x'\n",
            r"\[\[roles\]\] has a key of this name, too",
        ),
        (
            f"{NAME}[hosts]\na = '127.0.0.1'\nseed = 3\n{DRONES}",
            "seed: It is a key of the file itself",
        ),
        (
            '{"name": "x", "drones": [{"id": 0, "home": [0, 0, 0], "mission": "figure"}]}',
            "in JSON beside name",
        ),
    ],
)
def test_each_way_to_miss_the_table_is_told(text, told):
    with pytest.raises(ConfigError, match=told):
        SwarmConfig.loads(text, "s.toml")


def test_a_key_that_no_table_has_is_removed_and_a_misspelt_one_is_mended():
    assert "Remove it; write your own keys into [mission_options]." in refusal(
        f"{NAME}{DRONES}[flight]\nbanana = 1\n"
    )
    assert refusal(f"{NAME}{DRONES}[flight]\nspeed_limt = 1.0\n").endswith(
        "Did you mean speed_limit?"
    )


def test_a_key_of_the_file_among_the_options_of_a_mission_is_told_too():
    config = SwarmConfig.loads(f"{NAME}[mission_options]\nseed = 3\n{DRONES}")
    with pytest.raises(
        ConfigError, match=r"mission_options.seed = 3: .* above the first table"
    ):
        given(config, NoOptions)
    other = SwarmConfig.loads(f"{NAME}[mission_options]\nbanana = 3\n{DRONES}")
    with pytest.raises(ConfigError, match=r"Remove it\.$"):
        given(other, NoOptions)
