"""Print the lowest version of each package that users may have, as constraints for pip.

`make lowest` runs tests with these versions.
"""

import re
import tomllib
from pathlib import Path

PROJECT_FILE = Path(__file__).resolve().parents[1] / "pyproject.toml"
MEASURED_AGAINST = "bench"
"""Extra with the programs that crazychoir is measured against: their versions do not matter."""
LOWER_BOUND = re.compile(r"(?P<name>[\w-]+)>=(?P<version>[\w.]+)(?P<marker>.*)")


def lowest_versions():
    """Return a constraint for each package: `numpy==2.2`.

    Raises ValueError for a requirement that is not just a lower bound.
    """
    project = tomllib.loads(PROJECT_FILE.read_text())["project"]
    required = [*project["dependencies"]]
    for extra, packages in project["optional-dependencies"].items():
        if extra != MEASURED_AGAINST:
            required += packages
    return [constrain(requirement) for requirement in required]


def constrain(requirement):
    found = LOWER_BOUND.fullmatch(requirement)
    if found is None:
        raise ValueError(f"pyproject.toml: {requirement}: allowed: a lower bound")
    return found.expand(r"\g<name>==\g<version>\g<marker>")


if __name__ == "__main__":
    for constraint in lowest_versions():
        print(constraint)  # noqa: T201 - a program that prints
