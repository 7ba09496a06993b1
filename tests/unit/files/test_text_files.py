"""Text files of a user: byte-order marks, ends of lines, and encodings, for every reader that takes such a file."""

import codecs
import json
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from crazychoir.config.editing import write_keys
from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.errors import ConfigError, InstanceError
from crazychoir.files.text_files import decode_text, read_text
from crazychoir.mocap.recording import RECORDING_COLUMNS, read_recording
from crazychoir.planning.drawing.svg import read_svg
from crazychoir.planning.number_table import read_table
from crazychoir.radio.protocol.addresses import find_dongle_uris
from crazychoir.radio.protocol.addresses import read_swarm_text as read_addresses
from crazychoir.routing.instance.instance import Instance

MARK = codecs.BOM_UTF8
LI_LIM = Path(__file__).parents[2] / "data" / "li_lim_small.txt"
INSTANCE = {
    "home": [[0, 0]],
    "pickup": [[1, 0]],
    "delivery": [[2, 0]],
    "load": [1],
    "capacity": [1],
    "name": "höhe",
}
SWARM = 'name = "lab"\nseed = 3 # größer\n\n[[drones]]\nid = 0\nhome = [0, 0, 0]\nuri = "radio://0/80/2M/E7E7E7E701"\n'
FILES = {
    "instance.json": (
        json.dumps(INSTANCE, indent=1, ensure_ascii=False),
        lambda p: Instance.load(p).tasks.to_json(),
    ),
    "li_lim.txt": (LI_LIM.read_text(), lambda p: Instance.load(p).to_json()),
    "swarm.toml": (SWARM, lambda p: SwarmConfig.load(p).dumps()),
    "swarm.json": (
        SwarmConfig.loads(SWARM).dumps(),
        lambda p: SwarmConfig.load(p).dumps(),
    ),
    "radio.toml": (
        SWARM,
        lambda p: find_dongle_uris(read_addresses(p).removeprefix("\ufeff"), "swarm"),
    ),
    "poses.csv": (
        f"{','.join(RECORDING_COLUMNS)}\n0.0,cf1,0,0,1,0,0,0,1\n",
        lambda p: [f.time for f in read_recording(p)],
    ),
    "table.csv": ("t,x\n0,1\n1,2\n", lambda p: read_table(p, ("t", "x"))["x"].tolist()),
    "drawing.svg": (
        '<svg>\n<path d="M0 0 L10 0"/>\n</svg>\n',
        lambda p: [s.tolist() for s in read_svg(p)],
    ),
}
"""By name: a text, and what a reader makes of it."""
UTF_8_ALONE = tuple(name for name in FILES if name not in ("table.csv", "drawing.svg"))
"""Tables of spreadsheets and drawings are read in other encodings too, as their programs write them."""


@pytest.mark.parametrize("name", FILES)
@settings(
    max_examples=15,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    mark=st.booleans(),
    ending=st.sampled_from(["\n", "\r\n"]),
    blank=st.integers(0, 3),
    data=st.data(),
)
def test_marks_ends_of_lines_and_blank_lines_change_nothing(
    name, mark, ending, blank, data, tmp_path
):
    text, read = FILES[name]
    plain = tmp_path / name
    plain.write_text(text, encoding="utf-8")
    expected = read(plain)
    lines = text.rstrip("\n").split("\n")
    first = 0 if name.endswith(("json", "toml", "txt")) else 1
    for _ in range(blank):
        lines.insert(data.draw(st.integers(first, len(lines))), "")
    changed = ending.join([*lines, ""]).encode()
    (tmp_path / "changed").mkdir(exist_ok=True)
    other = tmp_path / "changed" / name
    other.write_bytes(MARK + changed if mark else changed)
    assert read(other) == expected


@pytest.mark.parametrize("name", UTF_8_ALONE)
@pytest.mark.parametrize(
    ("encoding", "said"),
    [
        ("utf-16", "a text in UTF-16"),
        ("utf-16-be", "a zero byte at line 1, column"),
        ("utf-16-le", "a zero byte at line 1, column"),
        ("utf-32", "a text in UTF-32"),
    ],
)
def test_another_encoding_is_named_with_the_file_and_what_to_do(
    name, encoding, said, tmp_path
):
    text, read = FILES[name]
    path = tmp_path / name
    path.write_bytes(text.encode(encoding))
    with pytest.raises(ConfigError, match=said) as refusal:
        read(path)
    assert str(path) in str(refusal.value)
    assert "UTF-8" in str(refusal.value)


@pytest.mark.parametrize("name", UTF_8_ALONE)
def test_a_byte_that_is_not_utf_8_is_named_by_line_and_column(name, tmp_path):
    text, read = FILES[name]
    path = tmp_path / name
    path.write_bytes(
        MARK
        + "größe\r\n".encode()
        + "grö".encode()
        + "ß".encode("latin-1")
        + text.encode()
    )
    with pytest.raises(
        ConfigError, match=r"bytes that are not UTF-8: 0xdf at line 2, column 4 \(byte "
    ):
        read(path)


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_cannot_be_read_is_named(name, tmp_path):
    for path in (tmp_path / name, tmp_path):
        with pytest.raises(ConfigError) as refusal:
            FILES[name][1](path)
        assert str(path) in str(refusal.value)


@pytest.mark.parametrize("content", [b"", MARK, b"\n\n", MARK + b"\r\n"])
def test_an_empty_instance_is_said_to_be_empty(content, tmp_path):
    path = tmp_path / "empty.json"
    path.write_bytes(content)
    with pytest.raises(InstanceError, match=r"empty\.json: found an empty file"):
        Instance.load(path)


@given(
    st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0\r\ufeff")),
    st.booleans(),
)
def test_every_text_comes_back(text, mark):
    data = text.encode()
    assert decode_text(MARK + data if mark else data, "here", "a text") == text
    assert decode_text(data.replace(b"\n", b"\r\n"), "here", "a text") == text
    assert decode_text(MARK + data, "here", "a text", exact=True) == "\ufeff" + text


@given(st.binary())
def test_any_bytes_are_a_text_or_an_error_that_names_the_place(data):
    try:
        said = decode_text(data, "here", "a text")
    except ConfigError as error:
        said = error
    assert isinstance(said, str) or str(said).startswith("here: found ")


def test_a_key_is_written_into_a_file_with_a_mark_which_stays(tmp_path):
    path = tmp_path / "swarm.toml"
    path.write_bytes(MARK + SWARM.replace("\n", "\r\n").encode())
    write_keys(path, {0: {"body": "cf1"}})
    assert path.read_bytes().startswith(MARK + b'name = "lab"\r\n')
    assert SwarmConfig.load(path).drones[0].body == "cf1"


def test_a_name_with_a_zero_byte_is_an_error_of_the_project():
    with pytest.raises(ConfigError, match="null byte"):
        read_text("a\0b", "a text")
