"""What the README shows is so: its mission, saved as it stands there, flies; its figures are those of its commands."""

import importlib
import inspect
import re
import shlex
from pathlib import Path

import msgspec
import numpy as np
import pytest

from crazychoir.config.tables import CollisionTable
from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.mission import list_mission_names as missions
from crazychoir.guidance.mission_hooks import MISSION_HOOKS
from crazychoir.optimization.problems.problems import CostCoupled

pytestmark = pytest.mark.system
MARK = r"<!-- my_law\.py -->\n```python\n(.*?)```"
FLY = "crazychoir run my_law.py --fast"


@pytest.fixture
def mission_file(repository, tmp_path):
    text = re.search(MARK, (repository / "README.md").read_text(), re.DOTALL)
    assert text is not None, "README.md shows no my_law.py"
    path = tmp_path / "my_law.py"
    path.write_text(text[1])
    return path


@pytest.fixture
def said(here, monkeypatch):
    """What a command says now, called in a folder."""

    def say(folder, command, code=0):
        monkeypatch.chdir(folder)
        done = here(*shlex.split(command), "--json")
        assert done.code == code, done.err
        return done.json

    return say


def test_it_fits_into_25_lines(mission_file):
    assert len(mission_file.read_text().splitlines()) <= 25


def test_it_flies_by_the_command_of_the_readme(repository, said, mission_file):
    assert f"\n{FLY}\n" in (repository / "README.md").read_text()
    result = said(mission_file.parent, FLY)
    assert result["success"]
    assert result["drones"] == 4
    assert [own["place"][2] for own in result["results"].values()] == pytest.approx(
        [0.9] * 4, abs=0.01
    )
    assert result["mean_z"] == pytest.approx(0.9, abs=0.01)
    assert result["spread_m"] < 0.01


def test_its_success_says_that_they_met(said, mission_file):
    """Too short a law is no success: half way they are not yet at one height."""
    mission_file.write_text(
        mission_file.read_text().replace("duration = 10.0", "duration = 1.0")
    )
    result = said(mission_file.parent, FLY, code=1)
    assert not result["success"]
    assert result["spread_m"] > 0.1
    assert all(own["success"] for own in result["results"].values())


def table(repository, first):
    """The first column of the README's table whose head begins with `first`."""
    rows = (
        (repository / "README.md")
        .read_text()
        .split(f"\n| {first} |")[1]
        .split("\n\n")[0]
        .splitlines()[2:]
    )
    return re.findall(r"`([^`]+)`", " ".join(row.split(" | ")[0] for row in rows))


def test_its_tables_name_what_there_is(repository):
    hooks = [text.removesuffix(")").split("(") for text in table(repository, "hook")]
    assert {name: tuple(arguments.split(", ")) for name, arguments in hooks} == {
        n: h[0] for n, h in MISSION_HOOKS.items()
    }
    for text in table(repository, "in both"):
        name = re.search(r"self\.(\w+)", text)[1]
        assert hasattr(CFGuidance, name) or name == "member", text
        for argument in re.findall(r"(\w+)=", text):
            assert (
                argument in inspect.signature(getattr(CFGuidance, name)).parameters
            ), text
    for text in table(repository, "to write"):
        assert hasattr(
            CFDistributedFeedback,
            re.sub(r"^(async )?def ", "", text).split("(")[0].split(" ")[0],
        ), text


def test_more_drones_by_one_option(said, mission_file):
    assert said(mission_file.parent, f"{FLY} --drones 6")["drones"] == 6


def shown(repository, command):
    """The rows that the README shows below a command, {figure: text}."""
    text = (repository / "README.md").read_text()
    block = re.search(rf"\n\$ {re.escape(command)}\n(.*?)\n```", text, re.DOTALL)
    assert block is not None, f"README.md shows no {command}"
    return dict(
        line.split(None, 1)
        for line in block[1].splitlines()
        if not line.endswith(": success")
    )


def number(text):
    """The number at the start of a figure."""
    return float(text.split()[0])


def counted(text):
    """The figures of a row of several, {name: number}."""
    return {
        name: number(value)
        for name, value in (part.split(":") for part in text.split(", "))
    }


def test_the_tour_shows_the_formation_that_flies(repository, said):
    """Roughly, but for the messages, and not its digest: another processor rounds otherwise."""
    command = "crazychoir run bearing_formation --fast --seed 1"
    rows, result = shown(repository, command), said(repository, command)
    assert number(rows["drones"]) == result["drones"]
    assert number(rows["simulated_s"]) == pytest.approx(result["simulated_s"], abs=0.5)
    assert number(rows["settling_s"]) == pytest.approx(result["settling_s"], abs=0.5)
    assert number(rows["formation_error_m"]) == pytest.approx(
        result["formation_error_m"], abs=0.002
    )
    assert number(rows["min_separation_m"]) == pytest.approx(
        result["min_separation_m"], abs=0.01
    )
    assert counted(rows["messages"]) == result["messages"]
    assert re.fullmatch("[0-9a-f]{32}", rows["digest"])


