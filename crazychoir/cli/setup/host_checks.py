"""The checks of `crazychoir doctor`: each gets facts and returns what is wrong and the repair."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "warning", "wrong", "not here"]


@dataclass(frozen=True, slots=True)
class HostRequirements:
    """What a host needs for a flight."""

    python_versions: tuple[tuple[int, ...], ...] = ((3, 11), (3, 15))
    """First supported version of Python, and the first version that is not supported any more.
    """
    process_memory: float = 300.0
    """MB: memory of one agent."""
    disk_space: float = 1000.0
    """MB: size of the recording of a long flight of many drones."""
    open_files: int = 1024
    """Open files and sockets that a process needs: it has a link to each other process."""
    wake_up_delay: float = 5.0
    """ms: latest wake-up allowed, half a period of the control law at 100 Hz."""
    certificate_warning: int = 30
    """Days before the end of a certificate from which on there is a warning."""


HOST_REQUIREMENTS = HostRequirements()


BOOTLOADER_ID = "1915:0101"
"""USB vendor and product of a Crazyradio PA in its bootloader."""
CRAZYRADIO_IDS = ("1915:7777", BOOTLOADER_ID, "35f0:bad2")
"""USB vendor and product: Crazyradio PA, its bootloader, Crazyradio 2.0."""
UDEV_COMMANDS = (
    """echo 'SUBSYSTEM=="usb", ATTRS{idVendor}=="1915|35f0", MODE="0664", GROUP="plugdev"' | """
    "sudo tee /etc/udev/rules.d/99-crazyradio.rules && sudo udevadm control --reload && sudo udevadm trigger; "
    "sudo usermod -aG plugdev $USER, which counts from the next login"
)
"""Commands that let users of the group plugdev write to Crazyradios."""
_OWN_PROCESS = re.compile(
    r"process \d+: (\S+ (-\S+ )*)?(\S*/)?(crazychoir(-\w+)?|crazychoir(\.\w+)+)( |$)"
)
"""Matches a command line of our own processes.

