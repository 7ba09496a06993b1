"""The checks of `crazychoir doctor` of the motion capture system of a swarm."""

from typing import TYPE_CHECKING

from crazychoir.cli.setup.host_checks import CheckResult
from crazychoir.mocap.system import LIBRARY_ADVICE, MOCAP_LIBRARY, SYSTEM_PROGRAMS

if TYPE_CHECKING:
    from crazychoir.config.tables import MocapTable

SOURCES_WITHOUT_LIBRARY = ("virtual", "replay")
"""Sources of [mocap] that this package reads by itself."""
CAMERAS_NAME = "cameras"
"""Name of the checked thing."""
FRAMES_ADVICE = "`crazychoir-mocap` shows whether frames arrive"
"""What shows more than this check."""


def report_no_cameras(why: str) -> CheckResult:
    """Return that there is nothing to check on this host, and why."""
    return CheckResult(CAMERAS_NAME, "not here", why)


def describe_other_source(mocap: "MocapTable") -> CheckResult:
    """Return what a source is that this package reads by itself."""
    if mocap.source == "replay":
        return CheckResult(CAMERAS_NAME, "ok", f"poses of the recording {mocap.file}")
    place = f"{mocap.hostname}:{mocap.port}"
    found = f"virtual drones at {place}: not asked; {FRAMES_ADVICE}"
    return CheckResult(CAMERAS_NAME, "not here", found)


def check_library(source: str, is_there: bool) -> CheckResult:
    """Check that the library that reads a camera system is installed."""
    what = f"package {MOCAP_LIBRARY}"
    if is_there:
        return CheckResult(what, "ok", f"installed, reads {source}")
    found = f"it is not installed, and source = {source} needs it"
    return CheckResult(what, "wrong", found, LIBRARY_ADVICE)


def check_system(
    source: str, hostname: str, port: int | None, answer: str
) -> CheckResult:
    """Check that the program of a camera system answers.

    source: name of the system
    hostname: its address
    port: its TCP port; None if it has none, so that it is not checked
    answer: "connected", "refused", or the reason for no answer
    """
    where = f"{source} at {hostname}"
    if port is None:
        found = f"{where}: not checked, because it has no TCP port; {FRAMES_ADVICE}"
        return CheckResult(CAMERAS_NAME, "warning", found)
    if answer == "connected":
        found = f"{where} answers at port {port}; {FRAMES_ADVICE}"
        return CheckResult(CAMERAS_NAME, "ok", found)
    if answer == "refused":
        found = f"{where}: the host is there, but nothing listens at port {port}"
        do = f"Is {SYSTEM_PROGRAMS[source]} running there?"
        return CheckResult(CAMERAS_NAME, "wrong", found, do)
    do = f"Is it on, on this network, and its firewall open? `ping {hostname}`; else correct hostname in [mocap]"
    return CheckResult(CAMERAS_NAME, "wrong", f"{where}, port {port}: {answer}", do)