def test_the_tour_shows_the_plan_that_is_solved(repository, said):
    command = "crazychoir solve agents/data/lab6.json --loss 0.5"
    rows, result = shown(repository, command), said(repository, command)
    assert number(rows["cost"]) == pytest.approx(result["cost"], abs=1e-4)
    assert number(rows["lower_bound"]) == pytest.approx(result["lower_bound"], abs=1e-4)
    assert rows["bound_exact"] == str(result["bound_exact"])
    assert number(rows["rounds"]) == result["rounds"]
    assert number(rows["messages"]) == result["messages"]


@pytest.fixture
def algorithm_file(repository, tmp_path):
    text = re.search(
        r"<!-- extra\.py -->\n```python\n(.*?)```",
        (repository / "README.md").read_text(),
        re.DOTALL,
    )
    assert text is not None, "README.md shows no extra.py"
    path = tmp_path / "extra.py"
    path.write_text(text[1])
    return path


def test_a_new_algorithm_fits_into_20_lines_and_runs_by_the_command_of_the_readme(
    repository, algorithm_file, said
):
    assert len(algorithm_file.read_text().splitlines()) <= 20
    command = (
        "crazychoir simulate extra.py --agents 10 --loss 0.3 --picture out/extra.png"
    )
    rows = shown(repository, command)
    result = said(algorithm_file.parent, command)
    assert number(rows["rounds"]) == result["rounds"] == 300
    assert float(rows["disagreement"].removeprefix("x: ")) == pytest.approx(
        result["disagreement"]["x"], rel=0.05
    )
    assert number(rows["messages"]) == result["messages"]
    assert number(rows["lost"]) == result["lost"]
    assert result["lost"] == pytest.approx(0.3 * result["messages"], rel=0.05)
    points = np.arange(10)
    fit = np.linalg.lstsq(
        np.stack([np.ones(10), 0.1 * points], axis=1), 2.0 + np.sin(points), rcond=None
    )[0]
    assert [own["x"] for own in result["agents"].values()] == pytest.approx(
        np.tile(fit, (10, 1)), abs=2e-5
    )
    assert (algorithm_file.parent / "out/extra.png").read_bytes()[:4] == b"\x89PNG"


def test_a_new_algorithm_gives_the_same_without_loss(algorithm_file, said):
    calm, lossy = (
        said(algorithm_file.parent, f"crazychoir simulate extra.py --loss {loss}")
        for loss in (0, 0.3)
    )
    assert calm["agents"] == lossy["agents"]
    assert calm["lost"] == 0 < lossy["lost"]


def test_a_problem_in_cvxpy_ends_where_the_readme_says(repository, tmp_path, said):
    text = (repository / "README.md").read_text()
    shown_file = re.search(r"<!-- meet\.py -->\n```python\n(.*?)```", text, re.DOTALL)
    (tmp_path / "meet.py").write_text(shown_file[1])
    command, place = re.search(
        r"`(crazychoir simulate meet\.py .*?)` ends .*?`([-\d., ]+)`", text, re.DOTALL
    ).groups()
    result = said(tmp_path, command)
    expected = np.tile([float(number) for number in place.split(", ")], (10, 1))
    assert [own["x"] for own in result["agents"].values()] == pytest.approx(
        expected, abs=1e-6
    )


def test_an_algorithm_of_ones_own_solves_local_problems_and_ends_where_the_readme_says(
    repository, tmp_path, said
):
    text = (repository / "README.md").read_text()
    shown_file = re.search(
        r"<!-- proximal\.py -->\n```python\n(.*?)```", text, re.DOTALL
    )[1]
    assert len(shown_file.splitlines()) <= 20
    (tmp_path / "proximal.py").write_text(shown_file)
    pattern = r"`(crazychoir simulate proximal\.py .*?)` ends after (\d+) rounds.*?`([-\d., ]+)`"
    command, rounds, place = re.search(pattern, text, re.DOTALL).groups()
    result = said(tmp_path, command)
    assert result["rounds"] == int(rounds)
    expected = np.tile([float(number) for number in place.split(", ")], (10, 1))
    assert [own["x"] for own in result["agents"].values()] == pytest.approx(
        expected, abs=1e-6
    )


