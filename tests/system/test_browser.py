"""The page in a real browser, used as an operator would; what he sees is checked in the swarm, too."""

import asyncio

import numpy as np
import pytest
from system.agents import flying, until

for package in ("nicegui", "playwright", "axe_playwright_python"):
    pytest.importorskip(
        package,
        reason="the page in a browser needs: pip install 'crazychoir[dashboard,test]'",
    )

from axe_playwright_python.async_playwright import Axe  # noqa: E402 - see above
from system.browsers import CHROMIUM, TABS, Wire, browser, draw_word, receipt, says  # noqa: E402 - see above
from system.pages import dashboard, looking_on, six  # noqa: E402

PHONE = {"width": 390, "height": 844}
pytestmark = [
    pytest.mark.system,
    pytest.mark.real_time,
    pytest.mark.timeout(300),
    pytest.mark.skipif(
        CHROMIUM is None, reason="no chromium: apt-get install chromium"
    ),
]


def lost(team, since):
    """Share of messages that was lost since these statuses."""
    pairs = list(zip(team.newest(), since, strict=True))
    return sum(b["lost"] - a["lost"] for b, a in pairs) / max(
        sum(b["sent"] - a["sent"] for b, a in pairs), 1
    )


@pytest.mark.slow
async def test_six_take_off_and_one_flies_a_word_that_was_drawn_and_space_stops_all(
    tmp_path, compiled
):
    async with flying(six(), tmp_path) as team:
        program, address = await dashboard(team.path)
        try:
            async with browser(address, tmp_path) as page, looking_on(address) as seen:
                await page.wait_for_function(
                    "choir.seen.drones.every(drone => drone.phase === 'on ground')"
                )
                await page.click("text='Arm'")
                assert "done: ready" in await receipt(page, "ready")
                await page.click("text=Take off")
                assert "done: hovering" in await receipt(page, "hovering")
                await until(
                    lambda: (
                        {status["phase"] for status in team.newest()} == {"hovering"}
                    ),
                    20.0,
                )
                await page.shot("1_taken_off")

                await page.click("#tab-draw")
                await page.fill("#height", "1.6")
                await draw_word(page)
                await page.wait_for_function(
                    "document.querySelector('#plan').textContent.includes('m/s²')"
                )
                await page.shot("2_smoothed")
                assert "In the way" not in await page.inner_text("#plan")
                assert len(await page.evaluate("choir.sketch.strokes()")) == 4
                slower = float((await page.inner_text("#plan")).split()[0])
                await page.fill("#slower", "1.5")
                await page.dispatch_event("#slower", "change")
                text = f"{1.5 * slower:.1f}"[:-2]
                await page.wait_for_function(
                    "t => document.querySelector('#plan').textContent.startsWith(t)",
                    arg=text,
                )
                await page.fill("#slower", "1")
                await page.dispatch_event("#slower", "change")
                await page.wait_for_function(
                    "t => document.querySelector('#plan').textContent.startsWith(t)",
                    arg=f"{slower:g}",
                )

                await page.check('input[aria-label="drone 4"]')
                await page.click("text=Fly it with the chosen drones")
                way = []
                while not any(
                    r["verb"] == "fly" and r["answers"]["4"][0] == "done"
                    for r in seen.receipts.values()
                ):
                    way.append(seen.rows[4, 0:3].copy())
                    assert len(way) < 1200, seen.receipts
                    if len(way) == 200:
                        await page.evaluate(
                            "document.querySelector('#panel-draw').scrollTop = 60"
                        )
                        await page.shot("3_flying")
                    await asyncio.sleep(0.05)
                await page.click("#tab-fly")
                assert "4 done: flown" in await receipt(page, "flown")
                await page.shot("4_flown")
                strokes = await page.evaluate("choir.sketch.strokes()")
                drawn = np.array(
                    [[x, y, 1.6] for stroke in strokes for _, x, y in stroke]
                )
                away = np.linalg.norm(drawn[:, None] - np.array(way)[None], axis=2).min(
                    axis=1
                )
                assert away.max() < 0.15, f"{away.max():.2f} m beside what was drawn"

                await page.uncheck('input[aria-label="drone 4"]')
                before = team.newest()
                await page.click("#tab-network")
                await page.fill("#loss", "30")
                await page.click("text=Apply")
                await until(
                    lambda: lost(team, before) > 0.2,
                    30.0,
                    lambda: f"{lost(team, before)}",
                )
                await page.wait_for_function(
                    "choir.seen.drones.every(drone => drone.lost > 0.2 && drone.lost < 0.4)",
                    timeout=30_000,
                )
                assert await page.text_content("#network-said") == "loss 0.3, delay 0"
                await page.click("#tab-fly")
                assert "impair loss 0.3" in await receipt(page, "impair")
                await page.shot("5_loss")

                await page.click("#tab-draw")
                await page.focus("#height")
                await page.keyboard.press("Space")
                assert "emergency stop" in await says(
                    page, "header [role=alert]", "motors off"
                )
                assert "emergency stop" in await receipt(page, "motors off")
                await page.shot("6_stopped")
                await page.click("#tab-fly")
                await page.wait_for_function(
                    "choir.seen.drones.every(drone => drone.phase === 'stopped')"
                )
                assert {status["phase"] for status in team.newest()} == {"stopped"}
                await page.focus('input[aria-label="drone 2"]')
                await page.keyboard.press("Space")
                assert not await page.is_checked('input[aria-label="drone 2"]'), (
                    "space does nothing else"
                )
                stops = page.locator("#receipts li:has-text('emergency stop')")
                await stops.nth(1).wait_for()
                await page.shot("7_stopped")
        finally:
            await program.kill()


