"""A process ends with its exit code, whatever hangs in a thread."""

import subprocess
import sys
import time

import pytest

HANGS = '''
import atexit, threading, time
import typer
from crazychoir.bus import zenoh
from crazychoir.cli import ending

atexit.register(print, "taken down")
app = typer.Typer()


@app.command()
def command(code: int, left: bool):
    if left:
        threading.Thread(target=time.sleep, args=(60.0,), name=zenoh.CLOSING, daemon=True).start()
    print("the result")
    raise typer.Exit(code)


ending.run(app)
'''


@pytest.mark.parametrize("code", [0, 1])
@pytest.mark.parametrize("left", [False, True])
def test_a_session_that_does_not_close_changes_no_exit_code(code, left):
    began = time.monotonic()
    words = [sys.executable, "-c", HANGS, str(code), str(left)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=50)
    assert done.returncode == code, done.stderr
    assert done.stdout.splitlines() == (["the result"] if left else ["the result", "taken down"])
    assert time.monotonic() - began < 40.0
