import pytest

from crazychoir.config.editing import lines_of, with_keys, write_keys
from crazychoir.errors import ConfigError

FILE = """# our lab
name = "lab"   # a name
[[drones]]
id = 0
  body = "old"   # tape on it
home = [0.0,0.0,0.0]

# the second
[[drones]]
home = [1.0, 0.0, 0.0]
id = 1
[drones.options]
fast = true
[mocap]
body = 3
"""


def test_keys_are_replaced_and_added_and_all_else_stays_to_the_byte():
    text = with_keys(
        FILE,
        {0: {"body": "new one"}, 1: {"body": "b", "body_offset": [0.0, -0.01, 0.02]}},
    )
    assert text == FILE.replace('body = "old"', 'body = "new one"').replace(
        "id = 1\n", 'id = 1\nbody = "b"\nbody_offset = [0.0, -0.01, 0.02]\n'
    )


def test_what_was_written_is_replaced_when_it_is_written_again():
    once = with_keys(FILE, {1: {"body_offset": [0.0, 0.0, 0.1]}})
    twice = with_keys(once, {1: {"body_offset": [0.5, 0.0, 0.0]}})
    assert twice == once.replace("[0.0, 0.0, 0.1]", "[0.5, 0.0, 0.0]")
    assert with_keys(twice, {}) == twice


def test_a_table_of_many_keys_is_written_whole_and_replaced():
    many = {f"key_{n}": [1.0, 2.0, 3.0] for n in range(9)}
    once = with_keys(FILE, {1: {"calibration": many}})
    assert "key_8 = [1.0, 2.0, 3.0] }" in once
    twice = with_keys(once, {1: {"calibration": {"thrust_factor": 0.9}}})
    assert "calibration = { thrust_factor = 0.9 }\n" in twice
    assert "key_8" not in twice


def test_line_ends_of_other_systems_and_a_missing_last_one():
    text = 'name = "lab"\r\n[[drones]]\r\nid = 0\r\nhome = [0, 0, 0]'
    assert with_keys(text, {0: {"body": "b"}}) == f'{text}\r\nbody = "b"\r\n'


@pytest.mark.parametrize(
    "text",
    [
        'name = "lab"\ndrones = [{ id = 0, home = [0, 0, 0] }]\n',
        '{"name": "lab", "drones": [{"id": 0, "home": [0, 0, 0]}]}',
        "[[drones]]\nid = 1\nhome = [0, 0, 0]\n",
        "[[drones]]\nid = 0\nbody = '''\nx'''\n",
    ],
)
def test_a_file_of_another_layout_is_not_touched_and_the_lines_are_told(text, tmp_path):
    path = tmp_path / "swarm.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as refused:
        write_keys(path, {0: {"body": "b"}})
    assert path.read_text() == text
    assert lines_of(0, {"body": "b"}) in str(refused.value)


def test_a_file_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="No such file"):
        write_keys(tmp_path / "none.toml", {0: {"body": "b"}})
