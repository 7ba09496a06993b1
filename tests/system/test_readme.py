"""The pages of the documentation are true: their programs run, and their figures are those of their commands."""

import importlib
import inspect
import pkgutil
import re
import runpy
import shlex
import tomllib

import numpy as np
import pytest
from pages import FRONT_PAGE, block, first_column, page, printed, rows

from crazychoir.guidance.feedback import CFDistributedFeedback
from crazychoir.guidance.guidance import CFGuidance
from crazychoir.guidance.mission import list_mission_names as missions
from crazychoir.guidance.mission_hooks import MISSION_HOOKS
from crazychoir.launch.recording import list_versions
from crazychoir.optimization.problems.problems import CostCoupled

pytestmark = pytest.mark.system
AGENTS = "agents/README.md"
API = "crazychoir/api/README.md"
GUIDANCE = "crazychoir/guidance/README.md"
OPTIMIZATION = "crazychoir/optimization/README.md"
CATALOGUE = "crazychoir/optimization/CATALOGUE.md"
ROUTING = "crazychoir/routing/README.md"
DIGEST_PROCESSOR = "x86_64 rocketlake"
"""The processor on which the digest of the front page was computed."""
FLY = "crazychoir run my_law.py --fast"


@pytest.fixture
def saved(tmp_path):
    """Save a program of a page in an empty folder, as a user would; returns its path."""

    def save(file, mark):
        path = tmp_path / mark
        path.write_text(block(file, mark))
        return path

    return save


@pytest.fixture
def mission_file(saved):
    return saved(FRONT_PAGE, "my_law.py")


@pytest.fixture
def said(here, monkeypatch):
    """What a command prints when it is called in a folder."""

    def say(folder, command, code=0):
        monkeypatch.chdir(folder)
        done = here(*shlex.split(command), "--json")
        assert done.code == code, done.err
        return done.json

    return say


# The front page -----------------------------------------------------------------------


def test_the_law_of_the_front_page_fits_into_25_lines(mission_file):
    assert len(mission_file.read_text().splitlines()) <= 25


def test_the_law_of_the_front_page_flies_by_its_command(said, mission_file):
    assert f"\n{FLY}\n" in page(FRONT_PAGE)
    result = said(mission_file.parent, FLY)
    assert result["success"]
    assert result["drones"] == 4
    assert [own["place"][2] for own in result["results"].values()] == pytest.approx(
        [0.9] * 4, abs=0.01
    )
    assert result["mean_z"] == pytest.approx(0.9, abs=0.01)
    assert result["spread_m"] < 0.01


def test_a_law_that_ends_too_early_is_no_success(said, mission_file):
    """Half way the drones are not yet at one height."""
    mission_file.write_text(
        mission_file.read_text().replace("duration = 10.0", "duration = 1.0")
    )
    result = said(mission_file.parent, FLY, code=1)
    assert not result["success"]
    assert result["spread_m"] > 0.1
    assert all(own["success"] for own in result["results"].values())


def test_more_drones_by_one_option(said, mission_file):
    assert said(mission_file.parent, f"{FLY} --drones 6")["drones"] == 6


def number(text):
    """The number at the start of a figure."""
    return float(text.split()[0])


def counted(text):
    """The figures of a row of several, {name: number}."""
    return {
        name: number(value)
        for name, value in (part.split(":") for part in text.split(", "))
    }


def test_the_front_page_shows_the_formation_that_flies(repository, said):
    """The messages are exact, and so is the digest on the processor of the page: another one rounds differently."""
    command = "crazychoir run bearing_formation --fast --seed 1"
    rows, result = printed(FRONT_PAGE, command), said(repository, command)
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
    if list_versions()["processor"] == DIGEST_PROCESSOR:
        assert rows["digest"] == result["digest"]


@pytest.fixture
def algorithm_file(saved):
    return saved(FRONT_PAGE, "extra.py")


def test_the_algorithm_of_the_front_page_fits_into_20_lines_and_runs_by_its_command(
    algorithm_file, said
):
    assert len(algorithm_file.read_text().splitlines()) <= 20
    command = (
        "crazychoir simulate extra.py --agents 10 --loss 0.3 --picture out/extra.png"
    )
    rows = printed(FRONT_PAGE, command)
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


