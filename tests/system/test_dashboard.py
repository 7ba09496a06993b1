"""The page of a running swarm: real processes over Zenoh, the page's server beside them."""

import asyncio
import contextlib
import http.client
import http.cookiejar
import json
import signal
import ssl
import urllib.error
import urllib.request
from itertools import islice

import numpy as np
import pytest
import trustme
from system.agents import CRAZYCHOIR, Program, Team, flying, results, until

pytest.importorskip(
    "nicegui", reason="the page needs the extra: pip install 'crazychoir[dashboard]'"
)

from system.pages import FLIGHT, dashboard, looking_on, six
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidMessage, InvalidStatus

from crazychoir.dashboard.server import (
    IDLE_CHECK_PERIOD,
    MOST_CONNECTIONS_PER_ADDRESS,
)

pytestmark = [pytest.mark.system, pytest.mark.real_time]


async def served(team: Team, *words):
    return await dashboard(team.path, *words)


async def test_six_take_off_land_and_stop_by_the_page_with_receipts_and_fly_on_without_it(
    tmp_path, compiled
):
    async with flying(six(), tmp_path) as team:
        program, address = await served(team)
        other, other_address = await served(team)
        try:
            async with looking_on(address) as page, looking_on(other_address) as second:
                await page.sees("on ground")
                receipt = await page.does("take-off")
                assert [said for _, said in receipt["answers"].values()] == [
                    "hovering"
                ] * 6
                await second.sees("hovering", seconds=5.0)
                assert page.rows[:, 2].min() > 0.5
                assert second.rows[:, 2].min() > 0.5
                await page.ask("order", verb="take-off", drones=[2])
                await asyncio.sleep(0.5)
                refused = await page.receipt("take-off")
                assert refused["answers"] == {
                    "2": ["refused", "it is in the air already"]
                }
                await second.does("hold", drones=[4])
                told = {"drone": 4, "text": "commanded: hold", "level": "info"}
                await until(
                    lambda: any(told.items() <= line.items() for line in page.log),
                    5.0,
                    lambda: str(page.log),
                )
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


async def test_what_a_page_may_not_ask_for_is_refused_and_said(tmp_path):
    path = tmp_path / "swarm.json"
    path.write_text(six(processes=1).dumps())  # no process flies it
    program, address = await dashboard(path)
    try:
        async with looking_on(address) as page:
            for words in (
                {"verb": "explode"},
                {"verb": "land", "drones": [9]},
                {"verb": "land", "drones": []},
                {"verb": "land", "drones": [1e9]},
                {"verb": "land", "more": 1},
                {},
            ):
                await page.ask("order", **words)
            await page.socket.send("{")
            await page.socket.send("[" * 5000)
            await asyncio.sleep(0.5)
            assert len(page.replies) == 8
            assert "0 to 5" in page.replies[1]["refused"]
            assert page.receipts == {}
            await page.ask("order", verb="land", drones=[1])
            await until(
                lambda: page.receipts, 5.0, lambda: "no receipt of a good order"
            )
    finally:
        program.signal(signal.SIGINT)
        ended = await program.end(10.0)
    assert ended["code"] == 0
    assert "Traceback" not in program.text


@pytest.mark.slow
async def test_a_drone_flies_to_a_place_and_along_a_drawing_by_page_and_by_command_line(
    tmp_path, compiled
):
    file = tmp_path / "hook.csv"
    rows = [
        f"0,{0.05 * k},{0.5 * np.cos(0.05 * k)},{0.5 * np.sin(0.05 * k)}"
        for k in range(60)
    ]
    file.write_text("\n".join(["stroke,t,x,y", *rows]))
    async with flying(six(), tmp_path) as team:
        program, address = await served(team)
        try:
            async with looking_on(address) as page:
                await page.does("take-off")
                await page.does(
                    "go-to",
                    "go-to",
                    drones=[1, 2],
                    p=[0.0, 0.0, 1.4],
                    offset=[0.8, 0.0, 0.0],
                )
                assert page.rows[1, 0:3] == pytest.approx([0.0, 0.0, 1.4], abs=0.1)
                assert page.rows[2, 0:3] == pytest.approx([0.8, 0.0, 1.4], abs=0.1)
                await page.does("go-to", "go-to", drones=[2], p=[1.2, -0.7, 0.6])
                swarm = ("--drones", "1", "--swarm", team.path, "--json")
                flight = await Program.start(
                    *CRAZYCHOIR, "fly", file, "--height", "1.4", "--speed", "1", *swarm
                )
                said = await flight.end(60.0)
                assert json.loads(said["answer"]) == {
                    "1": {"answer": "done", "says": "flown"}
                }
                end = [0.5 * np.cos(2.95), 0.5 * np.sin(2.95), 1.4]
                assert page.rows[1, 0:3] == pytest.approx(end, abs=0.1)
                near = (
                    "--offset",
                    "0,0.1,0",
                    "--drones",
                    "1,2",
                    "--swarm",
                    team.path,
                    "--json",
                )
                said = await (
                    await Program.start(*CRAZYCHOIR, "go-to", "0,0,1", *near)
                ).end(60.0)
                assert (
                    "from one drone to the next" in json.loads(said["answer"])["error"]
                )
                flight = await Program.start(*CRAZYCHOIR, "go-to", "0,-0.7,0.6", *swarm)
                said = await flight.end(60.0)
                assert json.loads(said["answer"]) == {
                    "1": {"answer": "done", "says": "there"}
                }
                told = [line["text"] for line in page.log if line["drone"] == 1]
                assert told.count("commanded: go-to") == 2
                assert told.count("commanded: fly") == 1
                await page.does("land")
        finally:
            await program.kill()