@pytest.mark.slow
async def test_a_task_is_added_by_clicks_on_the_floor_while_they_fly(
    tmp_path, compiled
):
    tables = {
        "mission_options": {"tasks": 6, "later": 0, "until": 60.0},
        "fence": {"min": [-3, -3, 0], "max": [7, 7, 3]},
    }
    async with flying(six("online_delivery", **tables), tmp_path) as team:
        program, address = await dashboard(team.path)
        try:
            async with browser(address, tmp_path, color_scheme="dark") as page:
                await page.wait_for_function(
                    "choir.seen.drones.every(drone => drone.task.includes('start'))",
                    timeout=60_000,
                )
                await page.click("text=Start")
                assert "its mission goes on" in await receipt(page, "goes on")
                await page.click("#tab-tasks")
                await page.wait_for_selector("#tasks li")
                await page.check("#placing")
                box = await page.locator("#scene canvas").bounding_box()
                for share in (0.4, 0.6):
                    await page.mouse.click(
                        box["x"] + share * box["width"], box["y"] + 0.6 * box["height"]
                    )
                    await asyncio.sleep(0.3)
                await page.wait_for_selector('[data-task^="1000"]', timeout=30_000)
                await page.shot("7_task")
                listed = await page.inner_text('[data-task^="1000"]')
                assert "load 1: open" in listed
                await page.wait_for_function(
                    "choir.seen.drones.some(drone => drone.task.includes('1 aboard'))",
                    timeout=60_000,
                )
                await page.shot("8_delivering")
                for name, metres in {
                    "pickup_x": 6,
                    "pickup_y": 6,
                    "delivery_x": -2,
                    "delivery_y": 6,
                }.items():
                    await page.fill(f"#{name}", str(metres))
                await page.click("text=Add task")
                last = "#tasks li:has-text('6.00, 6.00 → -2.00, 6.00 m')"
                await page.click(f"{last} button")
                await page.wait_for_selector(f"{last}:has-text('cancelled')")
        finally:
            await program.kill()


