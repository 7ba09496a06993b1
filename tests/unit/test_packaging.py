"""Installed as a wheel and installed editable, the package is `crazychoir` with its missions and nothing else."""

import json
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

NOT_IN_THE_HOUSE = shutil.ignore_patterns(
    ".*", "__pycache__", "*.egg-info", "build", "dist", "out"
)
PROBE = """
import importlib.resources, importlib.util, json, pkgutil, sys
import crazychoir, crazychoir.agents
data = importlib.resources.files("crazychoir.agents") / "data"
print(json.dumps({
    "where": crazychoir.__file__,
    "missions": sorted(module.name for module in pkgutil.iter_modules(crazychoir.agents.__path__)),
    "data": sorted(file.name for file in data.iterdir()),
    "top": [name for name in ("agents", "tests", "deploy") if importlib.util.find_spec(name)],
}))
"""


def run(*command: str | Path, cwd: Path) -> str:
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, capture_output=True, text=True
    )
    assert done.returncode == 0, f"{command}\n{done.stdout}{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def clone(repository, tmp_path_factory) -> Path:
    """A copy of the sources, link and all, with one more mission and one more data file."""
    folder = tmp_path_factory.mktemp("clone") / "crazychoir"
    shutil.copytree(repository, folder, symlinks=True, ignore=NOT_IN_THE_HOUSE)
    assert (folder / "crazychoir" / "agents").is_symlink()
    (folder / "agents" / "data").mkdir(exist_ok=True)
    (folder / "agents" / "data" / "probe.json").write_text("{}")
    (folder / "agents" / "probe.py").write_text('"""A mission."""\n')
    return folder


@pytest.fixture(scope="module")
def wheel(clone, tmp_path_factory) -> Path:
    """The wheel built from the source distribution, as for a release."""
    folder = tmp_path_factory.mktemp("dist")
    run(
        sys.executable,
        "-m",
        "build",
        "--no-isolation",
        "--outdir",
        folder,
        ".",
        cwd=clone,
    )
    (built,) = folder.glob("*.whl")
    return built


def environment(folder: Path) -> Path:
    """The interpreter of a new environment that sees the packages of this one, but not its crazychoir."""
    venv.create(folder, with_pip=False)
    (site,) = folder.glob("lib/python*/site-packages")
    (site / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder / "bin" / "python"


def install(target: Path, *what: str | Path) -> None:
    pip = (
        sys.executable,
        "-m",
        "pip",
        "--python",
        target,
        "install",
        "--quiet",
        "--ignore-installed",
    )
    run(
        *pip,
        "--no-index",
        "--no-deps",
        "--no-build-isolation",
        *what,
        cwd=target.parent,
    )


def probe(target: Path) -> dict[str, object]:
    answer: dict[str, object] = json.loads(
        run(target, "-I", "-c", PROBE, cwd=target.parent)
    )
    return answer


def check(found: dict[str, object], clone: Path) -> None:
    missions = sorted(
        path.stem for path in (clone / "agents").glob("*.py") if path.stem != "__init__"
    )
    assert "probe" in missions
    assert found["missions"] == missions
    assert found["data"] == sorted(
        path.name for path in (clone / "agents" / "data").iterdir()
    )
    assert found["top"] == []


def test_a_wheel_brings_the_missions_and_their_data(clone, wheel, tmp_path):
    target = environment(tmp_path / "env")
    install(target, wheel)
    found = probe(target)
    assert Path(str(found["where"])).is_relative_to(tmp_path / "env")
    check(found, clone)


def test_an_editable_install_brings_the_missions_and_their_data(clone, tmp_path):
    target = environment(tmp_path / "env")
    install(target, "--editable", clone)
    found = probe(target)
    assert Path(str(found["where"])) == clone / "crazychoir" / "__init__.py"
    check(found, clone)


def test_a_wheel_has_one_package_its_types_and_its_licence(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names} == {
        "crazychoir",
        "crazychoir-0.1.0.dist-info",
    }
    assert {
        "crazychoir/py.typed",
        "crazychoir/radio/virtual/names.txt",
        "crazychoir/dashboard/static/page.js",
    } <= set(names)
    assert "crazychoir-0.1.0.dist-info/licenses/LICENSE" in names


def test_the_link_to_the_missions_is_relative(repository):
    """An absolute link would lead from one clone into another."""
    assert (repository / "crazychoir" / "agents").readlink() == Path("../agents")
