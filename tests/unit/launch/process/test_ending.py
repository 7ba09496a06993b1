"""A process prints any text, and ends with its exit code, whatever hangs in a thread."""

import io
import os
import subprocess
import sys
import time

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from crazychoir.launch.process.ending import OUTPUT_ERRORS, let_outputs_take_any_text

HANGS = """
import atexit, threading, time
import typer
from crazychoir.launch.process import ending

atexit.register(print, "taken down")
app = typer.Typer()


@app.command()
def command(code: int, session: bool):
    if session:
        import crazychoir.bus.network.zenoh_session

        threading.Thread(target=time.sleep, args=(60.0,)).start()
    print("the result")
    raise typer.Exit(code)


ending.run_to_exit(app)
"""
UMLAUT = "schön"
OTHER_BYTES = os.fsdecode(b"b\xfcse")
IN_ASCII = UMLAUT.encode().decode("ascii", "surrogateescape")

any_text = st.text(st.characters(exclude_categories=())) | st.binary().map(
    lambda data: data.decode("utf-8", "surrogateescape")
)


@pytest.mark.parametrize("code", [0, 1])
@pytest.mark.parametrize("session", [False, True])
def test_a_process_that_has_had_a_session_ends_at_once_with_its_exit_code(
    code, session
):
    began = time.monotonic()
    words = [sys.executable, "-c", HANGS, str(code), str(session)]
    done = subprocess.run(
        words, capture_output=True, text=True, check=False, timeout=50
    )
    assert done.returncode == code, done.stderr
    assert done.stdout.splitlines() == (
        ["the result"] if session else ["the result", "taken down"]
    )
    assert time.monotonic() - began < 40.0


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8", "cp1252"])
@given(text=any_text)
@example(text=f"┏━ {UMLAUT} {OTHER_BYTES} {IN_ASCII} → \ud800")
def test_an_output_of_any_encoding_takes_any_text(encoding, text):
    written = io.BytesIO()
    stream = io.TextIOWrapper(written, encoding, errors=OUTPUT_ERRORS, newline="")
    stream.write(text)
    stream.flush()
    if encoding == "utf-8" and not any(
        "\ud800" <= c <= "\udc7f" or "\udd00" <= c <= "\udfff" for c in text
    ):
        assert written.getvalue() == text.encode("utf-8", "surrogateescape")


def test_the_outputs_of_this_process_are_made_to_take_any_text(monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), "ascii", errors="strict")
    monkeypatch.setattr(sys, "stdout", stream)
    monkeypatch.setattr(
        sys, "stderr", io.StringIO()
    )  # no stream of bytes: it takes any text as it is
    let_outputs_take_any_text()
    stream.write(f"{UMLAUT} {OTHER_BYTES}")
    stream.flush()
    assert stream.buffer.getvalue() == b"sch\\xf6n b\xfcse"
