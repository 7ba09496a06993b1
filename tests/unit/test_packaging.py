"""What users install, and what a release holds.

Installed as a wheel and installed editable, the package is `crazychoir` with its missions and nothing
else. The source distribution has all that is in the repository.
"""

import email
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from email.message import Message
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]
GITHUB = "https://github.com/crazychoir/crazychoir"
MADE = {
    *("__pycache__", "build", "dist", "keys", "out"),
    *(".venv", ".venv-lowest", ".git", ".hypothesis"),
}
"""Folders that programs make in a clone; those of caches end in _cache or .egg-info."""
NOT_COPIED = shutil.ignore_patterns(*MADE, "*_cache", "*.egg-info")
LINK = "crazychoir/agents"
EXAMPLES = "crazychoir/examples"
LINKS = {LINK: "../agents", EXAMPLES: "../deploy"}
ADDED = {"PKG-INFO", "setup.cfg"}
"""Files that setuptools adds to a source distribution, beside its egg-info."""
pytestmark = pytest.mark.skipif(
    (REPOSITORY / "PKG-INFO").is_file(),
    reason="a source distribution has a copy of agents/ in the place of the link",
)
PROBE = """
import importlib.resources, importlib.util, json, pkgutil, sys
import crazychoir, crazychoir.agents
data = importlib.resources.files("crazychoir.agents") / "data"
examples = importlib.resources.files("crazychoir") / "examples"
print(json.dumps({
    "where": crazychoir.__file__,
    "missions": sorted(module.name for module in pkgutil.iter_modules(crazychoir.agents.__path__)),
    "data": sorted(file.name for file in data.iterdir()),
    "examples": sorted(file.name for file in examples.iterdir() if file.suffix == ".toml"),
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
    shutil.copytree(repository, folder, symlinks=True, ignore=NOT_COPIED)
    assert (folder / "crazychoir" / "agents").is_symlink()
    (folder / "agents" / "data").mkdir(exist_ok=True)
    (folder / "agents" / "data" / "probe.json").write_text("{}")
    (folder / "agents" / "probe.py").write_text('"""A mission."""\n')
    private = folder / "deploy" / "keys" / "authority"
    private.mkdir(parents=True)
    (private / "key.pem").write_text("private")
    return folder


@pytest.fixture(scope="module")
def release(clone, tmp_path_factory) -> Path:
    """The folder with a source distribution, and the wheel built from it."""
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
    return folder


@pytest.fixture(scope="module")
def wheel(release) -> Path:
    """The wheel of the release."""
    (built,) = release.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def source_files(release) -> set[str]:
    """The files of the source distribution, without its top folder."""
    (archive,) = release.glob("*.tar.gz")
    with tarfile.open(archive) as opened:
        names = [member.name for member in opened.getmembers() if member.isfile()]
    return {name.partition("/")[2] for name in names}


@pytest.fixture(scope="module")
def metadata(wheel) -> Message:
    """What a package index shows."""
    name = f"{wheel.name.rpartition('-py3')[0]}.dist-info/METADATA"
    return email.message_from_string(zipfile.ZipFile(wheel).read(name).decode())


def files_of(clone: Path) -> set[str]:
    """Return the files of a clone that are neither private nor made by programs."""
    found = set()
    for folder, folders, names in os.walk(clone):
        folders[:] = [
            name
            for name in folders
            if name not in MADE and not name.endswith((".egg-info", "_cache"))
        ]
        inside = Path(folder).relative_to(clone)
        found |= {(inside / name).as_posix() for name in names}
    return {name for name in found if not name.startswith(f"{LINK}/")}


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
    assert found["examples"] == sorted(
        path.name for path in (clone / "deploy").glob("*.toml")
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
        "crazychoir/radio/virtual/names.csv",
        "crazychoir/dashboard/static/page.js",
    } <= set(names)
    assert "crazychoir-0.1.0.dist-info/licenses/LICENSE" in names


@pytest.mark.parametrize("link", LINKS)
def test_the_links_to_missions_and_examples_are_relative(repository, link):
    """An absolute link would lead from one clone into another."""
    assert (repository / link).readlink() == Path(LINKS[link])


def test_the_source_distribution_has_all_files_of_the_repository(clone, source_files):
    files = {
        name
        for name in source_files
        if not name.startswith((f"{LINK}/", f"{EXAMPLES}/", "crazychoir.egg-info/"))
    }
    assert files - ADDED == files_of(clone)
    assert {
        "tests/unit/test_packaging.py",
        "tests/data/li_lim_small.txt",
        "agents/pictures/grid.png",
        "deploy/grid30.toml",
        "deploy/zenoh/peer.json5",
        "deploy/systemd/crazychoir-world.service",
        "crazychoir/safety/README.md",
        "CHANGELOG.md",
        "CITATION.cff",
        "CONTRIBUTING.md",
        "LICENSE",
        "Makefile",
        "mkdocs.yml",
        "docs/site_links.py",
    } <= files


def test_the_copy_of_the_missions_in_the_source_distribution_is_complete(
    clone, source_files
):
    names = {name.removeprefix(f"{LINK}/") for name in source_files if LINK in name}
    agents = clone / "agents"
    assert names == {
        path.relative_to(agents).as_posix()
        for path in (*agents.glob("*.py"), *agents.glob("data/*"))
    }


def test_the_source_distribution_has_a_copy_of_the_examples(clone, source_files):
    names = {name for name in source_files if name.startswith(f"{EXAMPLES}/")}
    files = (clone / "deploy").glob("*.toml")
    assert names == {f"{EXAMPLES}/{file.name}" for file in files}


def test_no_private_key_is_released(clone, source_files):
    assert (clone / "deploy" / "keys" / "authority" / "key.pem").is_file()
    assert [name for name in source_files if "keys/" in name or ".pem" in name] == []


def test_a_package_index_shows_the_project(repository, metadata):
    assert metadata["Author"] == "The crazychoir authors"
    assert dict(url.split(", ") for url in metadata.get_all("Project-URL")) == {
        "Homepage": GITHUB,
        "Repository": GITHUB,
        "Documentation": f"{GITHUB}#documentation",
        "Changelog": f"{GITHUB}/blob/main/CHANGELOG.md",
        "Issues": f"{GITHUB}/issues",
    }
    assert {"crazyflie", "swarm", "quadrotor"} <= set(metadata["Keywords"].split(","))
    assert "Typing :: Typed" in metadata.get_all("Classifier")
    assert metadata["License-Expression"] == "GPL-3.0-or-later"
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert metadata.get_payload() == (repository / "README.md").read_text()


def test_the_citation_has_the_version_and_the_authors_of_the_package(
    repository, metadata
):
    citation = (repository / "CITATION.cff").read_text()
    assert f"\nversion: {metadata['Version']}\n" in citation
    assert f"\n  - name: {metadata['Author']}\n" in citation


def test_users_get_extras_and_contributors_get_groups(repository, metadata):
    project = tomllib.loads((repository / "pyproject.toml").read_text())
    extras = {
        *("bench", "dashboard", "foxglove", "gym", "mocap", "mujoco"),
        *("ros2", "tables"),
    }
    assert set(metadata.get_all("Provides-Extra")) == extras
    assert set(project["dependency-groups"]) == {"bench", "docs", "test"}


def test_make_installs_groups_that_exist(repository):
    text = (repository / "Makefile").read_text()
    project = tomllib.loads((repository / "pyproject.toml").read_text())
    named = {
        word.removeprefix("$(VENV)/.installed-")
        for word in text.split()
        if word.startswith("$(VENV)/.installed-") and not word.endswith("%:")
    }
    assert named == set(project["dependency-groups"])
