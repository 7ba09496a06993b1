"""What the page says, sends and refuses to send, in a real browser; its server is there, and no drone."""

import contextlib

import numpy as np
import pytest
from system.agents import until

for package in ("nicegui", "playwright"):
    pytest.importorskip(
        package,
        reason="the page in a browser needs: pip install 'crazychoir[dashboard,test]'",
    )

from system.browsers import CHROMIUM, TABS, Wire, browser, draw_word, says  # noqa: E402 - see above
from system.pages import COLUMNS, dashboard, six  # noqa: E402

pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.timeout(180),
    pytest.mark.skipif(
        CHROMIUM is None, reason="no chromium: apt-get install chromium"
    ),
]
CONNECTED, LOST = '#connection[data-there="true"]', "body[data-lost]"
PLACES = """[".stop", "#drones", "#scene"].map(name => {
  const { left, top } = document.querySelector(name).getBoundingClientRect(); return [left, top]; })"""
TICKED = "[...document.querySelectorAll('#drones tbody input:checked')].map(box => box.ariaLabel)"


@contextlib.asynccontextmanager
async def looked_at(folder, **options):
    """A page, its wire, and its server's process."""
    path, wire = folder / "swarm.json", Wire()
    path.write_text(six(processes=1).dumps())
    program, address = await dashboard(path)
    try:
        async with browser(address, folder, wire, **options) as page:
            yield page, wire, program
    finally:
        await program.kill()


async def test_chosen_drones_stay_ticked_after_a_reconnect(tmp_path):
    async with looked_at(tmp_path) as (page, wire, _):
        await page.check('input[aria-label="drone 1"]')
        await page.check('input[aria-label="drone 3"]')
        lines = wire.lines
        await wire.cut()
        await until(lambda: wire.lines > lines, 10.0)
        await page.wait_for_selector(CONNECTED)
        assert await page.evaluate(TICKED) == ["drone 1", "drone 3"]
        assert await page.inner_text("#chosen") == "for drone 1, 3"
        await page.click("text=Hold")
        assert wire.of("order")[-1]["drones"] == [1, 3]
        await page.uncheck('input[aria-label="drone 1"]')
        assert await page.evaluate("choir.chosen()") == [3]


@pytest.mark.slow
@pytest.mark.parametrize("width", [1366, 1024])
async def test_nothing_that_the_header_says_moves_the_stop_or_the_table(
    tmp_path, width
):
    async with looked_at(tmp_path) as (page, wire, _):
        await page.set_viewport_size({"width": width, "height": 768})
        await page.wait_for_selector("#connection[data-ended]")
        assert await page.inner_text("#connection") == "ENDED: no drone is there"
        before = await page.evaluate(PLACES)
        await page.click("text=Go there")
        await says(page, "header [role=alert]", "choose drones")
        assert await page.evaluate(PLACES) == before
        await page.click("text=Hold")
        await says(page, "#newest", "hold")
        assert await page.evaluate(PLACES) == before
        wire.dead = True
        await page.wait_for_selector(LOST)
        assert await page.evaluate(PLACES) == before
        assert await page.inner_text("#connection") == "NOT CONNECTED"


@pytest.mark.slow
async def test_a_user_with_an_expired_login_is_told_to_log_in_again(tmp_path):
    async with looked_at(tmp_path, strict=False) as (page, wire, _):
        await page.route("**/own/page.css", lambda route: route.fulfill(status=401))
        wire.dead = True
        await page.click("#connection a", timeout=20_000.0, trial=True)
        assert await page.inner_text("#connection") == "LOG IN AGAIN"


@pytest.mark.slow
async def test_ticked_drones_are_commanded_after_the_server_restarts(
    tmp_path,
):
    async with looked_at(tmp_path, strict=False) as (page, _, program):
        await page.check('input[aria-label="drone 1"]')
        await program.kill()
        await page.wait_for_selector(LOST)
        again, _ = await dashboard(
            tmp_path / "swarm.json", "--port", page.url.split(":")[-1].strip("/")
        )
        try:
            await page.wait_for_selector(CONNECTED)
            await page.wait_for_function(
                f"`${{{TICKED}}}` === `${{(choir.chosen() ?? []).map(i => `drone ${{i}}`)}}`"
            )
        finally:
            await again.kill()


