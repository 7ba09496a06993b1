import sys

import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.cli.operate.dashboard import PASSWORD_VARIABLE


def said(*words):
    done = CliRunner().invoke(app, ["dashboard", *map(str, words)])
    return done.exit_code, " ".join(done.stderr.split())


def test_without_its_packages_it_says_what_to_install(monkeypatch):
    for name in [
        name
        for name in sys.modules
        if name.startswith(("nicegui", "crazychoir.dashboard"))
    ]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "fastapi", None)
    monkeypatch.setitem(sys.modules, "nicegui", None)
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    code, text = said()
    assert code == 2
    assert "pip install 'crazychoir[dashboard]'" in text


@pytest.fixture
def installed(monkeypatch):
    pytest.importorskip(
        "nicegui", reason="the page needs: pip install 'crazychoir[dashboard]'"
    )
    monkeypatch.delenv(PASSWORD_VARIABLE, raising=False)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.4", "::", "lab"])  # noqa: S104
def test_others_than_this_machine_need_a_password(installed, monkeypatch, host):
    code, text = said("--host", host)
    assert code == 2
    assert (
        "a password or an authority, where others than this machine can come in" in text
    )
    monkeypatch.setenv(PASSWORD_VARIABLE, "short")
    code, text = said("--host", host)
    assert "8 or more" in text


def test_files_that_are_not_there_are_named(installed, tmp_path):
    assert "no.txt" in said("--password-file", tmp_path / "no.txt")[1]
    assert (
        "no.pem"
        in said("--certificate", tmp_path / "no.pem", "--key", tmp_path / "no.pem")[1]
    )
    (tmp_path / "a.pem").write_text("")
    assert "without --key" in said("--certificate", tmp_path / "a.pem")[1]