@pytest.mark.slow
async def test_it_fits_a_phone_is_labelled_and_axe_finds_no_serious_fault_in_any_tab(
    tmp_path, compiled
):
    async with flying(six(processes=1), tmp_path) as team:
        program, address = await dashboard(team.path)
        try:
            for scheme in ("light", "dark"):
                wire = Wire()
                async with browser(
                    address,
                    tmp_path,
                    wire,
                    viewport=PHONE,
                    color_scheme=scheme,
                    has_touch=True,
                ) as page:
                    wire.tell(console=CONSOLE_LINES)
                    for tab in TABS:
                        await page.click(f"#tab-{tab}")
                        if tab == "console":
                            await page.select_option("#console-drone", "1")
                            shown = await page.inner_text("#console")
                            assert "drone 1: SYS: up" in shown
                            assert "drone 2" not in shown
                        if tab == "parameters":
                            await page.fill("#parameter-filter", "led")
                            await says(page, "#parameters-said", "it has no firmware")
                            wire.tell(parameters=PARAMETERS)
                            await says(page, "#parameters tbody", "bitmask")
                        assert (
                            await page.evaluate("document.documentElement.scrollWidth")
                            <= PHONE["width"]
                        ), tab
                        assert await page.locator(f"#panel-{tab}").is_visible()
                        assert await find_faults(page, scheme, tab) == [], tab
                    await page.click("#tab-fly")
                    await page.shot(f"phone_{scheme}")
                    nameless = await page.evaluate(NAMELESS)
                    assert nameless == []
                    assert await page.evaluate(ALIKE) == []
                    assert await page.evaluate(CONTRASTS) == []
        finally:
            await program.kill()


PARAMETERS = {"drone": 0, "types": {"led.bitmask": ["uint8_t", True]}}
CONSOLE_LINES = [
    {"drone": i, "t": 0.0, "level": "info", "text": "firmware: SYS: up"} for i in (1, 2)
]
AXE_RULES = {"light": {}, "dark": {"runOnly": ["color-contrast"]}}
"""What axe-core looks for: in the light everything, in the dark what depends on colours."""


async def find_faults(page, scheme, tab):
    """Return the serious and critical accessibility faults that axe-core finds, and where.

    In the first tab it looks at the whole page, and in the others at the tab alone.
    """
    part = None if tab == TABS[0] else f"#panel-{tab}"
    options = {"resultTypes": ["violations"], **AXE_RULES[scheme]}
    found = await Axe().run(page, part, options)
    return [
        (fault["id"], [node["target"] for node in fault["nodes"]])
        for fault in found.response["violations"]
        if fault["impact"] in ("serious", "critical")
    ]


NAMELESS = """
[...document.querySelectorAll("button, input, select, canvas, [role=img]")].filter((one) => {
  const label = one.getAttribute("aria-label") || one.labels?.length || one.textContent.trim();
  return !label;
}).map((one) => one.outerHTML)
"""
ALIKE = """
[...document.querySelectorAll("[role=tabpanel]")].flatMap((panel) => {
  const controls = [...panel.querySelectorAll("button, input, select, canvas, [role=img]")];
  const name = (one) => one.getAttribute("aria-label") ?? one.labels?.[0]?.textContent ?? one.textContent.trim();
  const names = controls.map(name);
  return names.filter((name, k) => names.indexOf(name) !== k);
})
"""
CONTRASTS = """
(() => {
  const style = getComputedStyle(document.body), read = (name) => style.getPropertyValue(name).trim();
  const light = (hex) => {
    const full = hex.length === 4 ? [...hex.slice(1)].map((c) => c + c).join("") : hex.slice(1);
    const [r, g, b] = [0, 2, 4].map((k) => parseInt(full.slice(k, k + 2), 16) / 255)
      .map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const contrast = (a, b) => (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
  return ["--ink", "--faint", "--accent", "--good", "--warn", "--bad", "--rest"].filter((name) =>
    contrast(light(read(name)), light(read("--card"))) < 4.5);
})()
"""
