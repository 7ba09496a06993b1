import json
import sys

import pytest
from typer.testing import CliRunner

from crazychoir.bridges.foxglove_layout import LAYOUT_FILE
from crazychoir.cli.main import app
from crazychoir.cli.operate.foxglove import LAYOUT_MODE, write_layout
from crazychoir.errors import ConfigError


def said(*words):
    done = CliRunner().invoke(app, ["foxglove", *map(str, words)])
    return done.exit_code, " ".join(done.stderr.split())


def test_without_its_package_it_says_what_to_install(monkeypatch):
    for name in [name for name in sys.modules if name.startswith("crazychoir.bridges")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "foxglove", None)
    code, text = said()
    assert code == 2
    assert "pip install 'crazychoir[foxglove]'" in text


def test_a_layout_needs_a_name_that_foxglove_imports(tmp_path):
    pytest.importorskip("foxglove", reason="needs the extra `foxglove`")
    code, text = said("--layout", tmp_path / "layout.txt")
    assert (code, ".json" in text) == (2, True)


def test_a_layout_with_the_key_is_for_its_owner_alone(tmp_path):
    path = tmp_path / "six.json"
    write_layout(path, (0, 4), "secret")
    assert path.stat().st_mode & 0o777 == LAYOUT_MODE
    text = path.read_text()
    assert "secret" in text
    paths = json.loads(text)["configById"]["Plot!height"]["paths"]
    assert [one["label"] for one in paths] == ["drone 0", "drone 4"]
    with pytest.raises(ConfigError, match="layout"):
        write_layout(tmp_path, (0,), "")


def test_the_shipped_layout_has_no_key_and_shows_drone_0():
    panels = json.loads(LAYOUT_FILE.read_text())["configById"]
    requests = [
        json.loads(panel["requestPayload"])
        for panel in panels.values()
        if "requestPayload" in panel
    ]
    assert {request["key"] for request in requests} == {""}
    paths = [
        path["value"] for panel in panels.values() for path in panel.get("paths", [])
    ]
    assert all(path.startswith("/drone0/") for path in paths)
