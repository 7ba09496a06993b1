"""Texts of users: what no message, JSON text or output can hold, and what reaches the other side."""

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import crazychoir
from crazychoir.bus.codec import decode, encode
from crazychoir.bus.network.public_topics import fields_as_json
from crazychoir.config.digest import compute_digest, compute_key_digests
from crazychoir.config.swarm_config import SwarmConfig, default_swarm
from crazychoir.files.path_texts import as_path, json_bytes, make_readable
from crazychoir.types import Status

UMLAUT = "schön"
OTHER_BYTES = os.fsdecode(b"b\xfcse")  # Latin-1 where names are UTF-8
IN_ASCII = UMLAUT.encode().decode(
    "ascii", "surrogateescape"
)  # a process under LC_ALL=C sees this text
PACKAGE = Path(crazychoir.__file__).parent

any_text = st.text(st.characters(exclude_categories=())) | st.binary().map(
    lambda data: data.decode("utf-8", "surrogateescape")
)


@given(any_text)
@example(OTHER_BYTES)
@example("\ud800")
@example("\udcc3\udcb6\ud800ö")
def test_any_text_is_made_encodable(text):
    plain = make_readable(text)
    assert decode(encode(plain)) == plain
    assert json.loads(json_bytes({text: [text]})) == {plain: [plain]}
    if not any("\ud800" <= character <= "\udfff" for character in text):
        assert plain == text


@given(st.binary())
def test_the_name_of_any_file_travels(data):
    name = data.decode("utf-8", "surrogateescape")
    assert decode(encode([name])) == [make_readable(name)]


def test_a_name_is_the_same_text_in_every_locale():
    assert make_readable(UMLAUT) == make_readable(IN_ASCII) == UMLAUT
    assert make_readable(OTHER_BYTES) == r"b\xfcse"


def test_texts_anywhere_in_a_value_are_made_to_travel():
    status = Status(phase=OTHER_BYTES, note=IN_ASCII)
    value = {OTHER_BYTES: [status, (OTHER_BYTES, 3), np.ones(2)]}
    arrived = decode(encode(value))
    assert (arrived[r"b\xfcse"][0].phase, arrived[r"b\xfcse"][0].note) == (
        r"b\xfcse",
        UMLAUT,
    )
    assert arrived[r"b\xfcse"][1] == [r"b\xfcse", 3]
    assert decode(encode(status)).phase == r"b\xfcse"
    assert msgspec.json.decode(fields_as_json(status))["note"] == UMLAUT


@pytest.mark.parametrize("name", [UMLAUT, OTHER_BYTES, IN_ASCII])
def test_a_swarm_with_such_a_mission_is_read_back_and_has_a_digest(name, tmp_path):
    folder = tmp_path / name
    folder.mkdir()
    (folder / "swarm.toml").write_text(
        'name = "x"\nmission = "own.py"\n[mission_options]\ninstance = "a.json"\n[[drones]]\nid = 0\nhome = [0, 0, 0]\n'
    )
    config = SwarmConfig.load(folder / "swarm.toml")
    assert config.mission == str(folder / "own.py")
    assert SwarmConfig.loads(config.dumps()) == config
    assert len(compute_digest(config)) == 16
    assert compute_key_digests(config)


def test_the_digest_is_the_same_in_every_locale():
    here, there = (
        default_swarm(2).replace(mission=f"/x/{name}.py") for name in (UMLAUT, IN_ASCII)
    )
    assert compute_digest(here) == compute_digest(there)


def test_a_name_in_a_utf8_file_is_found_where_the_locale_lacks_its_letters(tmp_path):
    (tmp_path / UMLAUT).touch()
    program = "from crazychoir.files.path_texts import as_path; print(open(as_path('sch\\xf6n')).read() == '')"
    environment = os.environ | {
        "LC_ALL": "C",
        "PYTHONUTF8": "0",
        "PYTHONCOERCECLOCALE": "0",
    }
    done = subprocess.run(
        [sys.executable, "-c", program],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.stdout, done.stderr) == ("True\n", "")
    assert as_path(UMLAUT) == UMLAUT


# Rules of the source --------------------------------------------------------------------------------------------------


def test_every_text_file_is_read_and_written_with_an_encoding():
    select = ["--isolated", "--preview", "--select", "PLW1514", "--no-cache"]
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "ruff",
            "check",
            *select,
            str(PACKAGE),
            str(PACKAGE.parent / "agents"),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout
    found = [
        f"{path.name}:{node.lineno}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr == "write_text"
        and "encoding" not in [keyword.arg for keyword in node.keywords]
    ]
    assert found == []


def test_the_consoles_are_made_in_one_place_and_print_names_as_they_are():
    from crazychoir.launch.console import ANSWER_CONSOLE, ERROR_CONSOLE

    makes = re.compile(
        r"from rich\.console import [^\n]*\bConsole\b|from_markup|from rich import print"
    )
    sources = {
        path.relative_to(PACKAGE).as_posix(): path.read_text(encoding="utf-8")
        for room in ("cli", "bench", "launch")
        for path in (PACKAGE / room).rglob("*.py")
    }
    assert [name for name, source in sources.items() if makes.search(source)] == [
        "launch/console.py"
    ]
    for console in (ERROR_CONSOLE, ANSWER_CONSOLE):
        assert (
            str(console.render_str("[red]x[/] [/] :smile:")) == "[red]x[/] [/] :smile:"
        )
