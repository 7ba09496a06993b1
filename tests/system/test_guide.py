"""deploy/GUIDE.md to the letter: what it says is typed on three fresh workstations, which are namespaces.

Each has a network, a home, an sshd and a systemd of its user of its own. What stands in for what namespaces lack: the
packages of `sudo apt-get` are there, `ssh-copy-id` needs no password, and the package index is a folder of wheels. Of
the thirty drones six are flown, each in its process, as on one machine thirty have too few processors; for all thirty
see test_workstations.py.
"""

import asyncio
import contextlib
import os
import re
import shutil
import subprocess
import time
from pathlib import Path

import pytest

from crazychoir.config.swarm_config import SwarmConfig
from crazychoir.launch.namespaces import make_switched_namespaces

PYTHON, SYSTEMD = Path("/usr/bin/python3"), Path("/usr/lib/systemd/systemd")
SSHD = shutil.which("sshd", path="/usr/sbin:/usr/bin")
pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.slow,
    pytest.mark.timeout(2400),
    pytest.mark.skipif(
        SSHD is None or not SYSTEMD.exists(), reason="needs openssh-server and systemd"
    ),
]
LEFT, RIGHT = (0, 1, 2), (6, 7, 8)
LONG = 900.0
"""s for a section of the guide."""
WORKSTATION = f"""
set -e
mount --make-rprivate /
mount -t tmpfs -o mode=755 tmpfs /run
mkdir -p /run/user/0 /run/sshd /run/systemd/system
mount -t tmpfs -o mode=755 tmpfs /home
mkdir /home/me
mount --bind "$1/home" /home/me
mount --bind "$1/passwd" /etc/passwd
mount -t cgroup2 none /sys/fs/cgroup
mkdir /sys/fs/cgroup/$2
echo $$ >/sys/fs/cgroup/$2/cgroup.procs
hostname "$3"
env -i HOME=/home/me USER=me PATH="$4" XDG_RUNTIME_DIR=/run/user/0 {SYSTEMD} --user >"$1/systemd.txt" 2>&1 &
exec {SSHD} -D -e -f /dev/null -h "$1/key" -o UsePAM=no -o PidFile=none -o StrictModes=no -o MaxStartups=100 \\
    -o "Subsystem=sftp internal-sftp" -o "SetEnv=XDG_RUNTIME_DIR=/run/user/0 PATH=$4 PIP_NO_INDEX=1 PIP_FIND_LINKS=$5"
"""


def sections(text):
    """The first block of commands of each numbered section."""
    parts = re.split(r"^## (\d)\. ", text, flags=re.MULTILINE)[1:]
    found = {
        int(k): re.search(r"```sh\n(.*?)```", part, re.DOTALL)
        for k, part in zip(*[iter(parts)] * 2, strict=True)
    }
    return {k: block[1] for k, block in found.items() if block}


def fewer(text):
    """Return the swarm file with just the drones LEFT, on host left, and the drones RIGHT, on host right."""
    kept = LEFT + RIGHT
    text = re.sub(
        r"\[(\d+), (\d+)\],",
        lambda m: m[0] if {int(m[1]), int(m[2])} <= {*kept} else "",
        text,
    )
    text = re.sub(
        r"^(\d+) = \[.*\n",
        lambda m: m[0] if int(m[1]) in kept else "",
        text,
        flags=re.MULTILINE,
    )
    head, *drones = text.split("[[drones]]\n")
    some = [drone for drone in drones if int(re.match(r"id = (\d+)", drone)[1]) in kept]
    placed = [
        drone.replace('"left"', '"right"') if k >= len(LEFT) else drone
        for k, drone in enumerate(some)
    ]
    placed[len(LEFT) - 1] = placed[len(LEFT) - 1].replace("home", "leader = true\nhome")
    return "[[drones]]\n".join([head, *placed])


def run(*command, **options):
    subprocess.run([str(word) for word in command], check=True, timeout=LONG, **options)


