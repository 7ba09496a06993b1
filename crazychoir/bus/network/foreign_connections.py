"""Finds programs that connect with the certificate of a host but are no process of the swarm.

Access control passes only messages that the host may send, and reports nothing: this module reports
such programs.
"""

from collections import Counter
from collections.abc import Iterable


class ForeignConnections:
    """Compares, now and then, the connections with the processes that have a token."""

    def __init__(self) -> None:
        self._silent: set[str] = set()
        self._told: set[str] = set()

    def look(
        self, connected: Iterable[tuple[str | None, str]], known: Iterable[str]
    ) -> list[str]:
        """Return the hosts with more programs than processes at
        two checks in a row, each host once.

        connected: for each link, the name in the certificate and Zenoh's id of the program
        known: for each process with a token, its host
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
