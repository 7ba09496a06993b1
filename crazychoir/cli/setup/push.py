"""crazychoir push: copy a swarm to its hosts by ssh.

It copies the program, the swarm file and the files that it names, the keys and systemd units.
"""

import shlex
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crazychoir.errors import ConfigError, CrazyChoirError, ProcessFailed
from crazychoir.launch.console import ANSWER_CONSOLE, exit_with_error

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig


@dataclass(frozen=True, slots=True)
class PushSettings:
    """How a swarm is copied to a host."""

    folder: str = "choir"
    """Folder on the host, in the home of the user."""
    step_timeout: float = 60.0
    """Seconds for a step."""
    install_timeout: float = 900.0
    """Seconds for a step that installs packages."""
    ssh_command: tuple[str, ...] = (
        "ssh",
        "-o",
        "BatchMode=yes",
        "-o",
        "ConnectTimeout=10",
    )
    """Command that runs a program on the host, without its arguments."""
    scp_command: tuple[str, ...] = (
        "scp",
        "-q",
        "-p",
        "-r",
        "-o",
        "BatchMode=yes",
        "-o",
        "ConnectTimeout=10",
    )
    """Command that copies files to the host, without its arguments."""
    units_folder: str = ".config/systemd/user"
    """Folder of the user's systemd units on the host."""


PUSH_SETTINGS = PushSettings()


@dataclass(frozen=True)
class PushStep:
    """One command that runs on this machine."""

    what: str
    """What it does, for the log."""
    command: tuple[str, ...]
    """The words of its command line."""
    deadline: float = PUSH_SETTINGS.step_timeout
    """Seconds that it may take."""


def push(
    swarm: Annotated[Path, typer.Option(help="Swarm file.")],
    host: Annotated[
        list[str] | None,
        typer.Option(help="Only this host; repeat the option for several hosts."),
    ] = None,
    user: Annotated[
        str | None,
        typer.Option(help="User on the host; else the user that ssh chooses."),
    ] = None,
    package: Annotated[
        Path | None, typer.Option(help="Wheel or folder to install, else the release.")
    ] = None,
    units: Annotated[
        Path | None,
        typer.Option(help="Folder of systemd units, as deploy/systemd; else none."),
    ] = None,
    dry_run: Annotated[
        bool,
        typer.Option("--dry-run", help="Print the commands, do nothing."),
    ] = False,
) -> None:
    """Copy a swarm to its hosts, over ssh.

    The files go into ~/choir, by ssh and scp, with your ssh keys.
    """
    from crazychoir.config.swarm_config import SwarmConfig

    try:
        if swarm.suffix != ".toml":
            raise ConfigError(
                "--swarm",
                str(swarm),
                "a TOML file",
                f"The units there read ~/{PUSH_SETTINGS.folder}/swarm.toml.",
            )
        config = SwarmConfig.load(swarm)
        plans = {
            name: list(push_steps(config, swarm, name, user, package, units))
            for name in hosts_to_push(config, swarm, host)
        }
        for name, step in [
            (name, step) for name, plan in plans.items() for step in plan
        ]:
            ANSWER_CONSOLE.print(
                shlex.join(step.command) if dry_run else f"{name}: {step.what}",
                markup=False,
                highlight=False,
                soft_wrap=True,
            )
            if not dry_run:
                run_push_step(name, step)
    except CrazyChoirError as error:
        exit_with_error(error, as_json=False)


def hosts_to_push(
    config: "SwarmConfig", swarm: Path, only: list[str] | None
) -> list[str]:
    """Return the hosts to push to.

    Raises ConfigError for a host that [hosts] does not have.
    """
    names = ", ".join(config.hosts) or "none"
    if not config.hosts:
        raise ConfigError(
            f"{swarm}: hosts",
            "nothing",
            "[hosts] with names and addresses",
            "Add them.",
        )
    for name in only or ():
        if name not in config.hosts:
            raise ConfigError("--host", name, f"[hosts] has {names}")
    return only or list(config.hosts)