def test_a_local_problem_is_asked_as_the_readme_says(repository):
    for call in table(repository, "call"):
        name, arguments = re.fullmatch(r"problem\.(\w+)\((.*)\)", call).groups()
        parameters = inspect.signature(getattr(CostCoupled, name)).parameters
        assert arguments == ", ".join(
            shown_parameter(p) for p in list(parameters.values())[1:]
        ), call


def shown_parameter(parameter):
    """As the README shows it: without its type, a function by its name."""
    default = parameter.default
    value = getattr(default, "__name__", repr(default))
    return parameter.name if default is parameter.empty else f"{parameter.name}={value}"


def test_all_are_made_as_the_readme_says(repository):
    text = (repository / "README.md").read_text()
    block = re.search(r"<!-- signatures -->\n```python\n(.*?)```", text, re.DOTALL)[1]
    found = [
        " ".join(call.split())
        for call in re.findall(r"^\w+\(.*?\)$", block, re.DOTALL | re.MULTILINE)
    ]
    table_of_all = text.split("\n| there | here |")[1].split("\n\n")[0]
    made = {}
    for path in re.findall(r"in `(optimization/[\w/]+)\.py`", table_of_all):
        module = importlib.import_module("crazychoir." + path.replace("/", "."))
        named = (
            getattr(module, name, None) for name in re.findall(r"`(\w+)", table_of_all)
        )
        made |= {
            one.__name__: one
            for one in named
            if inspect.isclass(one) and one.__module__ == module.__name__
        }
    signatures = {
        name: inspect.signature(one).parameters.values() for name, one in made.items()
    }
    expected = [
        f"{name}({', '.join(map(shown_parameter, those))})"
        for name, those in signatures.items()
    ]
    assert len(expected) > 35
    assert sorted(found) == sorted(expected)


def test_what_is_there_already_is_where_the_readme_says(repository):
    text = (
        (repository / "README.md")
        .read_text()
        .split("\n| there | here |")[1]
        .split("\n\n")[0]
    )
    found = re.findall(r"((?:`\w+`, )*`\w+`) in `([\w/]+)\.py`", text)
    assert len(found) > 25
    for names, path in found:
        module = importlib.import_module("crazychoir." + path.replace("/", "."))
        for name in re.findall(r"\w+", names):
            assert hasattr(module, name), f"{name} in {path}"


def test_the_demo_shows_the_plan_that_is_flown(repository, said):
    """The plan is that of virtual time; the rest of the block is of real time and only has to fit."""
    rows = shown(repository, "make demo")
    demo = said(repository, "crazychoir run pickup_delivery --fast --loss 0.2 --seed 1")
    assert number(rows["cost"]) == pytest.approx(demo["cost"], abs=1e-4)
    assert rows["plan_digest"] == demo["plan_digest"][:16]
    messages = counted(rows["messages"])
    assert messages["lost"] == pytest.approx(0.2 * messages["sent"], rel=0.1)
    assert counted(rows["planned_m"]) == pytest.approx(demo["planned_m"], abs=2e-3)
    assert counted(rows["flown_m"]) == pytest.approx(demo["flown_m"], rel=0.1)


def test_the_page_of_missions_shows_each_with_a_picture_that_there_is(repository):
    page = (repository / "agents" / "README.md").read_text()
    assert [name for name in missions() if f"crazychoir run {name} " not in page] == []
    pictures = set(re.findall(r"\]\(pictures/(.*?)\)", page))
    assert pictures == {
        path.name for path in (repository / "agents" / "pictures").iterdir()
    }
    swarms = re.findall(r"deploy/\w+\.toml", page)
    assert [path for path in swarms if not (repository / path).is_file()] == []


PAGE = Path(__file__).parents[2] / "agents" / "README.md"
FLIGHTS = sorted(
    {
        f"{'crazychoir run ' if what.startswith('deploy') else ''}{what}".split(
            " --record"
        )[0]
        for what in re.findall(r"`((?:crazychoir run|deploy/)[^`]*)`", PAGE.read_text())
    }
)


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("command", FLIGHTS)
def test_each_mission_of_the_page_reaches_its_goal_by_its_command(
    repository, said, command
):
    fast = "" if "--fast" in command else " --fast"
    assert said(repository, command + fast)["success"]


def test_the_page_of_swarm_files_names_all_keys_of_the_collision_filter_and_its_defaults(
    repository,
):
    row = re.search(
        r"\| `\[collision\]` .*", (repository / "deploy" / "README.md").read_text()
    ).group()
    defaults = msgspec.to_builtins(CollisionTable())
    assert f'`method` `"{defaults.pop("method")}"`' in row
    assert f"`semi_axes` {list(defaults.pop('semi_axes'))} m" in row
    for key, value in defaults.items():
        assert f"`{key}` {value:g}" in row