async def test_a_line_on_which_no_frames_come_is_said_to_be_dead_and_opened_anew(
    tmp_path,
):
    async with looked_at(tmp_path, strict=False) as (page, wire, _):
        wire.dead = True
        await page.keyboard.press("Space")
        assert await page.inner_text("#newest") == "… emergency stop: sent"
        await page.wait_for_selector(LOST, timeout=4_000)
        assert "NOT CONNECTED" in await page.inner_text("#connection")
        assert "emergency stop: no answer" in await says(page, "#trouble", "✗")
        assert (
            await page.locator(".view").evaluate("one => getComputedStyle(one).filter")
            == "grayscale(1)"
        )
        await says(page, "#kept", "STOP ALL: will be sent when connected")
        await page.shot("kept")
        wire.dead = False
        await page.wait_for_selector(CONNECTED, timeout=20_000)
        assert await page.locator(LOST).count() == 0
        await says(page, "#stopped", "emergency stop →")
        await page.locator("#kept").wait_for(state="hidden")
        assert await page.inner_text("#trouble") == ""
        lines = wire.lines
        await wire.cut()
        await until(lambda: wire.lines > lines, 10.0)
        await page.wait_for_selector(CONNECTED)
        assert (
            await page.locator("#receipts li:has-text('emergency stop')").count() == 1
        ), "it was pressed once"


async def test_a_stop_that_was_pressed_without_a_line_may_be_withdrawn_and_is_asked_about_when_it_is_old(
    tmp_path,
):
    async with looked_at(tmp_path, strict=False) as (page, wire, _):

        async def pressed():
            wire.dead = True
            await page.wait_for_selector(LOST, timeout=10_000)
            await page.keyboard.press("Space")
            await says(page, "#kept", "STOP ALL: will be sent when connected")

        async def again():
            wire.asked.clear()
            wire.dead = False
            await page.wait_for_selector(CONNECTED, timeout=20_000)
            return wire.of("stop")

        await pressed()
        await page.click("text=Withdraw")
        await page.locator("#kept").wait_for(state="hidden")
        assert await again() == []
        await pressed()
        await page.evaluate(
            "(() => { const now = Date.now; Date.now = () => now() + 31_000; })()"
        )
        await says(
            page,
            "#kept",
            "more than 30 s ago: no drone has answered. Send it now?",
        )
        await page.shot("asked_about")
        assert await again() == []
        await page.click("#kept-send")
        await says(page, "#stopped", "emergency stop →")
        assert len(wire.of("stop")) == 1
        await page.locator("#kept").wait_for(state="hidden")


async def test_a_stop_that_the_server_does_not_hear_is_sent_until_it_does_unless_it_is_cleared(
    tmp_path,
):
    async with looked_at(tmp_path) as (page, wire, _):
        wire.deaf = True
        await page.check('input[aria-label="drone 3"]')
        await page.click("text=Motors off")
        await says(page, "#kept", "STOP 3: sent again until it is answered")
        await until(lambda: len(wire.of("stop")) > 2, 5.0)
        assert len({message["key"] for message in wire.asked}) == 1
        wire.deaf = False
        await says(page, "#stopped", "emergency stop → 3 s")
        await page.locator("#kept").wait_for(state="hidden")
        wire.deaf = True
        await page.keyboard.press("Space")
        await says(page, "#kept", "STOP ALL")
        await page.click("text=Clear stop")
        await page.click("text=End it")
        await page.locator("#kept").wait_for(state="hidden")


