"""crazychoir radio ping, through cflib's link, to a Crazyflie of `crazychoir virtual`."""

import json
import signal
import socket
import subprocess
import sys
import threading

import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app

pytestmark = [pytest.mark.system, pytest.mark.real_time]


@pytest.fixture
def port():
    """The port of the first of two virtual drones that share a dongle."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as door:
        door.bind(("127.0.0.1", 0))
        first = door.getsockname()[1]
    words = [
        "virtual",
        "--drones",
        "2",
        "--dongles",
        "0,1",
        "--port",
        str(first),
        "--json",
    ]
    command = [sys.executable, "-m", "crazychoir.cli.main", *words]
    server = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        while "poses at" not in (line := server.stderr.readline()):
            assert line, "the server has ended"
        yield first
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=20)
    finally:
        server.kill()


def test_echoes_take_the_time_of_the_dongle_and_leave_no_thread(port):
    threads = threading.active_count()
    said = CliRunner().invoke(
        app, ["radio", "ping", f"udp://127.0.0.1:{port}", "--count", "50", "--json"]
    )
    (link,) = json.loads(said.stdout)["links"]
    assert (said.exit_code, link["sent"], link["lost"], link["error"]) == (0, 50, 0, "")
    assert 0.002 < link["p50_s"] <= link["p95_s"] <= link["p99_s"] < 0.2, (
        "a dongle of two carries 250 a second"
    )
    assert threading.active_count() == threads
