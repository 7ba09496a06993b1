"""`crazychoir compile` compiles every law of the package."""

import json
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from crazychoir.cli.main import app
from crazychoir.cli.setup.compile_laws import find_law_modules, import_with_extras

COUNT_MISSING = """
from crazychoir.cli.setup.compile_laws import find_law_modules, import_with_extras
from crazychoir.numerics.compiling import KERNEL_QUEUE
with KERNEL_QUEUE.checks_first():
    for module in find_law_modules():
        import_with_extras(module)
KERNEL_QUEUE.load_kept()
print(KERNEL_QUEUE.count_waiting())
"""


def test_afterwards_every_law_is_kept():
    said = CliRunner().invoke(app, ["compile", "--json"])
    assert said.exit_code == 0, said.output
    assert set(json.loads(said.stdout)) == {"laws", "compiled", "seconds"}
    done = subprocess.run(
        [sys.executable, "-c", COUNT_MISSING],
        check=True,
        capture_output=True,
    )
    assert int(done.stdout) == 0


def test_the_number_of_laws_is_told():
    said = CliRunner().invoke(app, ["compile"])
    assert said.exit_code == 0, said.output
    assert "laws are ready, 0 of them compiled now" in said.stdout


def test_modules_with_laws_are_found_in_all_rooms():
    found = set(find_law_modules())
    assert {"crazychoir.control.trim", "crazychoir.simulation.onboard.planner"} <= found
    assert "crazychoir.numerics.kernels" not in found


def test_laws_that_need_a_missing_extra_are_left_out(monkeypatch):
    package = "crazychoir.simulation.mujoco"
    for name in [name for name in sys.modules if name.startswith(package)]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "mujoco", None)  # as if it was not installed
    import_with_extras(f"{package}.wrench")
    assert f"{package}.wrench" not in sys.modules
    with pytest.raises(ModuleNotFoundError):
        import_with_extras("crazychoir.nowhere")
