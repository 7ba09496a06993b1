"""The progress of a sweep, on a terminal, in a notebook and in a file."""

import sys
from io import StringIO
from types import SimpleNamespace

from rich.console import Console

from crazychoir.api import sweep_progress


def shown(monkeypatch, terminal):
    out = StringIO()
    console = Console(file=out, force_terminal=terminal, width=100)
    monkeypatch.setattr(sweep_progress, "ERROR_CONSOLE", console)
    with sweep_progress.open_progress() as step:
        for ended in (1, 2):
            step(ended, 2, {"success": ended == 1})
    return out.getvalue()


def test_a_terminal_shows_a_bar_and_the_failures(monkeypatch):
    text = shown(monkeypatch, terminal=True)
    assert "2/2" in text
    assert "failed: 1" in text


def test_a_file_gets_nothing(monkeypatch):
    assert shown(monkeypatch, terminal=False) == ""


def test_a_notebook_gets_one_line_that_changes(monkeypatch):
    said = []

    def display(line, raw, display_id):
        said.append(line["text/plain"])
        return SimpleNamespace(update=lambda line, raw: said.append(line["text/plain"]))

    kernel = SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=1))
    monkeypatch.setitem(sys.modules, "IPython", kernel)
    monkeypatch.setitem(
        sys.modules, "IPython.display", SimpleNamespace(display=display)
    )
    assert shown(monkeypatch, terminal=True) == ""
    assert said == ["1 of 2 runs", "2 of 2 runs"]
