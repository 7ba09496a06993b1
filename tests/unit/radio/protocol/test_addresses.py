"""Channels in a swarm file: its other bytes stay."""

import os

import pytest

from crazychoir.errors import ConfigError
from crazychoir.radio.protocol.addresses import (
    find_dongle_uris,
    replace_channels,
    require_writable,
    write_channels,
)

TOML = """\
# radio://0/80/2M: not this one, nor uri = "radio://0/80/2M/E7E7E7E701"
name = "lab"   # 'quoted # ' in a comment
note = "radio://0/80 is what uri = \\"radio://0/80/2M\\" says"
note2 = "radio://0/80/2M/E7E7E7E701"
path = 'C:\\radio://0/80/'
long = \"\"\"
uri = "radio://0/80/2M"
\"\"\"

[[drones]]
id = 0
uri = "radio://0/80/2M/E7E7E7E701"  # uri = "radio://0/80/2M"
[[drones]]
id = 1
"uri"   =   'radio://0/90/2M/E7E7E7E702?rate_limit=100'
[[drones]]
id = 2
uri = "radio://ABCDEF0123/7"
[[drones]]
uri="udp://127.0.0.1:19850"
[[drones]]
id = 4
"""
CHANGED = {
    '"radio://0/80/2M/E7E7E7E701"  #': '"radio://0/6/2M/E7E7E7E701"  #',
    "'radio://0/90/2M/E7E7E7E702?": "'radio://0/6/2M/E7E7E7E702?",
    '"radio://ABCDEF0123/7"': '"radio://ABCDEF0123/104"',
}
JSON = '{"name": "lab # x", "drones" : [{"id":0,"uri" :\n "radio://1/80/2M/E7E7E7E701"}, {"uri": "radio://0/2"}]}'


def test_the_dongles_are_those_of_the_file_in_its_order():
    assert list(find_dongle_uris(TOML, "lab.toml")) == ["0", "ABCDEF0123"]
    assert find_dongle_uris(JSON, "lab.json") == {
        "1": ["radio://1/80/2M/E7E7E7E701"],
        "0": ["radio://0/2"],
    }


def test_each_uri_gets_the_channel_of_its_dongle_and_all_else_stays():
    expected = TOML
    for old, new in CHANGED.items():
        assert expected.count(old) == 1
        expected = expected.replace(old, new)
    assert replace_channels(TOML, {"0": 6, "ABCDEF0123": 104}, "lab.toml") == expected


def test_json_is_changed_as_well():
    expected = JSON.replace("/1/80/", "/1/12/").replace("/0/2", "/0/34")
    assert replace_channels(JSON, {"1": 12, "0": 34}, "lab.json") == expected


def test_bytes_that_are_no_text_of_ours_stay(tmp_path):
    file = tmp_path / "lab.toml"
    before = (
        ("\ufeff" + TOML.replace("lab", "Labor für Flüge"))
        .replace("\n", "\r\n")
        .encode()
    )
    file.write_bytes(before)
    os.chmod(file, 0o640)
    write_channels(file, {"0": 81, "ABCDEF0123": 8})
    after = file.read_bytes()
    assert (
        after.replace(b"//0/81/", b"//0/80/", 1)
        .replace(b"//0/81/", b"//0/90/")
        .replace(b"23/8", b"23/7")
        == before
    )
    assert after != before
    assert file.stat().st_mode & 0o777 == 0o640
    assert [path.name for path in tmp_path.iterdir()] == ["lab.toml"]


def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "real.toml").write_text(TOML)
    (tmp_path / "lab.toml").symlink_to("real.toml")
    write_channels(tmp_path / "lab.toml", {"0": 81})
    assert (tmp_path / "lab.toml").is_symlink()
    assert "radio://0/81/2M" in (tmp_path / "real.toml").read_text()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ('name = "lab"\n[[drones]]\nid = 0\nuri = "sim://"', "no uri with radio://"),
        ('name = "lab"', "no uri with radio://"),
        ('[[drones]]\nuri = "radio://0"', "radio://DONGLE/CHANNEL"),
        ('[[drones]]\nuri = "radio://0/eighty"', "radio://DONGLE/CHANNEL"),
        ("[[drones]", "TOML"),
    ],
)
def test_a_file_without_channels_to_change_is_refused(text, says):
    with pytest.raises(ConfigError, match=says):
        find_dongle_uris(text, "lab.toml")


@pytest.mark.parametrize(
    "text",
    [
        '{"drones": [{"uri": "radio:\\/\\/0\\/80"}]}',
        '[[drones]]\nuri = """radio://0/80"""',
        '[[drones]]\nuri = "radio://0/80"\n[mission_options]\nuri = "radio://0/80"',
    ],
)
def test_what_cannot_be_changed_alone_is_not_changed(text):
    with pytest.raises(
        ConfigError, match="Write the channels yourself: 6 for dongle 0"
    ):
        replace_channels(text, {"0": 6}, "lab.toml")


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="No such file"):
        write_channels(tmp_path / "absent.toml", {"0": 6})


def test_a_file_that_cannot_be_written_stays(tmp_path, monkeypatch):
    file = tmp_path / "lab.toml"
    file.write_text(TOML)
    require_writable(file)
    monkeypatch.setattr(
        "os.access", lambda path, mode: path != tmp_path
    )  # root may all
    with pytest.raises(ConfigError, match="Permission denied"):
        require_writable(file)

    def full(path, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(ConfigError, match="No space left"):
        write_channels(file, {"0": 6})
    assert file.read_text() == TOML
    assert [path.name for path in tmp_path.iterdir()] == ["lab.toml"]
