"""A script that starts a swarm in real time, flies it, and reads its recording."""

import pytest

from crazychoir.api import OrderFailed, launch, read

pytestmark = [pytest.mark.system, pytest.mark.real_time]


def test_script_launches_a_swarm_flies_it_and_reads_its_track(tmp_path):
    record = tmp_path / "flight.mcap"
    with launch("operator", drones=2, processes=1, record=record) as swarm:
        swarm.take_off(height=0.3)
        swarm.go_to([0.0, 0.3, 0.0], relative=True)
        assert swarm[1].state().p == pytest.approx([0.6, 0.3, 0.3], abs=0.1)
        with pytest.raises(OrderFailed, match="drone 0: go-to refused: go-to = "):
            swarm[0].go_to([0.0, 0.0, 50.0])
        assert isinstance(swarm[0].param["control.kp"], float | list)
    assert swarm.result["success"], swarm.result
    assert read(record).track(1)["position"][-1] == pytest.approx(
        [0.6, 0.3, 0.0], abs=0.1
    )