The name must be the program itself or the module that an interpreter runs. A word of its
arguments does not count.
"""
_REQUIREMENT_PATTERN = re.compile(r"([A-Za-z0-9._-]+)>=([\d.]+)")


@dataclass(frozen=True)
class CheckResult:
    """The result of one check."""

    what: str
    """Name of the thing that was checked."""
    state: State
    """Result of the check."""
    found: str
    """Text that says what was found."""
    mend: str = ""
    """How to repair it; empty if nothing is wrong."""


@dataclass(frozen=True)
class UsbDevice:
    """A device on the USB."""

    kind: str
    """USB vendor and product, such as "1915:7777"."""
    path: str
    """Its file in /dev."""
    writable: bool
    """Whether this user may write to the file."""


def check_python(version: tuple[int, ...]) -> CheckResult:
    """Check the version of Python; version: as in sys.version_info."""
    first, last = HOST_REQUIREMENTS.python_versions
    found = ".".join(map(str, version[:3]))
    if first <= version[:2] < last:
        return CheckResult("python", "ok", found)
    return CheckResult(
        "python",
        "wrong",
        found,
        "Create the environment again: python3.13 -m venv ~/choir/venv",
    )


def check_packages(
    needed: Iterable[str], installed: Mapping[str, str]
) -> list[CheckResult]:
    """Check that the required packages are installed, in a version that is new enough.

    needed: lines of our metadata, such as "numpy>=2.4"
    installed: version of each package that is installed, by name
    """
    rows = []
    good = []
    for line in needed:
        found = _REQUIREMENT_PATTERN.match(line)
        if found is None or "extra ==" in line:
            continue
        name, least = found.groups()
        there = installed.get(name)
        if there is None or _number(there) < _number(least):
            state = (
                f"{there}, needed {least} or newer" if there else "it is not installed"
            )
            rows.append(
                CheckResult(
                    f"package {name}", "wrong", state, f"pip install '{name}>={least}'"
                )
            )
        else:
            good.append(f"{name} {there}")
    return rows or [CheckResult("packages", "ok", ", ".join(good))]


def _number(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version)[:4])


def check_own_host(
    hosts: Mapping[str, str],
    own: list[str],
    meant: str | None,
    inward: Mapping[str, str],
) -> CheckResult:
    """Check that [hosts] has an address of this machine, which other machines can reach.

    hosts: address of each host, by name
    own: names with an address of this machine
    meant: the name that this machine should have, None for any
    inward: for each of its names that resolves to the loopback here: that loopback address
    """
    if not hosts:
        return CheckResult("own host", "ok", "a swarm on this machine only: no [hosts]")
    names = ", ".join(f"{name} {address}" for name, address in hosts.items())
    if meant is not None and meant not in hosts:
        return CheckResult(
            "own host",
            "wrong",
            f"no host {meant} in [hosts]: {names}",
            f"Add {meant} to [hosts].",
        )
    if meant is not None and meant not in own:
        do = f"Write this machine's address into [hosts] ({meant} = ...): see `ip -brief address`."
        return CheckResult(
            "own host",
            "wrong",
            f"{meant} is {hosts[meant]}: no address of this machine",
            do,
        )
    for name, address in inward.items():
        do = "Write the address that others see into [hosts]: see `ip -brief address`; or mend /etc/hosts."
        found = f"{name} is {hosts[name]}, which is {address} on this machine: others do not reach that"
        return CheckResult("own host", "wrong", found, do)
    if own:
        return CheckResult(
            "own host", "ok", ", ".join(f"{name} {hosts[name]}" for name in own)
        )
    do = "Write this machine's address into [hosts]: see `ip -brief address`."
    return CheckResult("own host", "wrong", f"no address of this machine: {names}", do)


def check_ports(names: Mapping[int, str], held: Mapping[int, str]) -> list[CheckResult]:
    """Check that the ports of this host are free, or are held by our own processes.

    names: the process that listens on each port, by port
    held: command line that holds the port, for each port that is taken
    """
    if not names:
        return [
            CheckResult(
                "ports", "not here", "no process of the swarm listens on this host"
            )
        ]
    others = {port: by for port, by in held.items() if not _OWN_PROCESS.match(by)}
    rows = [
        CheckResult(
            f"port {port}",
            "wrong",
            f"of {names[port]}: taken by {by or 'a process of another user'}",
            f"End it (`ss -ltnp sport = :{port}` says which it is), or set another base_port in the swarm file.",
        )
        for port, by in others.items()
    ]
    ours = [f"{port} by {by}" for port, by in held.items() if port not in others]
    span = f"{min(names)} to {max(names)}" if len(names) > 1 else f"{min(names)}"
    said = (
        f"{span}: free"
        if not ours
        else f"{span}: held by our own processes: {'; '.join(ours)}"
    )
    return rows or [CheckResult("ports", "ok", said)]


def check_other_host(
    host: str, address: str, answer: str, stranger: str = ""
) -> CheckResult:
    """Check that another host answers.

    host: its name
    address: its address
    answer: "connected", "refused", or the reason for no answer
    stranger: why a process there does not accept our keys; empty if it does
    """
    what = f"host {host}"
    if stranger:
        do = f"Copy the folders of both hosts again from where the authority is, and restart all programs on {host}"
        return CheckResult(what, "wrong", f"{address} answers, and {stranger}", do)
    if answer in ("connected", "refused"):
        return CheckResult(
            what,
            "ok",
            f"{address} answers"
            + (": nothing runs there yet" if answer == "refused" else ""),
        )
    do = f"Is it on, and its firewall open? `ping {address}`; on {host}: sudo ufw allow from THIS_ADDRESS"
    return CheckResult(what, "wrong", f"{address}: {answer}", do)


def check_host_keys(host: str, fault: str, do: str, days: float) -> CheckResult:
    """Check the TLS keys of a host.

    host: its name
    fault: what is wrong with its folder of keys; empty if nothing is
    do: how to repair the fault
    days: days until its certificate expires
    """
    what = f"keys of {host}"
    if fault:
        return CheckResult(what, "wrong", fault, do)
    if days < HOST_REQUIREMENTS.certificate_warning:
        do = "crazychoir keys init --folder NEW, and so on, on the machine of the authority"
        return CheckResult(what, "warning", f"good for {days:.0f} days more", do)
    return CheckResult(what, "ok", f"good for {days:.0f} days")


def check_synchronisation(synchronised: bool | None, worst: float) -> CheckResult:
    """Check that the clock is synchronised.

    synchronised: as the kernel says, None if it does not say
    worst: s: its estimated error
    """
    if synchronised is None:
        return CheckResult(
            "clock", "not here", "the kernel does not say whether it is synchronised"
        )
    if synchronised:
        return CheckResult("clock", "ok", f"synchronised within {1000 * worst:.3g} ms")
    do = "sudo timedatectl set-ntp true   (or install chrony)"
    return CheckResult(
        "clock",
        "warning",
        "not synchronised: certificates and recordings use it, flights do not",
        do,
    )


def check_crazyradios(
    devices: list[UsbDevice], needed: Iterable[int]
) -> list[CheckResult]:
    """Check the Crazyradios of this host.

    devices: Crazyradios on the USB
    needed: numbers of the dongles that the swarm file gives to this host
    """
    wanted = list(needed)
    rows = []
    for device in devices:
        if not device.writable:
            rows.append(
                CheckResult(
                    f"radio {device.kind}",
                    "wrong",
                    f"no right to write to {device.path}",
                    UDEV_COMMANDS,
                )
            )
        if device.kind == BOOTLOADER_ID:
            do = "Take it out and plug it in again; if it stays so, write its firmware anew."
            rows.append(
                CheckResult(
                    f"radio {device.kind}",
                    "wrong",
                    f"{device.path} is in its bootloader",
                    do,
                )
            )
    last = max(wanted, default=-1)
    ready = sum(device.kind != BOOTLOADER_ID for device in devices)
    if last >= ready:
        do = "Plug it in: `lsusb -d 1915:` shows it."
        rows.append(
            CheckResult(
                "radios",
                "wrong",
                f"{ready} there; the swarm file names dongle {last} here",
                do,
            )
        )
    if not devices and not wanted:
        return [CheckResult("radios", "not here", "none, and none is needed")]
    return rows or [
        CheckResult("radios", "ok", ", ".join(device.path for device in devices))
    ]


def check_governor(governors: Mapping[str, str]) -> CheckResult:
    """Check that the processors run at full speed.

    governors: by processor, from /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor
    """
    slow = [cpu for cpu, name in governors.items() if name != "performance"]
    if not governors:
        return CheckResult(
            "cpu governor", "not here", "the kernel of this machine cannot set it"
        )
    if not slow:
        return CheckResult("cpu governor", "ok", "performance")
    do = "sudo cpupower frequency-set -g performance"
    return CheckResult(
        "cpu governor",
        "warning",
        f"{governors[slow[0]]} on {', '.join(slow)}: late wake-ups",
        do,
    )


def check_memory(free_mb: float, processes: int) -> CheckResult:
    """Check the memory.

    free_mb: MB that are free
    processes: number of processes of the swarm on this host
    """
    needed = HOST_REQUIREMENTS.process_memory * processes
    if free_mb >= needed:
        return CheckResult(
            "memory", "ok", f"{free_mb:.0f} MB free for {processes} process(es)"
        )
    do = "Let drones share processes: crazychoir run --processes, or `processes` in the swarm file."
    return CheckResult(
        "memory",
        "warning",
        f"{free_mb:.0f} MB free; {processes} process(es) take {needed:.0f} MB",
        do,
    )


def check_disk(free_mb: float, folder: str) -> CheckResult:
    """Check the space on the disk.

    free_mb: MB that are free
    folder: the folder of recordings
    """
    state: State = "ok" if free_mb >= HOST_REQUIREMENTS.disk_space else "warning"
    return CheckResult(
        "disk",
        state,
        f"{free_mb:.0f} MB free in {folder}",
        "" if state == "ok" else "Remove old recordings.",
    )


def check_open_files(limit: int) -> CheckResult:
    """Check the limit of open files.

    limit: number of files that a process may have open
    """
    state: State = "ok" if limit >= HOST_REQUIREMENTS.open_files else "warning"
    return CheckResult(
        "open files",
        state,
        f"{limit} a process",
        "" if state == "ok" else f"ulimit -n {HOST_REQUIREMENTS.open_files}",
    )


def check_wake_ups(late_ms: float) -> CheckResult:
    """Check how late the operating system wakes a process.

    late_ms: ms: the largest delay of several wake-ups
    """
    if late_ms <= HOST_REQUIREMENTS.wake_up_delay:
        return CheckResult("timer", "ok", f"wakes at most {late_ms:.2f} ms late")
    return CheckResult(
        "timer",
        "warning",
        f"wakes {late_ms:.1f} ms late",
        "End other programs that use the processor: see `top`.",
    )


def report_multicast() -> CheckResult:
    """Return that multicast is not needed: it is never used."""
    return CheckResult(
        "multicast",
        "ok",
        "not needed: hosts are found by their addresses in the swarm file",
    )


def is_wrong(rows: Iterable[CheckResult]) -> bool:
    """Return whether a fault must be repaired before a flight."""
    return any(row.state == "wrong" for row in rows)