@pytest.mark.slow
async def test_what_is_stopped_is_told_as_drones_say_it_beside_the_stops_that_some_have_not_obeyed(
    tmp_path,
):
    async with looked_at(tmp_path) as (page, wire, _):
        await page.keyboard.press("Space")
        await says(page, "#stopped", "emergency stop → 0, 1, 2, 3, 4, 5 sent")
        await page.check('input[aria-label="drone 0"]')
        await page.click("text=Motors off")
        line = await says(page, "#stopped", "emergency stop → 0 sent")
        assert "emergency stop → 0, 1, 2, 3, 4, 5 s" in line, (
            "that of the swarm is still sent"
        )
        await page.click("text=Clear stop")
        await page.click("text=End it")
        await page.wait_for_function(
            "document.querySelector('#stopped').textContent === ''", timeout=5_000
        )
        wire.drones = lambda rows: [row | said.get(row["id"], {}) for row in rows]
        stopped = {"heard": True, "stopped": True, "phase": "stopped"}
        said = {0: stopped, 1: stopped, 2: stopped | {"phase": "on ground"}}
        await says(
            page,
            "#stopped",
            "stop of the swarm in force: 0, 1, 2 may not take off · motors off: 0, 1",
        )
        await page.shot("in_force")
        said = {1: {"heard": True, "stopped": False, "phase": "stopped"}}
        await page.wait_for_function(
            "document.querySelector('#stopped').textContent === 'motors off: 1'"
        )
        said = {}
        await page.wait_for_function(
            "document.querySelector('#stopped').textContent === ''"
        )


async def test_what_the_server_does_not_answer_is_told_within_a_second_or_so(tmp_path):
    async with looked_at(tmp_path) as (page, wire, _):
        wire.deaf = True
        await page.click("text=Hold")
        await says(
            page, "header [role=alert]", "hold: no answer of this page's server", 4.0
        )
        assert await page.locator(CONNECTED).count() == 1
        wire.deaf = False
        await page.click("text=Land")
        await says(page, "header [role=status]", "land →")
        assert await page.inner_text("#trouble") == ""


async def test_a_stop_and_an_unanswered_command_are_shown_on_every_tab(tmp_path):
    async with looked_at(tmp_path) as (page, *_):
        await page.click("text=Hold")
        await page.click("#tab-draw")
        await says(page, "header [role=status]", "hold →")
        await says(page, "header [role=alert]", "no answer within 5 s", 20.0)
        await page.focus("#height")
        await page.keyboard.press("Space")
        await says(page, "header [role=alert]", "emergency stop →")
        await page.shot("stopped")
        assert await page.locator("#panel-draw").is_visible()
        await page.click("#tab-network")
        await page.click("text=Cut the chosen off")
        assert "cut off: choose drones" in await says(page, "#trouble", "✗")
        assert "emergency stop →" in await page.inner_text("#stopped")


async def test_space_stops_all_while_it_is_asked_whether_a_stop_is_to_end(tmp_path):
    async with looked_at(tmp_path) as (page, wire, _):
        focused = "document.activeElement.textContent"
        await page.click("text=Clear stop")
        assert await page.evaluate(focused) == "Cancel"
        await page.keyboard.press("Space")
        await page.locator("#clear").wait_for(state="hidden")
        await page.click("text=Clear stop")
        await page.click("text=STOP ALL")
        await page.locator("#clear").wait_for(state="hidden")
        for key in ("Enter", "Escape"):
            await page.click("text=Clear stop")
            await page.keyboard.press(key)
            await page.locator("#clear").wait_for(state="hidden")
        assert (
            len({message["key"] for message in wire.of("stop")}) == len(wire.asked) == 2
        )
        await page.click("text=Clear stop")
        await page.shot("clear")
        await page.click("text=End it")
        await until(lambda: wire.asked[2:] == [{"ask": "stop", "clear": True}], 5.0)


