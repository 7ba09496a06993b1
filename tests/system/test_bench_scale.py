"""The bench measures what it says; no test checks its figures."""

import io

import numpy as np
import pytest
from rich.console import Console

from crazychoir.bench import scale as bench_scale
from crazychoir.bench.scale import ScaleCell
from crazychoir.errors import ConfigError

pytestmark = pytest.mark.system


def cell(n, p, noise=0.0):
    """What a machine of known costs would show."""
    far = 0.0 if p == 1 else 4000.0 * n * (p - 1) / p
    near, frames = 4000.0 * n - far, 50.0 * p * (p - 1)
    cpu = 1e-5 * 1000.0 * n + 1e-6 * near + 3e-6 * far + 1e-4 * frames
    memory, start = (
        3e7 * p + 2e4 * n + 5e5 * p * (p - 1),
        0.2 + 0.3 * p + 0.01 * p * (p - 1),
    )
    return ScaleCell(
        n,
        p,
        1000.0,
        1000.0 * n,
        near,
        far,
        frames,
        40.0 * far + 100.0 * frames,
        cpu * (1.0 + noise),
        memory,
        start,
        5,
    )


GRID = [(n, p) for n in (10, 100, 1000) for p in (1, 2, 4, 8) if n >= 5 * p]


def test_a_model_finds_the_costs_of_a_machine_that_obeys_it():
    cells = [cell(n, p) for n, p in GRID]
    processor, memory = (
        bench_scale.fit_model("processor", cells),
        bench_scale.fit_model("memory", cells),
    )
    assert processor.coefficients == pytest.approx(
        {"step": 1.4e-5, "far": 2e-6, "frame": 1e-4}, rel=1e-3
    )
    assert memory.coefficients == pytest.approx(
        {"process": 3e7, "agent": 2e4, "link": 5e5}, rel=1e-6
    )
    assert max(processor.worst, processor.left_out_worst, memory.left_out_worst) < 1e-3


def test_a_model_says_how_far_it_is_off():
    draw = np.random.default_rng(1)
    fit = bench_scale.fit_model(
        "processor", [cell(n, p, float(draw.uniform(-0.2, 0.2))) for n, p in GRID]
    )
    assert 0.01 < fit.error < fit.worst
    assert fit.worst <= fit.left_out_worst


def test_a_grid_too_small_to_leave_cells_out_says_no_error_of_them():
    fit = bench_scale.fit_model("processor", [cell(10, 2), cell(20, 2)])
    assert (fit.left_out, fit.left_out_worst) == (None, None)
    assert bench_scale.format_share(fit.left_out) == "-"


def test_what_more_agents_need_is_what_the_model_says():
    fits = {
        name: bench_scale.fit_model(name, [cell(n, p) for n, p in GRID])
        for name in bench_scale.MODEL_TERMS
    }
    one, each = bench_scale.estimate_hosts(fits)
    assert (one["processes"], one["links"], each["links"]) == (100, 4950, 319_600)
    assert one["cores_a_host"] == pytest.approx(
        1000.0 * (1e-5 + 4 * (3e-6 + 1e-4)), rel=1e-3
    )
    assert one["bytes_a_host"] == pytest.approx(4000.0 * 140.0, rel=1e-3)
    assert each["memory_a_host"] == pytest.approx(
        8 * 3e7 + 100 * 2e4 + 8 * 799 * 5e5, rel=1e-3
    )


def test_a_choice_replaces_the_cells():
    choice = bench_scale.ScaleChoice((10, 40), (1, 3))
    assert bench_scale.choose_cells(False, choice) == [(10, 1), (40, 1), (40, 3)]
    with pytest.raises(ConfigError, match="at least 5 agents a process"):
        bench_scale.choose_cells(True, bench_scale.ScaleChoice((10,), (3,)))


def test_a_choice_leaves_out_the_model(monkeypatch):
    monkeypatch.setattr(bench_scale, "measure", lambda n, p, *settings: cell(n, p))
    choice = bench_scale.ScaleChoice((10,), (1,))
    result = bench_scale.run(True, False, 1, lambda text: None, choice)
    assert (len(result["cells"]), result["fits"], result["needs"]) == (1, {}, [])
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(bench_scale.table(result))
    assert "model of" not in console.export_text()


@pytest.mark.slow
@pytest.mark.real_time
@pytest.mark.parametrize("namespaces", [False, True])
def test_cells_are_measured_and_shown(monkeypatch, namespaces):
    monkeypatch.setattr(bench_scale, "QUICK_RUN_CELLS", ((10, 20), (1, 2)))
    said = []
    result = bench_scale.run(True, namespaces, 1, said.append)
    assert [(row["agents"], row["processes"]) for row in result["cells"]] == [
        (10, 1),
        (10, 2),
        (20, 1),
        (20, 2),
    ]
    for row in result["cells"]:
        assert (
            min(row[key] for key in ("rounds", "steps", "cpu", "memory", "start")) > 0.0
        )
        assert (row["frames"] > 0.0, row["far"] > 0.0) == (row["processes"] == 2,) * 2
    console = Console(width=100, record=True, file=io.StringIO())
    console.print(bench_scale.table(result))
    text = console.export_text()
    assert "10,000 agents on 100 hosts" in text
    assert "…" not in text
