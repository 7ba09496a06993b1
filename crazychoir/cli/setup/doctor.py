"""crazychoir doctor: check whether this host is ready to fly its part of a swarm."""

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich import box
from rich.table import Table
from rich.text import Text

from crazychoir.cli.setup.host_checks import CheckResult, is_wrong
from crazychoir.launch.console import ANSWER_CONSOLE, redirect_prints, write_json

if TYPE_CHECKING:
    from crazychoir.config.swarm_config import SwarmConfig

CORRECT_IT = "Correct it as the text says."
"""What to do about a fault or a warning that names it."""
STATE_COLOURS = {
    "ok": "green",
    "warning": "yellow",
    "wrong": "bold red",
    "not here": "dim",
}


def doctor(
    swarm: Annotated[
        str | None, typer.Option(help="Swarm file; else ./swarm.toml, else the demo.")
    ] = None,
    host: Annotated[
        str | None,
        typer.Option(
            help="Name of this host in the table hosts; else found by its addresses."
        ),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON object, nothing else.")
    ] = False,
) -> None:
    """Check whether this host is ready to fly.

    Prints each fault with the command that repairs it. Exits with 1 if there is a
    fault.
    """
    rows = check_machine() + check_swarm(swarm, host)
    if as_json:
        write_json(
            {"success": not is_wrong(rows), "rows": [asdict(row) for row in rows]}
        )
    else:
        _show(rows)
    raise typer.Exit(1 if is_wrong(rows) else 0)


def check_machine(sys_folder: Path = Path("/sys")) -> list[CheckResult]:
    """Return the checks that do not depend on a swarm.

    sys_folder: the folder /sys; another one in tests
    """
    from crazychoir.cli.setup import host_checks, host_facts

    needed = host_facts.required_packages()
    names = [line.partition(">=")[0] for line in needed]
    return [
        host_checks.check_python(tuple(sys.version_info[:3])),
        *host_checks.check_packages(needed, host_facts.installed_versions(names)),
        host_checks.check_synchronisation(*host_facts.clock_synchronisation()),
        host_checks.check_wake_ups(host_facts.wake_up_delay_ms()),
        host_checks.check_governor(host_facts.governors(sys_folder)),
        host_checks.check_open_files(host_facts.open_file_limit()),
        host_checks.check_disk(host_facts.disk_mb(Path.cwd()), str(Path.cwd())),
        host_checks.report_multicast(),
    ]


def check_swarm(swarm: str | None, host: str | None) -> list[CheckResult]:
    """Return the checks of what the swarm file needs on this host.

    swarm: path of the swarm file; None for ./swarm.toml, else the demo swarm
    host: name of this host in [hosts]; None to find it by its addresses
    """
    from crazychoir.config.swarm_config import find_swarm
    from crazychoir.errors import ConfigError

    try:
        config, which = find_swarm(swarm)
    except ConfigError as error:
        return [
            CheckResult(
                "swarm file",
                "wrong",
                str(error),
                "Correct it as the text says, or copy it here: crazychoir push",
            )
        ]
    rows = [
        CheckResult("swarm file", "ok", f"{which}: {len(config.ids)} drone(s)"),
        *check_mission(config),
    ]
    return rows + find_missing_files(config) + check_network(config, host)


def check_mission(config: "SwarmConfig") -> list[CheckResult]:
    """Return the checks that the mission can be loaded and flown, and a warning for each of its own."""
    from crazychoir.errors import CrazyChoirError
    from crazychoir.guidance.mission import check_before_flight, load_mission

    if config.mission is None:
        do = 'Write mission = "..." into the swarm file, or give --mission.'
        return [CheckResult("mission", "warning", "none", do)]
    try:
        with redirect_prints():
            warnings = check_before_flight(load_mission(config.mission), config)
    except CrazyChoirError as error:
        is_lost = config.mission.endswith(".py") and not Path(config.mission).is_file()
        do = (
            "Copy it here beside the swarm file: crazychoir push"
            if is_lost
            else CORRECT_IT
        )
        return [CheckResult("mission", "wrong", str(error), do)]
    return [
        CheckResult("mission", "ok", config.mission),
        *(CheckResult("flight", "warning", text, CORRECT_IT) for text in warnings),
    ]


def find_missing_files(config: "SwarmConfig") -> list[CheckResult]:
    """Return a fault for each file that the swarm file names and that is missing."""
    from crazychoir.config.file_paths import list_files

    lost = {key: path for key, path in list_files(config).items() if not path.is_file()}
    do = "Copy it here: crazychoir push"
    return [
        CheckResult(f"file of {key}", "wrong", f"{path}: it is not there", do)
        for key, path in lost.items()
    ]


