"""The mission that the README shows is whole: saved as it stands there, it flies."""

import json
import re
import subprocess
import sys

import pytest

pytestmark = pytest.mark.system
MARK = r"<!-- my_law\.py -->\n```python\n(.*?)```"


@pytest.fixture
def mission_file(repository, tmp_path):
    text = re.search(MARK, (repository / "README.md").read_text(), re.DOTALL)
    assert text is not None, "README.md shows no my_law.py"
    path = tmp_path / "my_law.py"
    path.write_text(text[1])
    return path


def flown(path, *options):
    command = [sys.executable, "-m", "crazychoir.cli.crazychoir", "run", path.name, "--fast", "--json", *options]
    run = subprocess.run(command, cwd=path.parent, capture_output=True, text=True, check=False, timeout=100)
    assert run.returncode == 0, run.stderr
    return json.loads(run.stdout)


def test_it_fits_into_25_lines(mission_file):
    assert len(mission_file.read_text().splitlines()) <= 25


def test_it_flies_by_the_command_of_the_readme(mission_file):
    result = flown(mission_file)
    assert result["success"]
    assert result["drones"] == 4


def test_more_drones_by_one_option(mission_file):
    assert flown(mission_file, "--drones", "6")["drones"] == 6
