from types import SimpleNamespace

from crazychoir.cli.fly.run import _draw_mission
from crazychoir.config.swarm_config import default_swarm

PAIRS = default_swarm(4).replace(processes=[[0, 1], [2], [3]])


def test_a_mission_draws_its_own_picture_else_what_was_flown_is_drawn(tmp_path):
    result = {
        "results": {0: {}, 1: {}},
        "tracks": {0: [(0.0, 0.0, 0.0, 1.0), (1.0, 2.0, 0.0, 1.0)], 1: []},
    }
    path, drawn = tmp_path / "new" / "x.png", []
    own = SimpleNamespace(picture=lambda config, results, path: drawn.append(results))
    assert _draw_mission(own, PAIRS, result, path) is None, "it has written nothing"
    assert drawn == [{i: {"track": result["tracks"][i]} for i in range(2)}]
    assert _draw_mission(SimpleNamespace(), PAIRS, result, path) == str(path)
    assert path.read_bytes().startswith(b"\x89PNG")
    assert _draw_mission(SimpleNamespace(), PAIRS, result, None) is None