def check_network(config: "SwarmConfig", host: str | None) -> list[CheckResult]:
    """Return the checks of the network and the devices of this host.

    They concern addresses, ports, other hosts, keys, radios, cameras, and memory for its processes.
    """
    from crazychoir.cli.setup import host_checks, host_facts
    from crazychoir.config.addresses import Addresses

    own = [name for name, address in config.hosts.items() if host_facts.is_own(address)]
    here = [name for name in own if host in (None, name)]
    inward = {
        name: at for name in here if (at := host_facts.loopback_of(config.hosts[name]))
    }
    rows = [host_checks.check_own_host(config.hosts, own, host, inward)]
    names = listening_processes(config, here)
    held = {
        port: host_facts.port_holder(port)
        for port, (address, _) in names.items()
        if not host_facts.is_free(address, port)
    }
    rows += host_checks.check_ports(
        {port: name for port, (_, name) in names.items()}, held
    )
    # With a router a host connects to nothing else.
    others = config.hosts if config.router is None else [config.router]
    for name in (name for name in others if name not in own):
        port = min(listening_processes(config, [name]), default=config.base_port)
        address = config.hosts[name]
        answer = host_facts.connect_to_host(address, port)
        stranger = ""
        if answer == "connected" and config.secured and here:
            stranger = host_facts.try_handshake(
                address, port, Path(config.security.keys) / here[0]
            )
        rows.append(host_checks.check_other_host(name, address, answer, stranger))
    rows += check_certificates(config, here)
    ids = [
        i
        for k, ids in config.topology.dongles.items()
        if _is_here(config.topology.dongle_host(k), here)
        for i in ids
    ]
    uris = [config.drone(i).uri for i in ids]
    numbers = [int(uri.split("/")[2]) for uri in uris if uri.startswith("radio://")]
    rows += host_checks.check_crazyradios(host_facts.crazyradios(), numbers)
    rows += check_cameras(config, here)
    addresses = Addresses(config)
    processes = sum(
        _is_here(addresses.host_of(process), here) for process in addresses.endpoints()
    )
    return [*rows, host_checks.check_memory(host_facts.memory_mb(), processes)]


def check_cameras(config: "SwarmConfig", hosts: list[str]) -> list[CheckResult]:
    """Return the checks of the motion capture system, from the host on which it is read.

    hosts: names of this machine in [hosts]
    """
    from crazychoir.cli.fly.mocap import host_and_port
    from crazychoir.cli.setup import camera_checks, host_facts
    from crazychoir.mocap.system import SYSTEM_PORTS, SYSTEM_PROGRAMS, has_library

    source = config.mocap.source
    if not config.topology.seen:
        return [camera_checks.report_no_cameras("no drone is seen by cameras")]
    if not _is_here(config.mocap.host, hosts):
        where = f"read on host {config.mocap.host}: ask crazychoir doctor there"
        return [camera_checks.report_no_cameras(where)]
    if source in camera_checks.SOURCES_WITHOUT_LIBRARY:
        return [camera_checks.describe_other_source(config.mocap)]
    rows = [camera_checks.check_library(source, has_library())]
    if source in SYSTEM_PROGRAMS:
        name, own_port = host_and_port(config.mocap.hostname)
        port = SYSTEM_PORTS.get(source)
        if port is not None and own_port.isdecimal():
            port = int(own_port)
        answer = "" if port is None else host_facts.connect_to_host(name, port)
        rows.append(camera_checks.check_system(source, name, port, answer))
    return rows


def listening_processes(
    config: "SwarmConfig", hosts: list[str]
) -> dict[int, tuple[str, str]]:
    """Return the ports of these hosts, each with its address and the process that listens there.

    In a swarm with a router only the router listens.
    """
    from crazychoir.config.addresses import PROCESS_NUMBERS, Addresses

    addresses = Addresses(config)
    found = {}
    for process, endpoint in addresses.endpoints().items():
        listens = config.router is None or process == PROCESS_NUMBERS.router
        if listens and _is_here(addresses.host_of(process), hosts):
            address, _, port = endpoint.partition("/")[2].rpartition(":")
            found[int(port)] = (address.strip("[]"), describe_process(process))
    return found


def describe_process(process: int) -> str:
    """Return the name of a process in words."""
    from crazychoir.config.addresses import PROCESS_NUMBERS

    owners = {
        PROCESS_NUMBERS.world: "the world's owner",
        PROCESS_NUMBERS.motion_capture: "motion capture",
        PROCESS_NUMBERS.router: "the router",
    }
    if process >= 0:
        return f"drone {process}"
    return owners.get(process, f"dongle {PROCESS_NUMBERS.first_dongle - process}")


def check_certificates(config: "SwarmConfig", hosts: list[str]) -> list[CheckResult]:
    """Return the checks of the keys of this machine, for each of its names in [hosts]."""
    from crazychoir.bus.network import authority
    from crazychoir.cli.setup import host_checks
    from crazychoir.errors import ConfigError
    from crazychoir.runtime.clock import date_and_time

    if not config.secured:
        if config.security.insecure:
            do = "Leave security.insecure out, and make keys: crazychoir keys init"
            return [
                CheckResult(
                    "keys",
                    "warning",
                    "the network is open (security.insecure): every host on it can command",
                    do,
                )
            ]
        return [
            CheckResult("keys", "not here", "a swarm on this machine only needs none")
        ]
    rows = []
    for name in hosts:
        fault = ""
        do = ""
        days = 0.0
        try:
            own = authority.check_keys(Path(config.security.keys), name)
            days = (
                authority.earliest_expiry(own) - date_and_time()
            ).total_seconds() / 86400
        except ConfigError as error:
            fault = str(error).removesuffix(error.do).rstrip()
            do = error.do
        rows.append(host_checks.check_host_keys(name, fault, do, days))
    return rows


def _is_here(host: str | None, here: list[str]) -> bool:
    return host is None or host in here


def _show(rows: list[CheckResult]) -> None:
    table = Table("", box=box.SIMPLE_HEAD, padding=(0, 1))
    for heading in ("what", "found", "how to correct it"):
        table.add_column(heading, overflow="fold")
    for row in rows:
        colour = STATE_COLOURS[row.state]
        table.add_row(Text(row.state, colour), row.what, row.found, row.mend)
    ANSWER_CONSOLE.print(table)
