"""The page of a running swarm: real processes over Zenoh, the page's server beside them."""

import asyncio
import signal

import pytest
from system.agents import Team, flying, results, until

pytest.importorskip("nicegui", reason="the page needs the extra: pip install 'crazychoir[dashboard]'")

from system.pages import dashboard, looking_on, six

pytestmark = [pytest.mark.system, pytest.mark.real_time]


async def served(team: Team, *words):
    return await dashboard(team.path, *words)


async def test_six_take_off_land_and_stop_by_the_page_with_receipts_and_fly_on_without_it(tmp_path, compiled):
    async with flying(six(), tmp_path) as team:
        program, address = await served(team)
        other, other_address = await served(team)
        try:
            async with looking_on(address) as page, looking_on(other_address) as second:
                await page.sees("on ground")
                receipt = await page.does("take-off")
                assert [said for _, said in receipt["answers"].values()] == ["hovering"] * 6
                await second.sees("hovering", seconds=5.0)
                assert page.rows[:, 2].min() > 0.5
                assert second.rows[:, 2].min() > 0.5
                await page.ask("order", verb="take-off", drones=[2])
                await asyncio.sleep(0.5)
                refused = await page.receipt("take-off")
                assert refused["answers"] == {"2": ["refused", "it is in the air already"]}
                await second.does("hold", drones=[4])
                told = {"drone": 4, "text": "commanded: hold", "level": "info"}
                await until(lambda: any(told.items() <= line.items() for line in page.log), 5.0, lambda: str(page.log))
            program.signal(signal.SIGKILL)
            await program.process.wait()
            await asyncio.sleep(1.5)
            assert {status["phase"] for status in team.newest()} == {"hovering"}
            async with looking_on(other_address) as page:
                await page.does("land", drones=[0, 1, 2])
                await page.does("emergency stop", "stop")
                await page.sees("on ground", "stopped")
                assert page.phases()[3:] == ["stopped"] * 3
                await page.does("clear stop", "stop", clear=True)
        finally:
            await program.kill()
            await other.kill()
        ended = results(await team.end(40.0))
        assert "landed on command" in ended[0]["reason"]
        assert "emergency stop" in ended[5]["reason"]


async def test_what_a_page_may_not_ask_for_is_refused_and_said(tmp_path, compiled):
    async with flying(six(processes=1), tmp_path) as team:
        program, address = await served(team)
        try:
            async with looking_on(address) as page:
                for words in (
                    {"verb": "explode"}, {"verb": "land", "drones": [9]}, {"verb": "land", "drones": []},
                    {"verb": "land", "drones": [1e9]}, {"verb": "land", "more": 1}, {},
                ):  # fmt: skip
                    await page.ask("order", **words)
                await page.socket.send("{")
                await page.socket.send("[" * 5000)
                await asyncio.sleep(0.5)
                assert len(page.replies) == 8
                assert "0 to 5" in page.replies[1]["refused"]
                assert page.receipts == {}
        finally:
            program.signal(signal.SIGINT)
            ended = await program.end(10.0)
        assert ended["code"] == 0
        assert "Traceback" not in program.text
