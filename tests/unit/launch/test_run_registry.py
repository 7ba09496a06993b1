"""A run is found while it flies, by its file or alone; two never stand for one another."""

import contextlib
import fcntl
import json
import os
import shutil
import socket
import subprocess
import sys
from dataclasses import asdict, replace

import pytest
from other_user import as_user, require

from crazychoir.api.flight_request import FlightRequest
from crazychoir.config.addresses import Addresses
from crazychoir.config.swarm_config import SwarmConfig, default_swarm, demo_swarm
from crazychoir.errors import Refused
from crazychoir.files.user_folders import private_folder_of
from crazychoir.launch import run_registry as running
from crazychoir.launch import running_swarm as meant
from crazychoir.launch.run_registry import (
    RunRecord,
    list_own_runs,
    list_runs_of_file,
    record_run,
)
from crazychoir.launch.running_swarm import (
    NEXT_PROCESS_TIMEOUT,
    SWARM_SEARCH,
    first_process_timeout,
    no_agent_error,
    running_swarm,
)

LAB = default_swarm(2).replace(name="lab")


@pytest.fixture(autouse=True)
def own_place(tmp_path, monkeypatch):
    """Records of these tests alone, and a working folder with a swarm file lab.toml."""
    monkeypatch.setenv("CRAZYCHOIR_RUNTIME_DIR", str(tmp_path / "crazychoir"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lab.toml").write_text(LAB.dumps())
    return tmp_path


def run_of(folder, name, source=None):
    """A run as `crazychoir run` leaves it: under a name of its own, by a file of its own."""
    file = folder / f"{name}.json"
    file.write_text(default_swarm(2).replace(name=name).dumps())
    return RunRecord(
        name,
        source or "pickup_delivery",
        source and FlightRequest(source).swarm_file,
        str(file),
    )


def test_my_file_finds_the_swarm_that_was_started_by_it(own_place):
    run = run_of(own_place, "lab-1", "lab.toml")
    assert running_swarm("lab.toml") == LAB, (
        "nothing runs: its agents may have been started one by one"
    )
    with record_run(run):
        assert running_swarm("lab.toml").name == "lab-1"
        assert running_swarm(str(own_place / "lab.toml")).name == "lab-1"
        assert running_swarm(run.file).name == "lab-1"
    assert running_swarm("lab.toml") == LAB


def test_without_a_file_the_only_run_is_meant(own_place, monkeypatch):
    with pytest.raises(Refused, match="no swarm of yours runs here"):
        running_swarm(None)
    monkeypatch.setattr(meant, "_listens", lambda port: port == demo_swarm().base_port)
    found = running_swarm(None)
    assert found.name == "pickup", (
        "the swarm of the demo's mission, if a process listens"
    )
    assert Addresses(found).endpoints() == Addresses(demo_swarm()).endpoints(), (
        "at the endpoints of the demo"
    )
    with record_run(run_of(own_place, "demo-1")):
        assert running_swarm(None).name == "demo-1"
        (own_place / "swarm.toml").write_text(LAB.dumps())
        assert running_swarm(None) == LAB, "./swarm.toml goes first"


def test_none_of_several_runs_is_guessed(own_place):
    one, other = (
        run_of(own_place, "lab-1", "lab.toml"),
        run_of(own_place, "lab-2", "lab.toml"),
    )
    with record_run(one):
        with record_run(other), record_run(run_of(own_place, "demo-1")):
            assert [run.swarm for run in list_own_runs()] == [
                "demo-1",
                "lab-1",
                "lab-2",
            ]
            for option in ("lab.toml", None):
                with pytest.raises(Refused, match="several") as refused:
                    running_swarm(option)
                assert one.file in refused.value.reason
                assert other.file in refused.value.reason
            assert "demo-1" in refused.value.reason, "it could be meant too"
        assert running_swarm("lab.toml").name == "lab-1", (
            "the end of one leaves the other alone"
        )


def test_only_a_listening_or_starting_swarm_is_waited_for(own_place):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        here = default_swarm(2).replace(name="lab-1", base_port=port - 1)
        assert first_process_timeout(here) == 0.0, "no process listens yet"
        taken.listen()
        assert first_process_timeout(here) == NEXT_PROCESS_TIMEOUT, "drone 1 does"
    drones = [{"id": i, "home": [i, 0, 0], "host": "far"} for i in range(2)]
    raw = {
        "name": "lab",
        "drones": drones,
        "hosts": {"far": "10.9.9.9"},
        "security": {"insecure": True},
    }
    far = SwarmConfig.of(raw)
    assert first_process_timeout(far) == NEXT_PROCESS_TIMEOUT, (
        "on another host, that is not asked"
    )
    with record_run(run_of(own_place, "lab-1")):
        assert first_process_timeout(here) == SWARM_SEARCH.start_timeout
        assert "Name one: --swarm" in no_agent_error(LAB, "lab.toml").reason


def test_a_run_that_is_starting_is_not_absent_and_names_no_other(own_place):
    with (
        record_run(run_of(own_place, "lab-1", "lab.toml")),
        record_run(run_of(own_place, "demo-1")),
    ):
        said = no_agent_error(running_swarm("lab.toml"), "lab.toml").reason
        assert "has not started them yet (a first run compiles its laws" in said
        assert said.endswith("try again.")
        assert "--swarm" not in said
        assert "is it running" not in said


def test_two_processes_of_one_swarm_are_one(own_place):
    run = run_of(own_place, "lab", "lab.toml")
    with (
        record_run(run),
        record_run(RunRecord("lab", "lab.toml", run.source, run.file)),
    ):
        assert list_runs_of_file("lab.toml") == [run]


def test_a_killed_run_leaves_no_record(own_place):
    run = run_of(own_place, "lab-1", "lab.toml")
    program = f"""if True:
        import os, signal
        from crazychoir.launch.run_registry import RunRecord, record_run, list_own_runs
        with record_run(RunRecord(**{asdict(run)!r})):
            assert list_own_runs()
            os.kill(os.getpid(), signal.SIGKILL)"""
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == -9
    left = list((own_place / "crazychoir").iterdir())
    assert json.loads(left[0].read_text()) == asdict(run), "its record is there"
    assert list_own_runs() == []
    assert not left[0].exists(), "and goes"


def test_a_run_flies_though_no_record_can_be_left(own_place, monkeypatch):
    monkeypatch.setenv(
        "CRAZYCHOIR_RUNTIME_DIR", str(own_place / "missing" / "crazychoir")
    )
    with record_run(run_of(own_place, "lab-1")):
        assert list_own_runs() == []


def test_records_are_private(own_place):
    with record_run(run_of(own_place, "lab-1")):
        assert os.stat(own_place / "crazychoir").st_mode & 0o777 == 0o700


# From other shells ----------------------------------------------------------------------------------------------------

UID = 200_000 + os.getpid() % 50_000
"""A user of this test alone."""
SHELLS = {
    "login shell": {
        "HOME": "/home/anna",
        "USER": "anna",
        "XDG_RUNTIME_DIR": "{folder}",
    },
    "cron": {"HOME": "/home/anna", "PATH": "/usr/bin:/bin", "SHELL": "/bin/sh"},
    "service": {"INVOCATION_ID": "0", "TMPDIR": "{folder}"},
    "nothing": {},
}
RECORDS = """if True:
    import sys, time
    from crazychoir.launch.run_registry import RunRecord, record_run
    with record_run(RunRecord(*sys.argv[1:5])):
        print("flies", flush=True)
        sys.stdin.read()
"""
FINDS = """if True:
    import sys
    from crazychoir.launch.run_registry import list_every_run, list_runs_of_file, list_own_runs
    found = [list_own_runs(), list_runs_of_file(sys.argv[1]), list_every_run()]
    print(*([run.swarm for run in group if run.swarm == sys.argv[2]] for group in found))
"""


def shell(folder, name):
    """The environment of a shell, with what Python needs."""
    needed = {"PYTHONPATH": os.pathsep.join(sys.path)}
    return {
        key: value.format(folder=folder) for key, value in SHELLS[name].items()
    } | needed


@contextlib.contextmanager
def flying(folder, name, uid, swarm):
    """A run of a user, started in that shell."""
    source = str(folder / "lab.toml")
    command = [
        *as_user(uid),
        sys.executable,
        "-c",
        RECORDS,
        swarm,
        "lab.toml",
        source,
        "/nowhere/swarm.json",
    ]
    pipe = subprocess.PIPE
    with subprocess.Popen(
        command,
        env=shell(folder, name),
        stdin=pipe,
        stdout=pipe,
        stderr=pipe,
        text=True,
    ) as process:
        said = process.stdout.readline()
        try:
            assert said == "flies\n", process.stderr.read() if said == "" else said
            yield
        finally:
            process.stdin.close()


def found(folder, name, uid, swarm, **environment):
    """Whether that shell of that user finds it: by itself, by its file, and at all."""
    command = [
        *(as_user(uid) if uid else ()),
        sys.executable,
        "-c",
        FINDS,
        str(folder / "lab.toml"),
        swarm,
    ]
    answer = subprocess.run(
        command,
        env=shell(folder, name) | environment,
        capture_output=True,
        text=True,
        check=True,
        cwd="/",
    )
    return answer.stdout.strip(), answer.stderr


@pytest.fixture
def of_a_user():
    """Its private folder goes at the end."""
    require("true")
    yield f"lab-{UID}"
    for uid in (UID, UID + 1):
        shutil.rmtree(private_folder_of(uid), ignore_errors=True)


def test_each_shell_of_a_user_finds_the_runs_of_each_other(own_place, of_a_user):
    everywhere, nowhere = f"{[of_a_user]} {[of_a_user]} {[of_a_user]}", "[] [] []"
    for number, name in enumerate(SHELLS):
        others = list(SHELLS)[number + 1 :] + list(SHELLS)[:number]
        with flying(own_place, name, UID, of_a_user):
            assert found(own_place, others[0], UID, of_a_user) == (everywhere, "")
    with flying(own_place, "cron", UID, of_a_user):
        assert found(own_place, "cron", UID + 1, of_a_user) == (nowhere, ""), (
            "another user's are not shown"
        )
    assert found(own_place, "cron", UID, of_a_user) == (nowhere, "")


def test_root_finds_the_runs_of_all_users_and_first_those_of_the_sudo_caller(
    own_place, of_a_user, monkeypatch
):
    with flying(own_place, "login shell", UID, of_a_user):
        _, _, at_all = found(own_place, "nothing", 0, of_a_user)[0].split(" ")
        assert at_all == f"{[of_a_user]}"
        monkeypatch.delenv("CRAZYCHOIR_RUNTIME_DIR")
        monkeypatch.setattr(running, "existing_runtime_folder", lambda: None)
        monkeypatch.setenv("SUDO_UID", str(UID))
        assert [run.swarm for run in list_own_runs()] == [of_a_user]
        monkeypatch.setenv("SUDO_UID", str(UID + 1))
        assert of_a_user in [run.swarm for run in list_own_runs()]


def test_a_folder_that_another_user_has_taken_is_refused_aloud(own_place, of_a_user):
    folder = private_folder_of(UID)
    for harm in (
        lambda: folder.mkdir(mode=0o777),
        lambda: folder.symlink_to(own_place),
        folder.touch,
    ):
        harm()
        refused = (
            rf"{folder}: found it (belongs|is)[^;]*; allowed: a folder of this user"
        )
        with pytest.raises(AssertionError, match=refused):
            flying(own_place, "cron", UID, of_a_user).__enter__()
        none, said = found(own_place, "cron", UID, of_a_user)
        assert none == "[] [] []"
        assert f"{folder}: found it" in said
        assert "Remove it" in said
        assert said.count("Remove it") == 1
        folder.rmdir() if folder.is_dir() and not folder.is_symlink() else folder.unlink()


def test_what_lies_in_the_folder_of_another_user_does_no_harm_to_root(
    own_place, of_a_user
):
    """The folder has an empty pipe, a link to a file of root, a record of another owner, and a file without JSON."""
    folder = private_folder_of(UID)
    folder.mkdir(mode=0o700)
    os.mkfifo(folder / "pipe")
    (folder / "link").symlink_to("/etc/shadow")
    (folder / "foreign").write_text("{}")
    (folder / "text").write_text("[" * 100_000)
    for path in (folder, folder / "text", folder / "pipe"):
        os.chown(path, UID, UID)
    assert running._list_runs_of(UID) == []
    assert len(list(folder.iterdir())) == 4, "and nothing is removed"


def test_a_run_without_a_record_says_how_others_find_it(own_place, monkeypatch, caplog):
    monkeypatch.setenv("CRAZYCHOIR_RUNTIME_DIR", "/proc/crazychoir")
    run = run_of(own_place, "lab-1")
    with record_run(run):
        pass
    assert (
        f"Other shells must name it: crazychoir land --swarm {run.file}" in caplog.text
    )


@pytest.mark.parametrize(
    "record",
    [
        '{"swarm": [], "what": "x", "source": null, "file": "lab.toml"}',
        '{"swarm": "lab", "what": "x", "source": null, "file": 3}',
        '{"swarm": "lab\\u001b[2J", "what": "x", "source": null, "file": "lab.toml"}',
        '{"swarm": "lab", "what": "x", "source": null, "file": "pipe"}',
        "[" * 60_000,
        "{}",
        "",
    ],
)
def test_a_record_that_says_what_no_run_says_is_no_run(own_place, record):
    """Another local user may have written it."""
    os.mkfifo(own_place / "pipe")
    folder = own_place / "crazychoir"
    folder.mkdir(mode=0o700)
    with (folder / "lab-1").open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.write(record)
        file.flush()
        assert list_own_runs() == []


@pytest.mark.parametrize(
    "what", ["mission\u00a0a.py", "\u3000a.py", "caf\udce9.py", "\u001b[2J"]
)
def test_a_name_that_looks_odd_hides_no_run(own_place, what):
    run = replace(run_of(own_place, "lab-1"), what=what)
    with record_run(run):
        (found,) = list_own_runs()
    assert found.swarm == "lab-1"
    assert found.what.isprintable()