def test_the_algorithm_of_the_front_page_gives_the_same_without_loss(
    algorithm_file, said
):
    calm, lossy = (
        said(algorithm_file.parent, f"crazychoir simulate extra.py --loss {loss}")
        for loss in (0, 0.3)
    )
    assert calm["agents"] == lossy["agents"]
    assert calm["lost"] == 0 < lossy["lost"]


@pytest.mark.parametrize(
    ("file", "mark", "written"),
    [
        (FRONT_PAGE, "flights.py", ["flight.png", "settling.pdf"]),
        (API, "fly.py", ["flight.mcap", "flight.png"]),
        (API, "sweep.py", ["runs.csv", "runs.jsonl", "settling.pdf"]),
        (API, "compute.py", ["consensus.png"]),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_the_programs_of_the_python_interface_run(
    saved, monkeypatch, file, mark, written
):
    path = saved(file, mark)
    monkeypatch.chdir(path.parent)
    runpy.run_path(str(path))
    files = {file.name for file in path.parent.iterdir()} - {mark}
    assert sorted(files) == written


def test_the_page_of_the_python_interface_names_what_there_is():
    from crazychoir import api
    from crazychoir.api.tracks import TRACK_DTYPE

    fields = [row.split("`")[1] for row in rows(API, "field")]
    assert fields == list(TRACK_DTYPE.names)
    functions = {row.split("`")[1] for row in rows(API, "name")}
    assert functions <= set(api.__all__)
    for kind in (api.Flight, api.Table):
        shown = "".join(rows(API, f"`{kind.__name__}`"))
        public = {name for name in vars(kind) if not name.startswith("_")}
        hidden = {name for name in public if f"`{name}" not in shown}
        assert hidden <= {"data", "figures", "inputs"}


def test_the_front_page_shows_the_contract_of_imports(repository):
    contracts = tomllib.loads((repository / "pyproject.toml").read_text())
    house = next(
        contract
        for contract in contracts["tool"]["importlinter"]["contracts"]
        if contract["id"] == "house"
    )
    shown_layers = re.search(r"```\n(cli .*?)```", page(FRONT_PAGE), re.DOTALL)[1]
    layers = [re.split(r"  +", line)[0] for line in shown_layers.splitlines()]
    assert layers == house["layers"]


# Optimization -------------------------------------------------------------------------


def test_the_averaging_of_the_optimization_page_ends_where_the_page_says(saved, said):
    path = saved(OPTIMIZATION, "average.py")
    command, mean = re.search(
        r"`(crazychoir simulate average\.py .*?)` ends with ([\d.]+) at all",
        page(OPTIMIZATION),
    ).groups()
    result = said(path.parent, command)
    ends = [own["x"] for own in result["agents"].values()]
    assert ends == pytest.approx([float(mean)] * 10, abs=1e-5)


def test_the_averaging_of_the_optimization_page_gives_the_same_at_any_loss(saved, said):
    path = saved(OPTIMIZATION, "average.py")
    calm, lossy = (
        said(path.parent, f"crazychoir simulate average.py --loss {loss}")
        for loss in (0, 0.5)
    )
    assert calm["agents"] == lossy["agents"]
    assert calm["lost"] == 0 < lossy["lost"]


def test_the_program_that_simulates_the_averaging_runs(saved, monkeypatch, capsys):
    monkeypatch.syspath_prepend(saved(OPTIMIZATION, "average.py").parent)
    program = saved(OPTIMIZATION, "average_program.py")
    runpy.run_path(program)
    expected = re.search(r"# (\(.*\))", program.read_text())[1]
    assert capsys.readouterr().out.strip() == expected


def test_a_problem_in_cvxpy_ends_where_the_optimization_page_says(saved, said):
    path = saved(OPTIMIZATION, "meet.py")
    command, place = re.search(
        r"`(crazychoir simulate meet\.py .*?)` ends .*?`([-\d., ]+)`",
        page(OPTIMIZATION),
        re.DOTALL,
    ).groups()
    result = said(path.parent, command)
    expected = np.tile([float(number) for number in place.split(", ")], (10, 1))
    assert [own["x"] for own in result["agents"].values()] == pytest.approx(
        expected, abs=1e-6
    )


def test_an_algorithm_with_local_problems_ends_where_the_optimization_page_says(
    saved, said
):
    path = saved(OPTIMIZATION, "proximal.py")
    assert len(path.read_text().splitlines()) <= 20
    pattern = r"`(crazychoir simulate proximal\.py .*?)` ends after (\d+) rounds.*?`([-\d., ]+)`"
    command, rounds, place = re.search(pattern, page(OPTIMIZATION), re.DOTALL).groups()
    result = said(path.parent, command)
    assert result["rounds"] == int(rounds)
    expected = np.tile([float(number) for number in place.split(", ")], (10, 1))
    assert [own["x"] for own in result["agents"].values()] == pytest.approx(
        expected, abs=1e-6
    )


def test_a_local_problem_has_the_calls_of_the_optimization_page():
    for call in first_column(OPTIMIZATION, "call"):
        name, arguments = re.fullmatch(r"problem\.(\w+)\((.*)\)", call).groups()
        parameters = inspect.signature(getattr(CostCoupled, name)).parameters
        assert arguments == ", ".join(
            shown_parameter(p) for p in list(parameters.values())[1:]
        ), call


def shown_parameter(parameter):
    """Return a parameter as the catalogue shows it: without its type, a function by its name."""
    default = parameter.default
    value = getattr(default, "__name__", repr(default))
    return parameter.name if default is parameter.empty else f"{parameter.name}={value}"


def algorithms():
    """Return all algorithms of the catalogue's rooms by name: classes that do rounds."""
    found = {}
    for room in ("algorithms", "assignment"):
        package = importlib.import_module(f"crazychoir.optimization.{room}")
        for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            module = importlib.import_module(info.name)
            found |= {
                name: one
                for name, one in inspect.getmembers(module, inspect.isclass)
                if one.__module__ == module.__name__
                and not name.startswith("_")
                and all(hasattr(one, part) for part in ("message", "step", "done"))
            }
    return found


def test_the_catalogue_has_all_constructors():
    constructors = block(CATALOGUE, "signatures")
    found = [
        " ".join(call.split())
        for call in re.findall(r"^\w+\(.*?\)$", constructors, re.DOTALL | re.MULTILINE)
    ]
    table_of_all = "\n".join(rows(CATALOGUE, "there"))
    made = algorithms()
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


def test_everything_is_where_the_catalogue_says():
    text = "\n".join(rows(CATALOGUE, "there"))
    found = re.findall(r"((?:`\w+`, )*`\w+`) in `([\w/]+)\.py`", text)
    assert len(found) > 25
    for names, path in found:
        module = importlib.import_module("crazychoir." + path.replace("/", "."))
        for name in re.findall(r"\w+", names):
            assert hasattr(module, name), f"{name} in {path}"


def test_the_optimization_page_and_the_catalogue_name_the_same_algorithms():
    named = {
        name
        for row in rows(OPTIMIZATION, "problem")
        for name in re.findall(r"`(\w+)`", row.split(" | ")[1])
    }
    made = set(re.findall(r"^(\w+)\(", block(CATALOGUE, "signatures"), re.MULTILINE))
    assert named <= made
    assert sorted(set(algorithms()) - named) == []
    assert len(named) > 25


# Routing ------------------------------------------------------------------------------


def test_the_routing_page_shows_the_plan_that_is_solved(repository, said):
    command = "crazychoir solve agents/data/lab6.json --loss 0.5"
    rows, result = printed(ROUTING, command), said(repository, command)
    assert number(rows["cost"]) == pytest.approx(result["cost"], abs=1e-4)
    assert number(rows["lower_bound"]) == pytest.approx(result["lower_bound"], abs=1e-4)
    assert rows["bound_exact"] == str(result["bound_exact"])
    assert number(rows["rounds"]) == result["rounds"]
    assert number(rows["messages"]) == result["messages"]


def test_the_program_of_the_routing_page_prints_what_the_page_says(
    repository, saved, monkeypatch, capsys
):
    program = saved(ROUTING, "solve_lab6.py")
    monkeypatch.chdir(repository)
    runpy.run_path(program)
    expected = re.search(r"print\(.*# (.*)", program.read_text())[1]
    assert capsys.readouterr().out.strip() == expected


# Missions -----------------------------------------------------------------------------


def test_the_tables_of_the_mission_api_name_what_there_is():
    hooks = [text.removesuffix(")").split("(") for text in first_column(AGENTS, "hook")]
    assert {name: tuple(arguments.split(", ")) for name, arguments in hooks} == {
        n: h[0] for n, h in MISSION_HOOKS.items()
    }
    for text in first_column(AGENTS, "in both"):
        name = re.search(r"self\.(\w+)", text)[1]
        assert hasattr(CFGuidance, name) or name == "member", text
        for argument in re.findall(r"(\w+)=", text):
            assert (
                argument in inspect.signature(getattr(CFGuidance, name)).parameters
            ), text
    for text in first_column(AGENTS, "to write"):
        assert hasattr(
            CFDistributedFeedback,
            re.sub(r"^(async )?def ", "", text).split("(")[0].split(" ")[0],
        ), text


def test_the_mission_of_the_agents_page_flies_by_its_command(saved, said):
    path = saved(AGENTS, "average_height.py")
    command = "crazychoir run average_height.py --fast"
    assert f"\n{command}\n" in page(AGENTS)
    result = said(path.parent, command)
    heights = [own["height"] for own in result["results"].values()]
    assert result["success"]
    assert heights == pytest.approx([0.9] * 4, abs=0.02)


def test_the_mission_of_the_guidance_page_reads_its_option(saved, said):
    folder = saved(GUIDANCE, "climb.py").parent
    saved(GUIDANCE, "climb.toml")
    own, given = (
        said(folder, f"crazychoir run {name} --fast")
        for name in ("climb.py", "climb.toml")
    )
    assert "`crazychoir run climb.py --fast`" in page(GUIDANCE)
    assert [r["place"][2] for r in own["results"].values()] == pytest.approx(
        [1.2] * 4, abs=0.01
    )
    assert [r["place"][2] for r in given["results"].values()] == pytest.approx(
        [0.8] * 2, abs=0.01
    )


def test_a_wrong_option_of_the_guidance_page_is_refused(saved, said):
    folder = saved(GUIDANCE, "climb.py").parent
    swarm_file = saved(GUIDANCE, "climb.toml")
    swarm_file.write_text(swarm_file.read_text().replace("0.8", "-0.8"))
    result = said(folder, "crazychoir run climb.toml --fast", code=2)
    assert "above_ground" in result["error"]


def test_the_demo_shows_the_plan_that_is_flown(repository, said):
    """The plan is that of virtual time. The rest of the block is of real time, and only has to fit."""
    rows = printed(AGENTS, "make demo")
    demo = said(repository, "crazychoir run pickup_delivery --fast --loss 0.2 --seed 1")
    assert number(rows["cost"]) == pytest.approx(demo["cost"], abs=1e-4)
    assert rows["plan_digest"] == demo["plan_digest"][:16]
    messages = counted(rows["messages"])
    assert messages["lost"] == pytest.approx(0.2 * messages["sent"], rel=0.1)
    assert counted(rows["planned_m"]) == pytest.approx(demo["planned_m"], abs=2e-3)
    assert counted(rows["flown_m"]) == pytest.approx(demo["flown_m"], rel=0.1)


def test_the_page_of_missions_shows_each_mission_and_each_picture(repository):
    text = page(AGENTS)
    assert [name for name in missions() if f"crazychoir run {name} " not in text] == []
    pictures = set(re.findall(r"\]\(pictures/(.*?)\)", text))
    for other in (repository / "crazychoir").glob("*/README.md"):
        pictures |= set(re.findall(r"agents/pictures/(.*?)\)", other.read_text()))
    assert pictures == {
        path.name for path in (repository / "agents" / "pictures").iterdir()
    }
    swarms = re.findall(r"deploy/\w+\.toml", text)
    assert [path for path in swarms if not (repository / path).is_file()] == []


FLIGHTS = sorted(
    {
        f"{'crazychoir run ' if what.startswith('deploy') else ''}{what}".split(
            " --record"
        )[0]
        for what in re.findall(r"`((?:crazychoir run|deploy/)[^`]*)`", page(AGENTS))
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