@pytest.mark.slow
async def test_a_field_without_a_number_is_marked_and_nothing_is_sent(tmp_path):
    async with looked_at(tmp_path) as (page, wire, _):
        await page.check('input[aria-label="drone 1"]')
        await page.fill("#goal_x", "")
        await page.click("text=Go there")
        assert "Place x" in await says(page, "#trouble", "no number")
        assert await page.get_attribute("#goal_x", "aria-invalid") == "true"
        assert await page.get_attribute("#goal_y", "aria-invalid") == "false"
        await page.fill("#goal_x", "1.5")
        await page.click("text=Go there")
        assert await page.get_attribute("#goal_x", "aria-invalid") == "false"
        assert [message["p"][0] for message in wire.of("go-to")] == [1.5]
        await page.click("#tab-tasks")
        await page.fill("#delivery_y", "")
        await page.click("text=Add task")
        assert "Delivery y" in await says(page, "#trouble", "no number")
        await page.click("#tab-draw")
        await page.fill("#lift", "")
        await draw_word(page)
        assert "Lift" in await says(page, "#plan", "no number")
        assert wire.of("add-task") == wire.of("draw") == []
        await page.click("#tab-parameters")
        types = {"led.bitmask": ["uint8_t", True], "cpu.flash": ["uint16_t", False]}
        wire.tell(parameters={"drone": 0, "types": types})
        await says(page, "#parameters-said", "2 of 2 parameters")
        await page.fill("#parameter-filter", "LED")
        await says(page, "#parameters-said", "1 of 2 parameters")
        wire.tell(parameters={"drone": 0, "values": {"led.bitmask": 3}})
        assert "bitmask uint8_t writable 3" in " ".join(
            (await says(page, "#parameters tbody", "3")).split()
        )
        assert [message["name"] for message in wire.of("read-parameters")] == ["led"]
        value = page.get_by_label("new value of led.bitmask")
        await page.click('[aria-label="Set led.bitmask"]')
        assert "led.bitmask" in await says(page, "#trouble", "no number")
        assert await value.get_attribute("aria-invalid") == "true"
        await value.fill("255")
        await value.press("Enter")
        assert await value.get_attribute("aria-invalid") == "false"
        (sent,) = wire.of("set-parameter")
        assert (sent["drone"], sent["name"], sent["value"]) == (0, "led.bitmask", 255)
        wire.tell(parameters={"drone": 5, "values": {"led.bitmask": 9}})
        wire.tell(parameters={"drone": 0, "values": {"led.bitmask": 255}})
        await says(page, '[data-value="led.bitmask"]', "255")


@pytest.mark.slow
async def test_sliders_show_what_is_in_force_for_the_chosen_and_send_it_as_often_as_is_asked(
    tmp_path,
):
    async with looked_at(tmp_path) as (page, wire, _):
        await page.click("#tab-network")
        assert await page.inner_text("#network-said") == "not known yet"
        rules = [
            {"loss": 0.3},
            {"edge": [2, 1], "delay": 0.1},
            {"drone": 1, "loss": 0.5},
            {"drone": 4, "delay": 0.2},
        ]
        wire.news = {
            "network": {"rules": rules, "words": "loss 0.3; drone 1: loss 0.5; ..."}
        }
        await page.wait_for_function(SLIDERS + " === '30 0'")
        assert (
            await page.inner_text("#network-said") == "loss 0.3; drone 1: loss 0.5; ..."
        )
        for _ in range(2):
            await page.click("text=Apply")
        assert (
            wire.of("impair")
            == [{"ask": "impair", "loss": 0.3, "delay": 0, "drones": None}] * 2
        )
        await page.check('input[aria-label="drone 1"]')
        assert await page.evaluate(SLIDERS) == "50 0"
        await page.check('input[aria-label="drone 2"]')
        assert await page.evaluate(SLIDERS) == "50 100"
        assert await page.text_content('output[for="delay"]') == "100"
        await page.uncheck('input[aria-label="drone 1"]')
        assert await page.evaluate(SLIDERS) == "30 0"
        await page.focus("#loss")
        for _ in range(5):
            await page.keyboard.press("ArrowRight")
        await page.wait_for_timeout(700)
        assert await page.evaluate(SLIDERS) == "35 0", (
            "news that say the same move nothing"
        )
        assert len(wire.of("impair")) == 2, (
            "nor is anything sent before it is asked for"
        )
        await page.click("text=Take everything back")
        assert await page.evaluate(SLIDERS) == "0 0"
        wire.news = {
            "network": {
                "rules": [{"p_good_bad": 0.1, "p_bad_good": 0.3}],
                "words": "bursts",
            }
        }
        await page.wait_for_function(SLIDERS + " === '25 0'")
        bursts_of_one = {"drone": 2, "p_good_bad": 0.1, "p_bad_good": 0.1}
        wire.news = {
            "network": {"rules": [{"loss": 0.3}, bursts_of_one], "words": "both"}
        }
        await page.wait_for_function(SLIDERS + " === '50 0'")
        assert await page.is_checked('input[aria-label="drone 2"]')


