"""A process ends with its exit code, whatever hangs in a thread."""

import subprocess
import sys
import time

import pytest

HANGS = """
import atexit, threading, time
import typer
from crazychoir.launch.process import ending

atexit.register(print, "taken down")
app = typer.Typer()


@app.command()
def command(code: int, session: bool):
    if session:
        from crazychoir.bus.network import zenoh_link as zenoh

        threading.Thread(target=time.sleep, args=(60.0,)).start()
    print("the result")
    raise typer.Exit(code)


ending.run_to_exit(app)
"""


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
