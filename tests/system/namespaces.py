"""Two hosts on this machine: network namespaces joined by a veth pair; needs root and iproute2."""

import contextlib
import secrets
import subprocess
from collections.abc import Iterator

ADDRESSES = ("10.77.0.1", "10.77.0.2")
DEVICE = "veth0"


class Hosts:
    """Two namespaces; what runs in one sees the other through `DEVICE`, and nothing else.

    names: of the namespaces;  skew: s that the second one's monotonic clock is ahead.
    """

    def __init__(self, skew: float = 0.0) -> None:
        token = secrets.token_hex(4)
        self.names = (f"cc-{token}-a", f"cc-{token}-b")
        self.skew = skew

    def command(self, host: int) -> list[str]:
        """What a command line begins with to run there."""
        inside = ["ip", "netns", "exec", self.names[host]]
        skewed = ["unshare", "--time", "--monotonic", f"{self.skew:.0f}", "--fork", "--kill-child"]
        return inside + (skewed if host and self.skew else [])

    def cut(self) -> None:
        """From now on no packet crosses; both ends see their link go down."""
        ip("-n", self.names[0], "link", "set", DEVICE, "down")

    def mend(self) -> None:
        """The link is back."""
        ip("-n", self.names[0], "link", "set", DEVICE, "up")


@contextlib.contextmanager
def two_hosts(skew: float = 0.0) -> Iterator[Hosts]:
    """Made here, and gone afterwards; their names are their own, so that two runs side by side never meet."""
    hosts = Hosts(skew)
    with contextlib.ExitStack() as stack:
        for name in hosts.names:
            ip("netns", "add", name)
            stack.callback(ip, "netns", "delete", name)
        one, other = hosts.names
        ip("link", "add", DEVICE, "netns", one, "type", "veth", "peer", "name", DEVICE, "netns", other)
        for name, address in zip(hosts.names, ADDRESSES, strict=True):
            ip("-n", name, "address", "add", f"{address}/24", "dev", DEVICE)
            for device in ("lo", DEVICE):
                ip("-n", name, "link", "set", device, "up")
        yield hosts


def ip(*arguments: str) -> None:
    """Raises RuntimeError with what iproute2 says: without namespaces these tests fail, they are not skipped."""
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"ip {' '.join(arguments)}: {done.stderr.strip()} (root and iproute2 are needed)")