SLIDERS = "`${document.getElementById('loss').value} ${document.getElementById('delay').value}`"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["csv", "svg"])
async def test_a_drawing_is_saved_as_a_file_and_loaded_again(tmp_path, kind):
    strokes = "choir.sketch.strokes().map(stroke => stroke.map(([, x, y]) => [x, y]))"
    async with looked_at(tmp_path) as (page, _, _program):
        await page.click("#tab-draw")
        await draw_word(page)
        drawn = await page.evaluate(strokes)
        async with page.expect_download() as waiting:
            await page.click(f"text=Save {kind.upper()}")
        file = tmp_path / (await waiting.value).suggested_filename
        await (await waiting.value).save_as(file)
        assert file.name == f"drawing.{kind}"
        await page.click("#panel-draw >> text=Clear")
        assert await page.evaluate(strokes) == []
        await page.set_input_files("#file", file)
        await page.wait_for_function("choir.sketch.strokes().length === 4")
        for one, other in zip(await page.evaluate(strokes), drawn, strict=True):
            assert np.array(one) == pytest.approx(np.array(other), abs=2e-4)


@pytest.mark.slow
async def test_no_tab_moves_the_table_what_flies_a_drawing_is_in_sight_and_dismissed_hints_stay_away(
    tmp_path,
):
    """The box of a drone stays in its place in every tab: the operator ticks the box under the pointer."""
    async with looked_at(tmp_path, viewport={"width": 1280, "height": 800}) as (
        page,
        _,
        _program,
    ):
        first = page.locator('input[aria-label="drone 0"]')
        places = []
        for tab in TABS:
            await page.click(f"#tab-{tab}")
            places.append((await first.bounding_box())["y"])
        assert len(set(places)) == 1, places
        await page.click("#tab-draw")
        panel = await page.locator("#panel-draw").bounding_box()
        button = await page.locator("text=Fly it with the chosen drones").bounding_box()
        assert button["y"] + button["height"] < panel["y"] + panel["height"]
        for tab in TABS[:-1]:
            await page.click(f"#tab-{tab}")
            await page.click(f"#panel-{tab} >> text=Got it")
        await page.reload()
        await page.wait_for_selector(CONNECTED)
        for tab in TABS:
            await page.click(f"#tab-{tab}")
            is_left = tab == TABS[-1]
            assert await page.is_visible(f"#panel-{tab} >> text=Got it") == is_left


@pytest.mark.slow
async def test_a_drawing_of_very_many_points_is_thinned_and_what_is_too_large_is_not_sent(
    tmp_path,
):
    async with looked_at(tmp_path) as (page, wire, _):
        await page.click("#tab-draw")
        box = await page.locator("#sketch").bounding_box()
        await page.mouse.move(
            box["x"] + box["width"] / 2 + 60, box["y"] + box["height"] / 2
        )
        await page.mouse.down()
        await page.evaluate(CIRCLES)
        await page.mouse.up()
        await says(page, "#plan", "m/s²", 60.0)
        (stroke,) = wire.of("draw")[-1]["strokes"]
        places = np.array(stroke)[:, 1:]
        assert 500 < len(places) < 5000
        assert np.linalg.norm(np.diff(places[:-1], axis=0), axis=1).min() > 0.0019
        before = len(wire.asked), wire.lines
        assert not await page.evaluate(
            'choir.ask({ ask: "load", name: "a.csv", text: "x".repeat(1 << 18) })'
        )
        assert "load: too large, 257 KiB of at most 256" in await says(
            page, "#trouble", "✗"
        )
        assert (len(wire.asked), wire.lines) == before


CIRCLES = """
() => {
  const canvas = document.getElementById("sketch"), area = canvas.getBoundingClientRect();
  const coalescedEvents = Array.from({ length: 6000 }, (_, k) => {
    const turn = (2 * Math.PI * k) / 6000;
    const x = area.left + area.width / 2 + 60 * Math.cos(turn), y = area.top + area.height / 2 + 60 * Math.sin(turn);
    return new PointerEvent("pointermove", { clientX: x, clientY: y });
  });
  canvas.dispatchEvent(new PointerEvent("pointermove", { coalescedEvents }));
}
"""


