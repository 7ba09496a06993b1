"""The public calls in a real kernel, as in Jupyter: its cells run inside an event loop."""

import asyncio
import json
from textwrap import dedent

import nbformat
import pytest
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

from crazychoir.api import fly
from crazychoir.optimization.algorithms.consensus import Consensus
from crazychoir.optimization.rounds.mixing import team
from crazychoir.solve.simulate import simulate
from crazychoir.team.graph import ring

pytestmark = [
    pytest.mark.system,
    # The kernel's own packages are older than the newest Python; what they warn of is not ours.
    pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning"),
]
IMPORTS = """
import json, pathlib, threading
from types import SimpleNamespace
from crazychoir import CFGuidance
from crazychoir.launch.flight import fly_fast
from crazychoir.solve.team import solve_in_processes
from crazychoir.guidance.mission import load_mission
from crazychoir.launch.flight import fly_real
from crazychoir.launch.network import isolate_swarm, write_swarm_file
from crazychoir.optimization.algorithms.consensus import Consensus
from crazychoir.optimization.rounds.mixing import team
from crazychoir.routing.instance.generate import random_instance
from crazychoir.solve.simulate import simulate
from crazychoir.solve.solving import solve_here
from crazychoir.config.swarm_config import default_swarm
from crazychoir.team.graph import ring
"""
SIMULATE = """
graph = ring(4)
agents = team(graph, lambda i, w: Consensus(i, [i], w, 9))
print(json.dumps(simulate(agents, graph, loss=0.3, seed=2).of().tolist()))
"""
SAME = """
class Rising(CFGuidance):
    async def mission(self):
        await self.take_off(0.3)
        await self.land()

def fly():
    return fly_fast(default_swarm(2), SimpleNamespace(guidance=lambda i, config: Rising()))["digest"]

def solve():
    return solve_here(random_instance(2, 3, seed=1))["plan_digest"]

for function in (fly, solve):
    in_cell, beside = function(), []
    thread = threading.Thread(target=lambda: beside.append(function()))
    thread.start()
    thread.join()
    print(in_cell == beside[0])
print(solve_in_processes(random_instance(2, 2, seed=1), 1)["feasible"])
"""
AWAITED = """
async def study():
    return simulate(team(graph, lambda i, w: Consensus(i, [i], w, 9)), graph, loss=0.3, seed=2).of().tolist()

print(json.dumps(await study()))
"""
ENDLESS = """
endless = team(graph, lambda i, w: Consensus(i, [i], w, None))
simulate(endless, graph, watch=lambda agents: pathlib.Path({seen!r}).touch())
"""
AFTER = "print([thread.name for thread in threading.enumerate() if thread.name == 'event loop'])"


def printed(cell):
    return "".join(
        output.text
        for output in cell.outputs
        if output.output_type == "stream" and output.name == "stdout"
    )


def notebook(*cells):
    return nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell(cell) for cell in cells]
    )


def test_cells_of_a_notebook_simulate_fly_and_solve_as_a_script_does():
    book = notebook(IMPORTS, SIMULATE, SIMULATE, AWAITED, SAME)
    NotebookClient(book, timeout=100).execute()
    graph = ring(4)
    history = simulate(
        team(graph, lambda i, w: Consensus(i, [i], w, 9)), graph, loss=0.3, seed=2
    )
    assert [json.loads(printed(cell)) for cell in book.cells[1:4]] == [
        history.of().tolist()
    ] * 3
    assert printed(book.cells[4]).split() == ["True"] * 3


def test_the_interrupt_of_a_kernel_ends_what_a_cell_runs(tmp_path):
    seen = tmp_path / "seen"
    book = notebook(IMPORTS, SIMULATE, ENDLESS.format(seen=str(seen)), AFTER, SIMULATE)
    client = NotebookClient(book)

    async def run():
        async with client.async_setup_kernel():
            for k in (0, 1):
                await client.async_execute_cell(book.cells[k], k)
            executing = asyncio.create_task(client.async_execute_cell(book.cells[2], 2))
            while not seen.exists():  # noqa: ASYNC110 - another process makes it
                await asyncio.sleep(0.05)
            await client.km.interrupt_kernel()
            with pytest.raises(CellExecutionError, match="Interrupted"):
                await executing
            for k in (3, 4):
                await client.async_execute_cell(book.cells[k], k)

    asyncio.run(run())
    assert printed(book.cells[3]).strip() == "[]"
    assert printed(book.cells[4]) == printed(book.cells[1])


@pytest.mark.real_time
def test_a_flight_in_real_processes_works_inside_a_loop(tmp_path):
    mission = tmp_path / "rise.py"
    mission.write_text(
        dedent("""
        from crazychoir import CFGuidance

        class Rising(CFGuidance):
            async def mission(self):
                await self.take_off(0.3)
                await self.land()

        def guidance(i, config):
            return Rising()
        """)
    )

    async def cell():
        return fly(mission, drones=2, fast=False, processes=1)

    flown = asyncio.run(cell())
    assert (flown.success, flown.reasons, flown.digest) == (True, {}, None)
    for i in (0, 1):
        highest = flown.track(i)["position"][:, 2].max()
        assert highest == pytest.approx(0.3, abs=0.05)
