"""Connections that show the certificate of a host, of programs that are no process of the swarm.

Access control lets nothing of them through that the host may not say, and tells nobody: it is seen here.
"""

from collections import Counter
from collections.abc import Iterable


class Connections:
    """Looks, now and then, at who is connected, and at who has said that it is there."""

    def __init__(self) -> None:
        self._silent: set[str] = set()
        self._told: set[str] = set()

    def look(
        self, connected: Iterable[tuple[str | None, str]], known: Iterable[str]
    ) -> list[str]:
        """Hosts with more programs than processes at two looks in a row, each of them told once.

        connected: the name in the certificate, and who it is to Zenoh, of each link;  known: the host of each process
        whose token is there.
        """
        programs = Counter(
            host for host, _ in dict.fromkeys(connected) if host is not None
        )
        processes = Counter(known)
        silent = {host for host, count in programs.items() if count > processes[host]}
        found = sorted((silent & self._silent) - self._told)
        self._silent = silent
        self._told.update(found)
        return found
