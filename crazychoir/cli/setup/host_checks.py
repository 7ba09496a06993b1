"""What a host needs to fly drones: each check is given what was read, and says what it found and how to mend it."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "warning", "wrong", "not here"]
PYTHONS = ((3, 11), (3, 14))
"""The first that is allowed, and the first that no longer is."""
BOOTLOADER = "1915:0101"
CRAZYRADIOS = ("1915:7777", BOOTLOADER, "35f0:bad2")
"""USB vendor and product: Crazyradio PA, its bootloader, Crazyradio 2.0."""
UDEV = (
    """echo 'SUBSYSTEM=="usb", ATTRS{idVendor}=="1915|35f0", MODE="0664", GROUP="plugdev"' | """
    "sudo tee /etc/udev/rules.d/99-crazyradio.rules && sudo udevadm control --reload && sudo udevadm trigger; "
    "sudo usermod -aG plugdev $USER, which counts from the next login"
)
PROCESS_MB = 300.0
"""Of memory that an agent takes."""
DISK_MB = 1000.0
"""A recording of a long flight of many drones."""
FILES = 1024
"""Open files and sockets: a process has a link to each other one."""
LATE_MS = 5.0
"""Half a period of the control law at 100 Hz."""
SOON = 30
"""Days before the end of a certificate."""
_OURS = re.compile(
    r"process \d+: (\S+ (-\S+ )*)?(\S*/)?(crazychoir(-\w+)?|crazychoir(\.\w+)+)( |$)"
)
"""The program itself, or what an interpreter runs; not a word of its arguments."""
_REQUIREMENT = re.compile(r"([A-Za-z0-9._-]+)>=([\d.]+)")


@dataclass(frozen=True)
class Row:
    """One thing of a host: how it is, what was found, how to mend it."""

    what: str
    state: State
    found: str
    mend: str = ""


@dataclass(frozen=True)
class Usb:
    """A device on the USB: "1915:7777", its file in /dev, and whether we may write to it."""

    kind: str
    path: str
    writable: bool


def python(version: tuple[int, ...]) -> Row:
    """Version: as sys.version_info."""
    first, last = PYTHONS
    found = ".".join(map(str, version[:3]))
    if first <= version[:2] < last:
        return Row("python", "ok", found)
    return Row(
        "python",
        "wrong",
        found,
        "Make the environment anew: python3.13 -m venv ~/choir/venv",
    )


def packages(needed: Iterable[str], installed: Mapping[str, str]) -> list[Row]:
    """needed: lines of our metadata, as "numpy>=2.4";  installed: their versions; what is missing is not in it."""
    rows = []
    good = []
    for line in needed:
        found = _REQUIREMENT.match(line)
        if found is None or "extra ==" in line:
            continue
        name, least = found.groups()
        there = installed.get(name)
        if there is None or _number(there) < _number(least):
            state = (
                f"{there}, needed {least} or newer" if there else "it is not installed"
            )
            rows.append(
                Row(f"package {name}", "wrong", state, f"pip install '{name}>={least}'")
            )
        else:
            good.append(f"{name} {there}")
    return rows or [Row("packages", "ok", ", ".join(good))]


def _number(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version)[:4])


def own_host(
    hosts: Mapping[str, str],
    own: list[str],
    meant: str | None,
    inward: Mapping[str, str],
) -> Row:
    """hosts: names and addresses;  own: names whose address this machine has;  meant: the name that it should have;
    inward: those that mean the loopback here, and it.
    """
    if not hosts:
        return Row("own host", "ok", "a swarm of this machine alone: no [hosts]")
    names = ", ".join(f"{name} {address}" for name, address in hosts.items())
    if meant is not None and meant not in hosts:
        return Row(
            "own host",
            "wrong",
            f"no host {meant} in [hosts]: {names}",
            f"Add {meant} to [hosts].",
        )
    if meant is not None and meant not in own:
        do = f"Write this machine's address into [hosts] ({meant} = ...): see `ip -brief address`."
        return Row(
            "own host",
            "wrong",
            f"{meant} is {hosts[meant]}: no address of this machine",
            do,
        )
    for name, address in inward.items():
        do = "Write the address that others see into [hosts]: see `ip -brief address`; or mend /etc/hosts."
        found = f"{name} is {hosts[name]}, which is {address} on this machine: others do not reach that"
        return Row("own host", "wrong", found, do)
    if own:
        return Row("own host", "ok", ", ".join(f"{name} {hosts[name]}" for name in own))
    do = "Write this machine's address into [hosts]: see `ip -brief address`."
    return Row("own host", "wrong", f"no address of this machine: {names}", do)


def ports(names: Mapping[int, str], held: Mapping[int, str]) -> list[Row]:
    """names: of the processes that listen on them;  held: those that are taken, by which command line."""
    if not names:
        return [
            Row("ports", "not here", "no process of the swarm listens on this host")
        ]
    others = {port: by for port, by in held.items() if not _OURS.match(by)}
    rows = [
        Row(
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
    return rows or [Row("ports", "ok", said)]


def reachable(host: str, address: str, answer: str, stranger: str = "") -> Row:
    """answer: "connected", "refused", or why nothing came back;  stranger: why a process there does not let us in."""
    what = f"host {host}"
    if stranger:
        do = f"Copy the folders of both hosts again from where the authority is, and start all anew on {host}"
        return Row(what, "wrong", f"{address} answers, and {stranger}", do)
    if answer in ("connected", "refused"):
        return Row(
            what,
            "ok",
            f"{address} answers"
            + (": nothing runs there yet" if answer == "refused" else ""),
        )
    do = f"Is it on, and its firewall open? `ping {address}`; on {host}: sudo ufw allow from THIS_ADDRESS"
    return Row(what, "wrong", f"{address}: {answer}", do)


def keys(host: str, fault: str, do: str, days: float) -> Row:
    """fault: what `checked` holds against its folder, and what to do;  days: until the certificate ends."""
    what = f"keys of {host}"
    if fault:
        return Row(what, "wrong", fault, do)
    if days < SOON:
        do = "crazychoir keys init --folder NEW, and so on, on the machine of the authority"
        return Row(what, "warning", f"good for {days:.0f} days more", do)
    return Row(what, "ok", f"good for {days:.0f} days")


def clock(synchronised: bool | None, worst: float) -> Row:
    """synchronised: by the kernel, None if it does not say;  worst: s, its estimated error."""
    if synchronised is None:
        return Row(
            "clock", "not here", "the kernel does not say whether it is synchronised"
        )
    if synchronised:
        return Row("clock", "ok", f"synchronised within {1000 * worst:.3g} ms")
    do = "sudo timedatectl set-ntp true   (or install chrony)"
    return Row(
        "clock",
        "warning",
        "not synchronised: certificates and recordings are dated by it, no flight is",
        do,
    )


def radios(devices: list[Usb], needed: Iterable[int]) -> list[Row]:
    """devices: Crazyradios on the USB;  needed: numbers of the dongles that the swarm file gives to this host."""
    wanted = list(needed)
    rows = []
    for device in devices:
        if not device.writable:
            rows.append(
                Row(
                    f"radio {device.kind}",
                    "wrong",
                    f"no right to write to {device.path}",
                    UDEV,
                )
            )
        if device.kind == BOOTLOADER:
            do = "Take it out and plug it in again; if it stays so, write its firmware anew."
            rows.append(
                Row(
                    f"radio {device.kind}",
                    "wrong",
                    f"{device.path} is in its bootloader",
                    do,
                )
            )
    last = max(wanted, default=-1)
    ready = sum(device.kind != BOOTLOADER for device in devices)
    if last >= ready:
        do = "Plug it in: `lsusb -d 1915:` shows it."
        rows.append(
            Row(
                "radios",
                "wrong",
                f"{ready} there; the swarm file names dongle {last} here",
                do,
            )
        )
    if not devices and not wanted:
        return [Row("radios", "not here", "none, and none is needed")]
    return rows or [Row("radios", "ok", ", ".join(device.path for device in devices))]


def governor(governors: Mapping[str, str]) -> Row:
    """governors: of each processor, from /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor."""
    slow = [cpu for cpu, name in governors.items() if name != "performance"]
    if not governors:
        return Row(
            "cpu governor", "not here", "this machine does not let its kernel choose"
        )
    if not slow:
        return Row("cpu governor", "ok", "performance")
    do = "sudo cpupower frequency-set -g performance"
    return Row(
        "cpu governor",
        "warning",
        f"{governors[slow[0]]} on {', '.join(slow)}: late wake-ups",
        do,
    )


def memory(free_mb: float, processes: int) -> Row:
    """free_mb: MB;  processes: of the swarm on this host."""
    needed = PROCESS_MB * processes
    if free_mb >= needed:
        return Row("memory", "ok", f"{free_mb:.0f} MB free for {processes} process(es)")
    do = "Let drones share processes: crazychoir run --processes, or `processes` in the swarm file."
    return Row(
        "memory",
        "warning",
        f"{free_mb:.0f} MB free; {processes} process(es) take {needed:.0f} MB",
        do,
    )


def disk(free_mb: float, folder: str) -> Row:
    """free_mb: MB where recordings go."""
    state: State = "ok" if free_mb >= DISK_MB else "warning"
    return Row(
        "disk",
        state,
        f"{free_mb:.0f} MB free in {folder}",
        "" if state == "ok" else "Remove old recordings.",
    )


def files(limit: int) -> Row:
    """limit: of open files, of a process."""
    state: State = "ok" if limit >= FILES else "warning"
    return Row(
        "open files",
        state,
        f"{limit} a process",
        "" if state == "ok" else f"ulimit -n {FILES}",
    )


def timer(late_ms: float) -> Row:
    """late_ms: ms, the latest of some wake-ups."""
    if late_ms <= LATE_MS:
        return Row("timer", "ok", f"wakes at most {late_ms:.2f} ms late")
    return Row(
        "timer",
        "warning",
        f"wakes {late_ms:.1f} ms late",
        "End what else computes here: see `top`.",
    )


def multicast() -> Row:
    """It is never used."""
    return Row(
        "multicast",
        "ok",
        "not needed: hosts are found by their addresses in the swarm file",
    )


def is_wrong(rows: Iterable[Row]) -> bool:
    """Whether something must be mended before a flight."""
    return any(row.state == "wrong" for row in rows)
