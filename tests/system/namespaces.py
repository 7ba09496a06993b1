"""Two hosts on this machine, with clocks that may differ: network namespaces, which need root and iproute2."""

import contextlib
import secrets
from collections.abc import Iterator

from crazychoir.launch.namespaces import (
    NAMESPACE_DEVICE,
    connect_devices,
    make_namespace,
    run_iproute,
)

ADDRESSES = ("10.77.0.1", "10.77.0.2")


class Hosts:
    """Two namespaces; what runs in one sees the other through `NAMESPACE_DEVICE`, and nothing else.

    names: of the namespaces;  skew: s that the second one's monotonic clock is ahead.
    """

    def __init__(self, skew: float = 0.0) -> None:
        token = secrets.token_hex(4)
        self.names = (f"cc-{token}-a", f"cc-{token}-b")
        self.skew = skew

    def command(self, host: int) -> list[str]:
        """What a command line begins with to run there."""
        inside = ["ip", "netns", "exec", self.names[host]]
        skewed = [
            "unshare",
            "--time",
            "--monotonic",
            f"{self.skew:.0f}",
            "--fork",
            "--kill-child",
        ]
        return inside + (skewed if host and self.skew else [])

    def cut(self) -> None:
        """Let no packet cross from now on; both ends see their link go down."""
        run_iproute("-n", self.names[0], "link", "set", NAMESPACE_DEVICE, "down")

    def mend(self) -> None:
        """Bring the link back."""
        run_iproute("-n", self.names[0], "link", "set", NAMESPACE_DEVICE, "up")


@contextlib.contextmanager
def two_hosts(skew: float = 0.0) -> Iterator[Hosts]:
    """Made here, and gone afterwards; their names are their own, so that two runs side by side never meet."""
    hosts = Hosts(skew)
    with contextlib.ExitStack() as stack:
        for name in hosts.names:
            stack.enter_context(make_namespace(name))
        one, other = hosts.names
        connect_devices((one, NAMESPACE_DEVICE), (other, NAMESPACE_DEVICE))
        for name, address in zip(hosts.names, ADDRESSES, strict=True):
            run_iproute(
                "-n", name, "address", "add", f"{address}/24", "dev", NAMESPACE_DEVICE
            )
        yield hosts