def push_steps(
    config: "SwarmConfig",
    swarm: Path,
    host: str,
    user: str | None,
    package: Path | None,
    units: Path | None,
) -> Iterator[PushStep]:
    """Yield the steps for one host, in order.

    The swarm file becomes ~/choir/swarm.toml on the host. The files that it names lie beside it as
    they do here.
    Raises ConfigError for files that are missing or lie outside the folder of the swarm file.
    """
    from importlib.metadata import version

    at, into = ssh_and_scp_targets(config.hosts[host], user)
    files = {path: path_in_swarm_folder(swarm, path) for path in files_to_push(config)}
    folders = sorted(
        {PUSH_SETTINGS.folder: None}
        | {
            str(Path(PUSH_SETTINGS.folder, path).parent): None
            for path in files.values()
        }
    )
    own = Path(config.security.keys) / host
    if config.secured:
        keys = str(Path(PUSH_SETTINGS.folder, path_in_swarm_folder(swarm, own)).parent)
        if not own.is_dir():
            raise ConfigError(
                "security.keys",
                str(own),
                "the keys of this host",
                f"crazychoir keys add {host}",
            )
        folders.append(keys)
    yield PushStep(
        "folders",
        (
            *PUSH_SETTINGS.ssh_command,
            at,
            f"mkdir -p -m 700 {shlex.join(folders)} {PUSH_SETTINGS.units_folder}",
        ),
    )
    yield PushStep(
        "swarm file",
        (
            *PUSH_SETTINGS.scp_command,
            str(swarm.resolve()),
            f"{into}:{PUSH_SETTINGS.folder}/swarm.toml",
        ),
    )
    for path, place in files.items():
        yield PushStep(
            f"{place}",
            (
                *PUSH_SETTINGS.scp_command,
                str(path),
                f"{into}:{PUSH_SETTINGS.folder}/{place}",
            ),
        )
    if config.secured:
        yield PushStep(
            "its keys", (*PUSH_SETTINGS.scp_command, str(own), f"{into}:{keys}/")
        )
    for unit in find_units(units) if units is not None else ():
        yield PushStep(
            f"unit {unit.name}",
            (
                *PUSH_SETTINGS.scp_command,
                str(unit),
                f"{into}:{PUSH_SETTINGS.units_folder}/",
            ),
        )
    if units is not None:
        yield PushStep(
            "units known",
            (*PUSH_SETTINGS.ssh_command, at, "systemctl --user daemon-reload"),
        )
    yield PushStep(
        "environment",
        (
            *PUSH_SETTINGS.ssh_command,
            at,
            f"test -x {PUSH_SETTINGS.folder}/venv/bin/pip || python3 -m venv {PUSH_SETTINGS.folder}/venv",
        ),
        PUSH_SETTINGS.install_timeout,
    )
    what = f"crazychoir=={version('crazychoir')}"
    if package is not None:
        if not package.exists():
            raise ConfigError(
                "--package",
                str(package),
                "a wheel or a folder",
                "python -m build --wheel",
            )
        package = package.resolve()
        yield PushStep(
            "package",
            (
                *PUSH_SETTINGS.scp_command,
                str(package),
                f"{into}:{PUSH_SETTINGS.folder}/",
            ),
            PUSH_SETTINGS.install_timeout,
        )
        what = f"{PUSH_SETTINGS.folder}/{package.name}"
    install = f"{PUSH_SETTINGS.folder}/venv/bin/pip install --quiet"
    yield PushStep(
        "installed",
        (*PUSH_SETTINGS.ssh_command, at, f"{install} {shlex.quote(what)}"),
        PUSH_SETTINGS.install_timeout,
    )
    if package is not None:  # pip does not replace a package of the same version
        again = f"{install} --force-reinstall --no-deps {shlex.quote(what)}"
        yield PushStep(
            "installed anew",
            (*PUSH_SETTINGS.ssh_command, at, again),
            PUSH_SETTINGS.install_timeout,
        )
    # Compile the kernels once, before the agents of the host start together and wait for them.
    laws = f"{PUSH_SETTINGS.folder}/venv/bin/crazychoir compile"
    yield PushStep(
        "laws compiled",
        (*PUSH_SETTINGS.ssh_command, at, laws),
        PUSH_SETTINGS.install_timeout,
    )


def ssh_and_scp_targets(address: str, user: str | None) -> tuple[str, str]:
    """Return a host as ssh and as scp want it.

    scp takes the text before the first colon for the host. So an IPv6 address stands in brackets.
    """
    before = f"{user}@" if user else ""
    return (
        f"{before}{address}",
        f"{before}[{address}]" if ":" in address else f"{before}{address}",
    )


def find_units(folder: Path) -> list[Path]:
    """Return the systemd units of a folder.

    Raises ConfigError if there is none.
    """
    found = sorted(folder.resolve().glob("*.service"))
    if not found:
        raise ConfigError(
            "--units",
            str(folder),
            "a folder of *.service, as deploy/systemd",
            "Is it that?",
        )
    return found


def files_to_push(config: "SwarmConfig") -> list[Path]:
    """Return the files beside the swarm file that a flight needs."""
    from crazychoir.config.file_paths import list_files

    files = list(list_files(config).values())
    if config.mission is not None and config.mission.endswith(".py"):
        files.append(Path(config.mission))
    if config.mocap.file:
        files.append(Path(config.mocap.file))
    return list(dict.fromkeys(files))


def path_in_swarm_folder(swarm: Path, path: Path) -> Path:
    """Return the path relative to the folder of the swarm file.

    Raises ConfigError if the path lies outside of it.
    """
    folder = swarm.resolve().parent
    place = path.resolve()
    if not place.is_relative_to(folder):
        do = f"Move it below {folder}, and name it so in the swarm file."
        raise ConfigError(
            str(swarm), str(path), "files below the folder of the swarm file", do
        )
    return place.relative_to(folder)


def run_push_step(host: str, step: PushStep) -> None:
    """Run the command of a step.

    Raises ProcessFailed with the last line of its output.
    """
    try:
        done = subprocess.run(
            step.command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=step.deadline,
            check=False,
        )
    except FileNotFoundError as error:
        raise ProcessFailed(
            step.command[0], "it is not on this machine. Install openssh-client."
        ) from error
    except subprocess.TimeoutExpired as error:
        raise ProcessFailed(
            f"{host}: {step.what}",
            f"not done within {step.deadline:g} s. Is the host on?",
        ) from error
    if done.returncode:
        said = (
            done.stderr.strip() or done.stdout.strip() or "it says nothing"
        ).splitlines()[-1]
        do = "Try it by hand: " + shlex.join(step.command)
        raise ProcessFailed(
            f"{host}: {step.what}", f"exit code {done.returncode}: {said}. {do}"
        )
