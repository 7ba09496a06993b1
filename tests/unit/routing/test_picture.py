import pytest

from crazychoir.routing.compact import solve_compact
from crazychoir.routing.picture import draw_routes
from crazychoir.routing.plan import Plan


@pytest.mark.parametrize("name", ["flat", "room"])
def test_a_plan_becomes_a_png(small, tmp_path, name):
    from matplotlib.image import imread

    instance, optimum = small(name)
    plan = solve_compact(instance)
    assert plan.cost == pytest.approx(optimum)
    draw_routes(instance, plan, tmp_path / "plan.png")
    draw_routes(instance, Plan(()), tmp_path / "empty.png")
    drawn, empty = imread(tmp_path / "plan.png"), imread(tmp_path / "empty.png")
    assert drawn.shape[0] > 800
    assert (drawn[..., :3].min(axis=2) < 0.9).sum() > (empty[..., :3].min(axis=2) < 0.9).sum()


def test_matplotlib_is_imported_only_to_draw():
    import subprocess
    import sys

    code = "import crazychoir.routing.picture, crazychoir.routing.solve, sys; sys.exit('matplotlib' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