def asks(address, path="/", context=None, **more):
    """Status of a request, and what came."""
    request = urllib.request.Request(f"{address}{path}", **more)  # noqa: S310 - of our own server
    try:
        with urllib.request.urlopen(request, timeout=10.0, context=context) as answer:  # noqa: S310
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


async def refused_line(address, **headers):
    """Status with which a WebSocket is refused."""
    with pytest.raises(InvalidStatus) as raised:
        await connect(address.replace("http", "ws") + "/line", **headers)
    return raised.value.response.status_code


async def test_the_page_of_loopback_is_closed_to_other_sites_other_names_and_oversized_input(
    tmp_path,
):
    path = tmp_path / "swarm.json"
    path.write_text(six(processes=1).dumps())  # no process flies it
    program, address = await dashboard(path)
    try:
        assert (await asyncio.to_thread(asks, address))[0] == 200
        for words, status in (
            ({"headers": {"Host": "evil.example"}}, 421),
            ({"method": "POST"}, 403),
            ({"headers": {"Origin": "http://evil.example"}}, 403),
            ({"headers": {"Sec-Fetch-Site": "same-site"}}, 403),
            ({"method": "POST", "headers": {"Origin": "http://evil.example"}}, 403),
            (
                {
                    "method": "POST",
                    "headers": {"Origin": address},
                    "data": b"x" * (1 << 19),
                },
                413,
            ),
        ):
            assert (await asyncio.to_thread(asks, address, **words))[0] == status
        assert (await asyncio.to_thread(asks, address, "/own/../model.py"))[0] == 404
        assert await refused_line(address) == 403
        assert await refused_line(address, origin="http://evil.example") == 403
        async with connect(
            address.replace("http", "ws") + "/line", origin=address
        ) as socket:
            await socket.send(
                '{"ask":"load","name":"a.csv","text":"' + "x" * (1 << 19) + '"}'
            )
            with contextlib.suppress(ConnectionClosed):
                async with asyncio.timeout(10.0):
                    while True:
                        await socket.recv()
            assert socket.close_code == 1009, "too large"
        assert (await asyncio.to_thread(asks, address))[0] == 200
        other, elsewhere = await dashboard(path)
        assert elsewhere != address
        await other.kill()
    finally:
        await program.kill()


def on_all(authority, folder):
    """Options of a page at all addresses, with a certificate of that authority."""
    files = {name: folder / f"{name}.pem" for name in ("certificate", "key")}
    made = authority.issue_cert("localhost")
    made.cert_chain_pems[0].write_to_path(files["certificate"])
    made.private_key_pem.write_to_path(files["key"])
    return (
        "--host",
        "0.0.0.0",  # noqa: S104
        *(word for name, file in files.items() for word in (f"--{name}", str(file))),
    )