@pytest.mark.slow
async def test_a_drone_in_the_way_of_the_second_drone_that_flies_a_drawing_is_named(
    tmp_path,
):
    async with looked_at(tmp_path) as (page, wire, _):
        wire.frame = hovering({5: (0.25, 1.5, 1.3)})
        await page.click("#tab-draw")
        await page.fill("#height", "1.3")
        await page.fill("#offset_y", "1")
        await draw_word(page)
        await says(page, "#plan", "m/s²", 60.0)
        await page.check('input[aria-label="drone 0"]')
        assert "In the way" not in await says(page, "#plan", "m/s²")
        await page.check('input[aria-label="drone 1"]')
        assert "drone 5" in await says(page, "#plan", "In the way")
        await page.shot("beside")
        await page.fill("#offset_y", "-1")
        await page.dispatch_event("#offset_y", "change")
        await page.wait_for_function(
            "!document.querySelector('#plan').textContent.includes('In the way')"
        )


def hovering(places):
    """Frames in which drones are at these places; m, world."""

    def frame(data):
        rows = np.frombuffer(data, "<f4", offset=8).reshape(-1, COLUMNS).copy()
        for k, place in places.items():
            rows[k, 0:3] = place
        return data[:8] + rows.tobytes()

    return frame


@pytest.mark.slow
async def test_batteries_of_the_chosen_are_drawn_and_by_round_what_plans_cost_and_their_relaxations(
    tmp_path,
):
    async with looked_at(tmp_path) as (page, wire, _):
        await page.click("#tab-plots")
        await page.evaluate(WRITTEN)
        wire.news = {"costs": [[2, 33.4, 32.6], [30, 33.0, 32.6], [57, 32.9, 32.7]]}
        await page.wait_for_function(
            "written.has('round 57, 0.6 % above the relaxation')"
        )
        assert {"rounds 2 to 57", "32.60", "33.00", "33.40"} <= set(
            await page.evaluate("[...written]")
        )
        assert await page.is_visible(
            "text=mean cost of the plans, and of their relaxations (dashed), by round"
        )
        places = await page.evaluate("[...lines.at(-1)]")
        assert (
            abs((places[1] - places[0]) / (places[2] - places[0]) - 28 / 55) < 1e-6
        ), "a round is where its number is"
        wire.drones = charged
        await page.wait_for_function("written.has('3.50') && written.has('4.00')")
        assert {"drone 0", "drone 5", "no values"} <= set(
            await page.evaluate("[...written]")
        )
        await page.evaluate("written.clear(); choir.select([1])")
        await page.wait_for_function("written.has('drone 1')")
        assert "drone 0" not in await page.evaluate("[...written]")


def charged(rows):
    """Drones with batteries between 3.5 V and 4 V, and without a measured round trip."""
    return [row | {"heard": True, "battery": 4.0 - 0.1 * row["id"]} for row in rows]


@pytest.mark.slow
async def test_curves_have_the_time_of_their_samples_and_are_open_where_nothing_was_heard(
    tmp_path,
):
    async with looked_at(tmp_path) as (page, wire, _):
        await page.click("#tab-plots")
        await page.evaluate(WRITTEN)
        wire.frame = timed(0.0)
        await page.wait_for_timeout(2000)
        wire.frame = timed(10.0)
        await page.wait_for_function(
            "[...written].some(text => /^1[123456]\\.\\d s$/.test(text))"
        )
        places = await page.evaluate("lines.filter(line => line.length > 12).at(-1)")
        assert max(np.diff(places)) < 20, "one piece ends where the other begins"


def timed(later):
    """Frames of drones that hover, by a clock that is so much ahead, s."""

    def frame(data):
        (t,) = np.frombuffer(data, "<f8", 1)
        rows = np.zeros((6, COLUMNS), dtype="<f4")
        rows[:, 0:3] = (0.0, 0.0, 1.0)
        return np.float64(t + later).tobytes() + rows.tobytes()

    return frame


@pytest.mark.slow
async def test_routes_are_drawn_from_where_their_drones_are(tmp_path):
    async with looked_at(tmp_path) as (page, wire, _):
        wire.frame = hovering({1: (0.0, 0.0, 1.0)})
        await page.wait_for_timeout(1500)
        bare, tour = (
            await page.locator("#scene canvas").screenshot(),
            {"1": [[1.5, -1.5, 1.0], [-1.5, -1.5, 1.0]]},
        )
        wire.news = {"routes": tour}
        await page.wait_for_function("choir.seen.routes?.[1]")
        await page.wait_for_timeout(500)
        drawn = await page.locator("#scene canvas").screenshot(
            path=tmp_path / "routes.png"
        )
        assert drawn != bare
        wire.news = {"routes": {}}
        await page.wait_for_function("!choir.seen.routes[1]")
        await page.wait_for_timeout(500)
        assert await page.locator("#scene canvas").screenshot() == bare


