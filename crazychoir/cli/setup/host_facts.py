"""Facts about this machine, read from the kernel and the network, for `crazychoir doctor`."""

import contextlib
import ctypes
import ipaddress
import os
import resource
import shutil
import socket
import ssl
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path

from crazychoir.cli.setup.host_checks import CRAZYRADIO_IDS, UsbDevice

SYS_FOLDER = Path("/sys")
USB_FOLDER = Path("/dev/bus/usb")
PROC_FOLDER = Path("/proc")
OTHER_HOST_TIMEOUT = 1.0
"""Seconds that another host gets to answer."""
_STA_UNSYNC = 0x40  # STA_UNSYNC, a flag in the status of adjtimex(2)
_TIME_ERROR = 5  # TIME_ERROR, a return value of adjtimex(2)
_TCP_LISTEN = "0A"
"""State of a listening socket in /proc/net/tcp."""


class _Timex(ctypes.Structure):
    """The beginning of the kernel's struct timex, see adjtimex(2)."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_byte * 256),
    )


def required_packages() -> list[str]:
    """Return the requirements of this package, as its metadata state them."""
    return requires("crazychoir") or []


def installed_versions(names: Iterable[str]) -> dict[str, str]:
    """Return the versions of those packages that are installed."""
    found = {}
    for name in names:
        with contextlib.suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def is_own(address: str) -> bool:
    """Return whether an interface of this machine has the address."""
    with contextlib.suppress(OSError):
        family, kind, protocol, _, where = socket.getaddrinfo(
            address, 0, type=socket.SOCK_STREAM
        )[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(where)
            return True
    return False


def loopback_of(name: str) -> str:
    """Return the loopback address that a host name has here, such as 127.0.1.1 in /etc/hosts.

    Empty for an address, for localhost, and for a name with another address.
    """
    with contextlib.suppress(ValueError):
        ipaddress.ip_address(name)
        return ""
    if name == "localhost":
        return ""
    address = str(socket.getaddrinfo(name, 0, type=socket.SOCK_STREAM)[0][4][0])
    return address if ipaddress.ip_address(address).is_loopback else ""


def is_free(address: str, port: int) -> bool:
    """Return whether a process could listen there now."""
    family, kind, protocol, _, where = socket.getaddrinfo(
        address, port, type=socket.SOCK_STREAM
    )[0]
    with socket.socket(family, kind, protocol) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(where)
        except OSError:
            return False
    return True


def port_holder(port: int, proc: Path = PROC_FOLDER) -> str:
    """Return the process id and command line that hold a port.

    Empty for a process of another user.
    """
    inodes: dict[str, None] = {}
    for table in ("tcp", "tcp6"):
        with contextlib.suppress(OSError):
            for line in (proc / "net" / table).read_text().splitlines()[1:]:
                words = line.split()
                if (
                    int(words[1].rsplit(":", 1)[1], 16) == port
                    and words[3] == _TCP_LISTEN
                ):
                    inodes[f"socket:[{words[9]}]"] = None
    for process in proc.glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if any(os.readlink(file) in inodes for file in (process / "fd").iterdir()):
                command = (
                    (process / "cmdline")
                    .read_bytes()
                    .replace(b"\0", b" ")
                    .decode(errors="replace")
                    .strip()
                )
                return f"process {process.name}: {command}"
    return ""


def connect_to_host(
    address: str, port: int, deadline: float = OTHER_HOST_TIMEOUT
) -> str:
    """Try a TCP connection to another host, and return the result.

    Returns "connected", "refused" (the host answers, but no process listens at the port), or the
    reason why the host does not answer.
    deadline: s
    """
    try:
        socket.create_connection((address, port), deadline).close()
    except ConnectionRefusedError:
        return "refused"
    except TimeoutError:
        return f"no answer within {deadline:g} s"
    except OSError as error:
        return str(error.strerror or error)
    return "connected"


def try_handshake(
    address: str, port: int, keys: Path, deadline: float = OTHER_HOST_TIMEOUT
) -> str:
    """Return why a TLS connection to a process fails; empty if it succeeds.

    keys: folder with the keys of this host
    deadline: s
    In TLS 1.3 a client learns that it is refused only when it reads. If it is accepted, the read
    times out.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    try:
        context.load_verify_locations(keys / "authority.pem")
        context.load_cert_chain(keys / "certificate.pem", keys / "key.pem")
        with (
            socket.create_connection((address, port), deadline) as plain,
            context.wrap_socket(plain) as secured,
            contextlib.suppress(TimeoutError),
        ):
            secured.recv(1)
    except ssl.SSLCertVerificationError as error:
        return f"its certificate is not valid here: {error.verify_message}"
    except ssl.SSLError as error:
        return f"it does not accept the certificate of this host: {str(error.reason).lower().replace('_', ' ')}"
    except OSError as error:
        return str(error.strerror or error)
    return ""


def clock_synchronisation() -> tuple[bool | None, float]:
    """Return whether the kernel's clock is synchronised, and its largest error in s.

    The first value is None if the kernel does not say.
    """
    libc = ctypes.CDLL(None)
    timex = _Timex()
    state = libc.adjtimex(ctypes.byref(timex))
    if state < 0:
        return None, 0.0
    return state != _TIME_ERROR and not timex.status & _STA_UNSYNC, timex.maxerror / 1e6


def crazyradios(sys: Path = SYS_FOLDER, dev: Path = USB_FOLDER) -> list[UsbDevice]:
    """Return the Crazyradios on the USB, in the order of their paths."""
    found = []
    for device in sorted((sys / "bus/usb/devices").glob("*")):
        with contextlib.suppress(OSError, ValueError):
            kind = ":".join(
                (device / name).read_text().strip()
                for name in ("idVendor", "idProduct")
            )
            bus, number = (
                int((device / name).read_text()) for name in ("busnum", "devnum")
            )
            path = dev / f"{bus:03}" / f"{number:03}"
            if kind in CRAZYRADIO_IDS:
                found.append(
                    UsbDevice(kind, str(path), os.access(path, os.R_OK | os.W_OK))
                )
    return found


def governors(sys: Path = SYS_FOLDER) -> dict[str, str]:
    """Return the frequency governor of each processor that has one."""
    files = sorted(sys.glob("devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor"))
    return {file.parent.parent.name: file.read_text().strip() for file in files}


def memory_mb(proc: Path = PROC_FOLDER) -> float:
    """Return the MB that processes may take without swapping."""
    lines = (proc / "meminfo").read_text().splitlines()
    return next(
        int(line.split()[1]) / 1024 for line in lines if line.startswith("MemAvailable")
    )


def disk_mb(folder: Path) -> float:
    """Return the MB that are free in the folder."""
    return shutil.disk_usage(folder).free / 1e6


def open_file_limit() -> int:
    """Return how many files a process may have open."""
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


def wake_up_delay_ms(times: int = 50, period: float = 0.01) -> float:
    """Return the largest delay of several wake-ups of the package's clock, in ms.

    times: number of wake-ups
    period: s between two of them
    """
    from crazychoir.runtime.clock import Clock, run_wall

    async def main(clock: Clock) -> float:
        worst = 0.0
        for _ in range(times):
            due = clock.now() + period
            await clock.sleep(period)
            worst = max(worst, clock.now() - due)
        return 1000 * worst

    return run_wall(main)
