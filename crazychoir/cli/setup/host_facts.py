"""What this machine is like: read from the kernel and the network, for the checks of `crazychoir doctor`."""

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

from crazychoir.cli.setup.host_checks import CRAZYRADIOS, Usb

SYS, DEV, PROC = Path("/sys"), Path("/dev/bus/usb"), Path("/proc")
DEADLINE = 1.0
"""s that another host gets to answer."""
_UNSYNCHRONISED, _ERROR = 0x40, 5
_LISTENS = "0A"


class _Timex(ctypes.Structure):
    """The kernel's struct timex, see adjtimex(2); only its beginning is read."""

    _fields_ = (
        ("modes", ctypes.c_uint),
        ("offset", ctypes.c_long),
        ("freq", ctypes.c_long),
        ("maxerror", ctypes.c_long),
        ("esterror", ctypes.c_long),
        ("status", ctypes.c_int),
        ("rest", ctypes.c_byte * 256),
    )


def needed() -> list[str]:
    """The requirements of this package, as its metadata state them."""
    return requires("crazychoir") or []


def installed(names: Iterable[str]) -> dict[str, str]:
    """The versions of those packages that are there."""
    found = {}
    for name in names:
        with contextlib.suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


def is_own(address: str) -> bool:
    """Whether an interface of this machine has the address."""
    with contextlib.suppress(OSError):
        family, kind, protocol, _, where = socket.getaddrinfo(
            address, 0, type=socket.SOCK_STREAM
        )[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(where)
            return True
    return False


def loopback(name: str) -> str:
    """The address of the loopback that a name of this machine means here, as 127.0.1.1 in /etc/hosts; else empty."""
    with contextlib.suppress(ValueError):
        ipaddress.ip_address(name)
        return ""
    if name == "localhost":
        return ""
    address = str(socket.getaddrinfo(name, 0, type=socket.SOCK_STREAM)[0][4][0])
    return address if ipaddress.ip_address(address).is_loopback else ""


def is_free(address: str, port: int) -> bool:
    """Whether a process could listen there now."""
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


def holder(port: int, proc: Path = PROC) -> str:
    """The command line of who listens on a port, with its process id; empty for another user's."""
    inodes: dict[str, None] = {}
    for table in ("tcp", "tcp6"):
        with contextlib.suppress(OSError):
            for line in (proc / "net" / table).read_text().splitlines()[1:]:
                words = line.split()
                if int(words[1].rsplit(":", 1)[1], 16) == port and words[3] == _LISTENS:
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


def answer(address: str, port: int, deadline: float = DEADLINE) -> str:
    """What another host says to a connection: "connected", "refused" (then it is there, too), or why it does not."""
    try:
        socket.create_connection((address, port), deadline).close()
    except ConnectionRefusedError:
        return "refused"
    except TimeoutError:
        return f"no answer within {deadline:g} s"
    except OSError as error:
        return str(error.strerror or error)
    return "connected"


def handshake(address: str, port: int, keys: Path, deadline: float = DEADLINE) -> str:
    """Why a process there and the keys in this folder, of this host, do not get on; empty if they do.

    In TLS 1.3 who is refused hears it once it reads; who is not hears nothing.
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
        return f"its certificate is not good here: {error.verify_message}"
    except ssl.SSLError as error:
        return f"it does not take the certificate of this host: {str(error.reason).lower().replace('_', ' ')}"
    except OSError as error:
        return str(error.strerror or error)
    return ""


def clock() -> tuple[bool | None, float]:
    """Whether the kernel's clock is synchronised, None where it does not say; and s, how wrong it may be."""
    libc = ctypes.CDLL(None)
    timex = _Timex()
    state = libc.adjtimex(ctypes.byref(timex))
    if state < 0:
        return None, 0.0
    return state != _ERROR and not timex.status & _UNSYNCHRONISED, timex.maxerror / 1e6


def crazyradios(sys: Path = SYS, dev: Path = DEV) -> list[Usb]:
    """Those on the USB, in the order of their places."""
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
            if kind in CRAZYRADIOS:
                found.append(Usb(kind, str(path), os.access(path, os.R_OK | os.W_OK)))
    return found


def governors(sys: Path = SYS) -> dict[str, str]:
    """Of each processor that has one."""
    files = sorted(sys.glob("devices/system/cpu/cpu[0-9]*/cpufreq/scaling_governor"))
    return {file.parent.parent.name: file.read_text().strip() for file in files}


def memory_mb(proc: Path = PROC) -> float:
    """MB that processes may take without swapping."""
    lines = (proc / "meminfo").read_text().splitlines()
    return next(
        int(line.split()[1]) / 1024 for line in lines if line.startswith("MemAvailable")
    )


def disk_mb(folder: Path) -> float:
    """MB that are free there."""
    return shutil.disk_usage(folder).free / 1e6


def files() -> int:
    """Open files that a process may have."""
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


def late_ms(times: int = 50, period: float = 0.01) -> float:
    """ms, the latest of some wake-ups of our clock; period: s."""
    from crazychoir.runtime.clock import Clock, run_wall

    async def main(clock: Clock) -> float:
        worst = 0.0
        for _ in range(times):
            due = clock.now() + period
            await clock.sleep(period)
            worst = max(worst, clock.now() - due)
        return 1000 * worst

    return run_wall(main)