class Lab:
    """The workstations of a swarm file, one user `me` on each."""

    def __init__(self, folder, hosts, config, repository):
        self.folder, self.hosts, self.config, self.repository = (
            folder,
            hosts,
            config,
            repository,
        )
        self.wheels, self.programs, self.origin = (
            folder / "wheels",
            folder / "bin",
            folder / "origin",
        )
        self.stations = {host: folder / host for host in config.hosts}
        self.running = []

    def prepare(self):
        """What is there before the guide begins."""
        self.programs.mkdir()
        homes = " ".join(str(station / "home") for station in self.stations.values())
        copies = f"for h in {homes}; do cat ~/.ssh/id_ed25519.pub >>$h/.ssh/authorized_keys; done"
        for name, text in {"sudo": "exit 0", "ssh-copy-id": copies}.items():
            (self.programs / name).write_text(f"#!/bin/sh\n{text}\n")
            (self.programs / name).chmod(0o755)
        run("git", "clone", "-q", self.repository, self.origin)
        file = self.origin / "deploy/three_workstations.toml"
        file.write_text(fewer(file.read_text()))
        run(
            "git",
            "-C",
            self.origin,
            "-c",
            "user.name=me",
            "-c",
            "user.email=me@lab",
            "commit",
            "-qam",
            "Six drones",
        )
        run(PYTHON, "-m", "venv", self.folder / "index")
        wheel = [
            self.folder / "index/bin/python",
            "-m",
            "pip",
            "wheel",
            "-q",
            "-w",
            self.wheels,
        ]
        run(*wheel, self.origin, "setuptools>=77", "wheel", cwd=self.folder)
        for made in self.wheels.glob("crazychoir-*"):
            made.unlink()  # the guide makes its own
        console = self.folder / "console"
        run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", console)
        for station in self.stations.values():
            (station / "home/.ssh").mkdir(parents=True)
            (station / "home/.ssh/config").write_text(
                "StrictHostKeyChecking accept-new\nLogLevel ERROR\n"
            )
            shutil.copy(
                self.folder / "console.pub", station / "home/.ssh/authorized_keys"
            )
            given = Path("/etc/passwd").read_text()
            (station / "passwd").write_text(f"me:x:0:0::/home/me:/bin/bash\n{given}")
            run("ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", station / "key")

    async def boot(self, host):
        station, path = (
            self.stations[host],
            f"{self.programs}:/usr/local/bin:/usr/bin:/bin",
        )
        arguments = [station, f"cc-{os.getpid()}-{host}", host, path, self.wheels]
        log = os.open(station / "sshd.txt", os.O_CREAT | os.O_WRONLY)
        self.running.append(
            await asyncio.create_subprocess_exec(
                *self.hosts.command(host),
                "unshare",
                "--mount",
                "--uts",
                "--pid",
                "--fork",
                "--kill-child",
                "--mount-proc",
                "bash",
                "-c",
                WORKSTATION,
                "workstation",
                *map(str, arguments),
                stderr=log,
            )
        )
        os.close(log)

    async def type(self, text, host="physics", seconds=LONG):
        """Run these lines on the host, as an operator types them, and return the output; typed.txt keeps all of it."""
        at = f"me@{self.config.hosts[host]}"
        quiet = [
            word
            for one in (
                "StrictHostKeyChecking=no",
                "UserKnownHostsFile=/dev/null",
                "LogLevel=ERROR",
            )
            for word in ("-o", one)
        ]
        process = await asyncio.create_subprocess_exec(
            *self.hosts.command(host),
            "ssh",
            "-i",
            str(self.folder / "console"),
            *quiet,
            at,
            f"set -ex\n{text}",
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )
        said = (await asyncio.wait_for(process.communicate(), seconds))[0].decode(
            errors="replace"
        )
        with open(self.folder / "typed.txt", "a") as file:  # noqa: ASYNC230
            file.write(f"$ {text}\n{said}\n")
        assert process.returncode == 0, said[-4000:]
        return said


@contextlib.asynccontextmanager
async def lab(folder, repository):
    config = SwarmConfig.load(repository / "deploy/three_workstations.toml")
    with make_switched_namespaces(config.hosts) as hosts:
        made = Lab(folder, hosts, config, repository)
        await asyncio.to_thread(made.prepare)
        try:
            for host in config.hosts:
                await made.boot(host)
            await asyncio.sleep(3.0)
            yield made
        finally:
            for process in made.running:
                process.kill()
                await process.wait()


async def ended(made, host, ids):
    """The exit codes of a host's agents, once none of them runs."""
    units = " ".join(f"crazychoir-agent@{i}" for i in ids)
    ends = time.monotonic() + LONG
    while True:
        said = await made.type(
            f"systemctl --user show -P ActiveState -P ExecMainStatus {units}", host
        )
        words = said.split()
        if not {"active", "activating", "reloading", "deactivating"} & set(words):
            return [int(word) for word in words if word.isdigit()]
        assert time.monotonic() < ends, said
        await asyncio.sleep(5.0)


async def test_from_empty_workstations_to_a_flying_swarm(repository, tmp_path):
    typed = sections((repository / "deploy/GUIDE.md").read_text())
    async with lab(tmp_path, repository) as made:
        once = typed[1].replace("REPOSITORY", str(made.origin))
        await made.type(once + typed[2] + typed[3])
        watch = "venv/bin/crazychoir status --watch"
        assert watch in typed[4]
        starts = typed[4].replace(watch, f"timeout -s INT 30 {watch} || true")
        for asked, ids in (("seq 0 14", LEFT), ("seq 15 29", RIGHT)):
            assert asked in starts
            starts = starts.replace(asked, f"echo {' '.join(map(str, ids))}")
        said = await made.type(starts)
        assert "on ground" in said or "mission" in said, said
        assert (
            await ended(made, "left", LEFT)
            == await ended(made, "right", RIGHT)
            == [0, 0, 0]
        )
