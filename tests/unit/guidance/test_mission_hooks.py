"""A mission file's hooks: what cannot be called is refused at once; an error of one names file, line and hook."""

from textwrap import dedent

import pytest

from crazychoir.config.swarm_config import default_swarm
from crazychoir.errors import ConfigError, Refused
from crazychoir.guidance.mission import has_hook, load_mission
from crazychoir.launch.flight import NO_DRONE_MOVED, fly_fast

LAW = """
    import numpy as np
    from crazychoir import Acceleration, CFDistributedFeedback, CFGuidance

    class Law(CFDistributedFeedback):
        duration = 0.5

        def step(self, me, heard):
            return Acceleration(-2.0 * me.v)

    def guidance(i, config):
        return Law()
"""
SWARM = default_swarm(2)


@pytest.fixture
def mission(tmp_path):
    """Writes a mission file and loads it; `more` comes after the law."""

    def written(more="", law=LAW, name="mine.py"):
        path = tmp_path / name
        path.write_text(dedent(law) + dedent(more))
        return load_mission(str(path))

    return written


# What is refused before a drone flies -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "found"),
    [
        (
            "def report(results): ...",
            r"mine\.py: report: found def report\(results\); .*def report\(config, results\)",
        ),
        ("def goal(): ...", r"goal: found def goal\(\); allowed: def goal\(config\)"),
        (
            "async def check(config, force): ...",
            r"mine\.py:\d+: check: found async def check\(.*Write `def check`, not",
        ),
        ("goal = {0: (0.0, 0.0, 1.0)}", "goal: found goal = dict .*another name"),
        (
            "def guidance(i): ...",
            r"found def guidance\(i\); allowed: def guidance\(i, config\)",
        ),
    ],
)
def test_a_hook_that_cannot_be_called_is_refused_when_the_file_is_loaded(
    mission, more, found
):
    with pytest.raises(ConfigError, match=found):
        mission(more)


def test_a_hook_may_have_more_arguments_if_they_have_defaults(mission):
    loaded = mission(
        "def report(config, results, digits=3):\n    return {'digits': digits}"
    )
    assert loaded.report(SWARM, {}) == {"digits": 3}
    assert not has_hook(loaded, "goal")


@pytest.mark.parametrize(
    ("guidance", "found"),
    [
        (
            "def guidance(i, config): return None",
            r"mine\.py: guidance\(i, config\): found None for drone 1",
        ),
        ("def guidance(i, config): return Law", "found ABCMeta|found type"),
        (
            "class A(CFDistributedFeedback):\n    def stp(self, me, heard): ...\n"
            "def guidance(i, config): return A()",
            r"class A: found no step of its own.*'stp' meant to be 'step'",
        ),
        (
            "class A(CFDistributedFeedback):\n    def step(self, state): ...\n"
            "def guidance(i, config): return A()",
            r"class A: step: found def step\(state\); .*step\(me, heard\)",
        ),
        (
            "class A(CFGuidance):\n    async def run(self): ...\n"
            "def guidance(i, config): return A()",
            "class A: found no mission of its own.*async def mission",
        ),
        (
            "class A(CFGuidance):\n    def mission(self): ...\n"
            "def guidance(i, config): return A()",
            r"mine\.py:\d+: class A: mission: found def mission; .*Write `async def mission`",
        ),
        (
            "class A(Law):\n    async def step(self, me, heard): ...\n"
            "def guidance(i, config): return A()",
            r"mine\.py:14: class A: step: .*Write `def step`, not `async def step`",
        ),
        (
            "class A(Law):\n    async def height(self): ...\n"
            "def guidance(i, config): return A()",
            r"mine\.py:14: class A: height: .*Write `def height`, not `async def height`",
        ),
        (
            "class A(Law):\n    async def route(self): ...\n"
            "def guidance(i, config): return A()",
            "class A: route: .*Write `def route`",
        ),
        (
            "class A(Law):\n    def asked(self, verb, arguments): ...\n"
            "def guidance(i, config): return A()",
            "class A: asked: .*Write `async def asked`",
        ),
        (
            "def guidance(i, config): return config.wings",
            r"mine\.py:\d+: guidance.*AttributeError",
        ),
    ],
)
def test_a_guidance_that_cannot_fly_is_refused(mission, guidance, found):
    with pytest.raises(ConfigError, match=found):
        mission(guidance).guidance(1, SWARM)


@pytest.mark.parametrize(
    ("more", "hook", "found"),
    [
        (
            "def swarm(drones): return {}",
            "swarm",
            "found dict {}; allowed: a SwarmConfig",
        ),
        (
            "def check(config, force): return 'slow'",
            "check",
            "found str 'slow'; allowed: a list of warnings",
        ),
        (
            "def check(config, force): return 1 / 0",
            "check",
            r"mine\.py:\d+: check\(config, force\): found ZeroDiv",
        ),
        (
            "def goal(config): return {0: (0.0, 1.0)}",
            "goal",
            r"found tuple \(0.0, 1.0\) for drone 0",
        ),
        (
            "def goal(config): return {7: (0.0, 1.0, 2.0)}",
            "goal",
            "with drones 0, 1 in the swarm|with drones 0 to 1",
        ),
    ],
)
def test_what_a_hook_returns_is_checked(mission, more, hook, found):
    with pytest.raises(ConfigError, match=found):
        getattr(mission(more), hook)(SWARM)