async def test_another_address_wants_a_password_and_may_have_a_certificate(tmp_path):
    path, secret = tmp_path / "swarm.json", tmp_path / "secret"
    path.write_text(six(processes=1).dumps())
    refused = await Program.start(
        *CRAZYCHOIR,
        "dashboard",
        "--swarm",
        path,
        "--host",
        "0.0.0.0",  # noqa: S104
    )
    said = await refused.end(30.0)
    assert said["code"] == 2
    assert "--password-file" in refused.text
    secret.write_text("correct horse\n")
    authority = trustme.CA()
    program, address = await dashboard(
        path, "--password-file", str(secret), *on_all(authority, tmp_path)
    )
    assert address.startswith("https://0.0.0.0:")
    try:
        address = address.replace("0.0.0.0", "localhost")  # noqa: S104
        trusting = ssl.create_default_context()
        authority.configure_trust(trusting)
        status, body = await asyncio.to_thread(asks, address, context=trusting)
        assert (status, b"Password" in body) == (401, True)
        assert await refused_line(address, origin=address, ssl=trusting) in (401, 403)
        form = {
            "method": "POST",
            "headers": {"Origin": address},
            "data": b"password=correct+horse",
        }
        opener = urllib.request.build_opener(
            urllib.request.HTTPCookieProcessor(jar := http.cookiejar.CookieJar()),
            urllib.request.HTTPSHandler(context=trusting),
        )
        request = urllib.request.Request(f"{address}/login", **form)  # noqa: S310
        answer = await asyncio.to_thread(opener.open, request)
        assert b"crazychoir" in answer.read()
        (cookie,) = jar
        assert cookie.secure
        headers = {"Cookie": f"{cookie.name}={cookie.value}"}
        async with connect(
            address.replace("https", "wss") + "/line",
            origin=address,
            additional_headers=headers,
            ssl=trusting,
        ) as socket:
            assert json.loads(await socket.recv())["about"]["ids"] == list(range(6))
    finally:
        await program.kill()


async def test_only_a_client_with_a_certificate_of_the_authority_is_admitted(
    tmp_path,
):
    path, file = tmp_path / "swarm.json", tmp_path / "authority.pem"
    path.write_text(six(processes=1).dumps())
    authority, foreign = trustme.CA(), trustme.CA()
    authority.cert_pem.write_to_path(file)
    program, address = await dashboard(
        path, "--authority", str(file), *on_all(authority, tmp_path)
    )
    address = address.replace("0.0.0.0", "localhost")  # noqa: S104
    try:
        for signer in (None, foreign, authority):
            mine = ssl.create_default_context()
            authority.configure_trust(mine)
            if signer is not None:
                signer.issue_cert("operator@lab.example").configure_cert(mine)
            line = connect(
                address.replace("https", "wss") + "/line", origin=address, ssl=mine
            )
            if signer is authority:
                assert (await asyncio.to_thread(asks, address, context=mine))[0] == 200
                async with line as socket:
                    assert json.loads(await socket.recv())["about"]["ids"] == list(
                        range(6)
                    )
                continue
            with pytest.raises((OSError, http.client.HTTPException)):
                await asyncio.to_thread(asks, address, context=mine)
            with pytest.raises((OSError, EOFError, InvalidMessage)):
                async with line:
                    pass
        assert "Traceback" not in program.text
    finally:
        await program.kill()


async def test_silent_connections_do_not_block_other_clients(tmp_path):
    """They come from another address; each connection is closed when nothing was asked on it."""
    path, secret = tmp_path / "swarm.json", tmp_path / "secret"
    path.write_text(six(processes=1).dumps())
    secret.write_text("correct horse\n")
    program, address = await dashboard(
        path,
        "--host",
        "0.0.0.0",  # noqa: S104
        "--password-file",
        str(secret),
    )
    port = int(address.rpartition(":")[2])
    refused = 600 - 2 * MOST_CONNECTIONS_PER_ADDRESS
    strangers = []
    try:
        for k in range(600):
            local = (f"127.0.0.{2 + k % 2}", 0)
            strangers.append(
                await asyncio.open_connection("127.0.0.1", port, local_addr=local)
            )
        strangers[0][1].write(b"GET / HTTP/1.1\r\nHost: x\r\n")  # and no more
        ends = [asyncio.create_task(reader.read()) for reader, _ in strangers]
        async with asyncio.timeout(IDLE_CHECK_PERIOD):
            for end in islice(asyncio.as_completed(ends), refused):
                await end
        await asyncio.sleep(0.2)
        assert sum(end.done() for end in ends) == refused
        assert (await asyncio.to_thread(asks, f"http://127.0.0.1:{port}"))[0] == 401
        async with asyncio.timeout(2 * IDLE_CHECK_PERIOD):
            await asyncio.gather(*ends)
    finally:
        for _, writer in strangers:
            writer.close()
        await program.kill()


async def test_without_their_operators_console_all_land_by_themselves(
    tmp_path, compiled
):
    """flight.dead_man: the page's server is killed; the observer that looks on is no console."""
    async with flying(six(flight={**FLIGHT, "dead_man": 3.0}), tmp_path) as team:
        program, address = await served(team)
        async with looking_on(address) as page:
            await page.sees("on ground")
            await page.does("take-off")
            await asyncio.sleep(4.0)
            assert set(page.phases()) == {"hovering"}, "it is there"
        program.signal(signal.SIGKILL)
        await program.process.wait()
        ended = await team.end(30.0)
    reasons = [
        one["results"][key]["reason"]
        for one in ended.values()
        for key in one["results"]
    ]
    assert len(reasons) == 6
    assert all("no operator's console for 3 s" in reason for reason in reasons), reasons