WRITTEN = """
(() => {
  const fill = CanvasRenderingContext2D.prototype.fillText;
  const [move, to] = ["moveTo", "lineTo"].map((name) => CanvasRenderingContext2D.prototype[name]);
  window.written = new Set();
  window.lines = [];
  CanvasRenderingContext2D.prototype.moveTo = function (x, y) {
    lines.push([x]);
    return move.call(this, x, y);
  };
  CanvasRenderingContext2D.prototype.lineTo = function (x, y) {
    lines.at(-1).push(x);
    return to.call(this, x, y);
  };
  CanvasRenderingContext2D.prototype.fillText = function (text, ...at) {
    written.add(String(text));
    return fill.call(this, text, ...at);
  };
})()
"""


async def test_chosen_drone_flies_by_arrow_keys_and_gamepad_while_they_are_held(
    tmp_path,
):
    async with looked_at(tmp_path) as (page, wire, _):
        await page.wait_for_selector("#connection[data-there='true']")
        await page.focus("#stick")
        await page.keyboard.press("ArrowUp")
        await says(page, "header [role=alert]", "choose one drone")
        assert wire.of("steer") == []

        await page.check('input[aria-label="drone 2"]')
        await page.fill("#stick_speed", "0.4")
        await page.focus("#stick")
        await page.keyboard.down("ArrowUp")
        await page.keyboard.down("PageUp")
        await until(lambda: len(wire.of("steer")) > 4, 10.0)
        rising = {"ask": "steer", "drone": 2, "v": [0, 0.4, 0.4], "yaw_rate": 0}
        assert wire.of("steer")[-1] == rising
        await page.keyboard.up("PageUp")
        await page.keyboard.up("ArrowUp")
        still = {"ask": "steer", "drone": 2, "v": [0, 0, 0], "yaw_rate": 0}
        await until(lambda: wire.of("steer")[-1] == still, 5.0)
        count = len(wire.of("steer"))

        await page.keyboard.down("ArrowLeft")
        await until(lambda: wire.of("steer")[-1]["v"] == [-0.4, 0, 0], 5.0)
        await page.focus("#stick_speed")
        await until(lambda: wire.of("steer")[-1] == still, 5.0)
        await page.keyboard.up("ArrowLeft")

        await page.focus("#stick")
        await page.keyboard.down("ArrowRight")
        await until(lambda: wire.of("steer")[-1]["v"] == [0.4, 0, 0], 5.0)
        await page.keyboard.down("Meta")
        await until(lambda: wire.of("steer")[-1] == still, 5.0)
        await page.keyboard.up("ArrowRight")
        await page.keyboard.up("Meta")

        count = len(wire.of("steer"))
        await page.evaluate(
            """window.pad = { axes: [0.1, -1, 0.5, 0], buttons: Array(8).fill({ pressed: false }) };
            navigator.getGamepads = () => [null, pad]"""
        )
        await page.wait_for_timeout(300)
        assert len(wire.of("steer")) == count, "no shoulder button is held"
        await page.evaluate("pad.buttons = pad.buttons.with(5, { pressed: true })")
        await until(lambda: len(wire.of("steer")) > count + 2, 5.0)
        flown = {"ask": "steer", "drone": 2, "v": [0, 0.4, 0], "yaw_rate": -0.5}
        assert wire.of("steer")[-1] == flown
        await page.evaluate("pad.buttons = pad.buttons.with(5, { pressed: false })")
        await until(lambda: wire.of("steer")[-1] == still, 5.0)

        await page.evaluate("pad.buttons = pad.buttons.with(5, { pressed: true })")
        await until(lambda: wire.of("steer")[-1] == flown, 5.0)
        await page.evaluate("document.hasFocus = () => false")
        await until(lambda: wire.of("steer")[-1] == still, 5.0)