def test_a_refusal_of_the_mission_itself_passes(mission):
    text = "from crazychoir.errors import Refused\ndef check(config, force): raise Refused('me', 'too windy')"
    with pytest.raises(Refused, match="too windy"):
        mission(text).check(SWARM)


def test_the_line_is_that_of_the_mission_file_wherever_the_error_was_raised(mission):
    with pytest.raises(
        ConfigError, match=r"mine\.py:15: goal\(config\): found JSONDecodeError"
    ):
        mission("import json\ndef goal(config):\n    return json.loads('{')").goal(
            SWARM
        )


def test_a_mission_file_imports_the_files_beside_it(mission):
    mission(name="beside_me.py")
    loaded = mission(
        law="from beside_me import Law\ndef guidance(i, config): return Law()",
        name="other.py",
    )
    assert loaded.guidance(0, SWARM).duration == 0.5


# What comes after the flight costs it nothing -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("body", "found"),
    [
        (
            "return {'height': results[7]['height']}",
            r"mine\.py:\d+: report\(config, results\): found KeyError: 7",
        ),
        ("return 'done'", "found str 'done'; allowed: a dictionary"),
        ("return {'reasons': 'none'}", "found reasons = str 'none'"),
        ("raise TimeoutError('late')", "TimeoutError: late"),
    ],
)
def test_a_report_that_fails_keeps_the_run_and_says_why(mission, body, found, caplog):
    result = fly_fast(SWARM, mission(f"def report(config, results): {body}"))
    assert not result["success"]
    assert sorted(result["results"]) == [0, 1]
    assert all(own["success"] for own in result["results"].values())
    with pytest.raises(ConfigError, match=found):
        raise ConfigError(result["reasons"][0], "", "")
    assert result["reasons"][0] in caplog.text


def test_a_picture_that_fails_is_no_picture(mission, caplog, tmp_path):
    loaded = mission("def picture(config, results, path): open('/nowhere/at/all')")
    loaded.picture(SWARM, {}, str(tmp_path / "p.png"))
    assert "no picture: mission " in caplog.text
    assert "picture(config, results, path): found FileNotFoundError" in caplog.text


# Laws that never acted ----------------------------------------------------------------------------------------------


def law_of(body):
    return LAW.replace("return Acceleration(-2.0 * me.v)", body)


@pytest.mark.parametrize(
    ("body", "found"),
    [
        (
            "return np.zeros(3)",
            "step() must return Acceleration(...), Velocity(...), FullState(...), Goto(...) or "
            "None; found ndarray (3,)",
        ),
        ("return 'up'", "Goto(...) or None; found str"),
        (
            "return Acceleration(np.zeros(2))",
            "step() must return finite numbers, Acceleration of (3,)",
        ),
        (
            "return Acceleration(np.full(3, np.nan))",
            "found Acceleration(array([nan, nan, nan]), 0.0)",
        ),
    ],
)
def test_a_law_without_a_usable_reference_has_failed(mission, body, found):
    result = fly_fast(SWARM, mission(law=law_of(body)))
    assert not result["success"]
    for i, own in result["results"].items():
        n = own["reason"].split(" in ")[1].split()[0]
        assert own["reason"].startswith(
            f"drone {i}: the law gave no usable reference in {n} of {n} steps: "
        )
        assert int(n) == pytest.approx(50, abs=1)
        assert found in own["reason"]
        assert own["references"] == 0


def test_a_law_that_acted_at_some_time_or_waits_is_none_that_never_acted(mission):
    wanted = (
        "-2.0 * me.v if me.p[0] < 0.0 or self._running.tally.steps > 9 else np.zeros(2)"
    )
    body = f"return Acceleration({wanted}) if self.id else None"
    result = fly_fast(SWARM, mission(law=law_of(body)))
    assert result["success"], result["reasons"]
    assert result["results"][0]["references"] == 0
    assert result["results"][1]["references"] == pytest.approx(40, abs=1)
    assert NO_DRONE_MOVED not in result["log"]


def test_a_law_that_says_nothing_at_any_drone_is_a_success_with_a_warning(
    mission, caplog
):
    result = fly_fast(SWARM, mission(law=law_of("return None")))
    assert result["success"]
    assert result["log"][-1] == NO_DRONE_MOVED
    assert NO_DRONE_MOVED in caplog.text


def test_a_file_that_raises_when_it_is_loaded_is_refused_with_its_line(
    tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("import math\n\nx = 1 / 0\n")
    for path in ("mine.py", str(tmp_path / "mine.py")):
        with pytest.raises(ConfigError) as caught:
            load_mission(path)
        assert str(caught.value).startswith(
            f"mission {path}:3: found ZeroDivisionError: division by zero; allowed: "
        )


def test_a_law_with_mostly_unflyable_references_is_reported(mission):
    loaded = mission(
        "class Torn(Law):\n"
        "    count = 0\n"
        "    def step(self, me, heard):\n"
        "        self.count += 1\n"
        "        return Acceleration(np.full(3, np.nan) if self.count % 5 else -me.v)\n"
        "def guidance(i, config): return Torn()"
    )
    run = fly_fast(SWARM, loaded)
    assert run["success"]
    assert run["refused_references"][0] == run["results"][0]["refused_references"] > 30
    assert "no usable reference in" in run["reasons"][0]
    assert "finite numbers" in run["reasons"][0]
