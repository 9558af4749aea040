"""The page in a real headless Chromium: drawn, sorted, turned, printed.

At the width of a phone and of a desk, in light and in dark.
"""

import base64
import re
import shutil
import time

import pytest
from report_cases import loop_report

from pysindy_nrf.report import available

webdriver = pytest.importorskip(
    "selenium.webdriver", reason="selenium is not installed"
)
BROWSERS = map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))
BROWSER = next(filter(None, BROWSERS), None)
DRIVER = shutil.which("chromedriver")
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(
        BROWSER is None or DRIVER is None,
        reason="chromium and chromedriver are not installed",
    ),
    pytest.mark.skipif(not available(), reason="the page needs the extra 'report'"),
]
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--enable-unsafe-swiftshader",
)
DESK, PHONE = (1280, 900), (375, 740)
TAB, ENTER = "\ue004", "\ue007"
ARROW_LEFT = "\ue012"

ALL_DRAWN = "return document.documentElement.dataset.drawn === 'all'"
DRAWN = (
    "const p = arguments[0].querySelector('svg.main-svg, canvas');"
    " return p && p.getBoundingClientRect().width > 100"
)
INTO_VIEW = "arguments[0].scrollIntoView({block: 'center'})"
WIDTHS = "return [document.documentElement.scrollWidth, window.innerWidth]"
OVERFLOWING = """
return [...document.querySelectorAll('main *')]
  .filter(e => !e.closest('.scroll, pre, .plot, .hidden'))
  .filter(e => e.getBoundingClientRect().right > window.innerWidth + 1)
  .map(e => e.outerHTML.slice(0, 80))
"""
BACKGROUND = (
    "return getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)"
)
EMPTY_PLOTS = (
    "return [...document.querySelectorAll('.plot:not(.turns)')]"
    ".filter(p => !p.querySelector('svg')).length"
)
CATCH_COPIES = (
    "Object.defineProperty(navigator, 'clipboard', {value: {writeText: t => {"
    " window.copied = t; return Promise.resolve(); }}})"
)
HAS_WEBGL = "return Boolean(document.createElement('canvas').getContext('webgl'))"
SHIFT = "return new DOMMatrix(getComputedStyle(arguments[0]).transform).e"
EYE = "const c = arguments[0]._fullLayout.scene.camera.eye; return [c.x, c.y, c.z]"


class Browser:
    """The page as a person sees it."""

    def __init__(self, driver, address):
        self.driver = driver
        self.address = address

    def open(self, size, scheme="light"):
        width, height = size
        self.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {
                "width": width,
                "height": height,
                "deviceScaleFactor": 1,
                "mobile": width < 600,
            },
        )
        feature = {"name": "prefers-color-scheme", "value": scheme}
        self.driver.execute_cdp_cmd(
            "Emulation.setEmulatedMedia", {"features": [feature]}
        )
        self.driver.get(self.address)
        self.run("document.documentElement.style.scrollBehavior = 'auto'")

    def run(self, script, *arguments):
        return self.driver.execute_script(script, *arguments)

    def wait(self, condition, seconds=60):
        """The value of a condition as soon as it is true."""
        end = time.monotonic() + seconds
        value = condition()
        while not value and time.monotonic() < end:
            time.sleep(0.1)
            value = condition()
        return value

    def find(self, selector):
        return self.driver.find_element("css selector", selector)

    def find_all(self, selector):
        return self.driver.find_elements("css selector", selector)

    def scroll_to(self, selector):
        """The first element of a kind, scrolled to and drawn."""
        place = self.find(selector)
        self.run(INTO_VIEW, place)
        assert self.wait(lambda: self.run(DRAWN, place)), f"{selector} is not drawn"
        return place

    def press(self, key):
        webdriver.ActionChains(self.driver).send_keys(key).perform()

    @property
    def errors(self):
        entries = self.driver.get_log("browser")
        return [entry["message"] for entry in entries if entry["level"] == "SEVERE"]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    loop_report().to_html(path)

    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    profile = tmp_path_factory.mktemp("profile")
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    service = webdriver.ChromeService(DRIVER)
    driver = webdriver.Chrome(options=options, service=service)
    driver.set_page_load_timeout(120)
    driver.set_script_timeout(60)
    yield Browser(driver, path.as_uri())
    driver.quit()


# -- drawn ---------------------------------------------------------------------

SIGHTS = pytest.mark.parametrize(
    ("size", "scheme"),
    [(DESK, "light"), (PHONE, "dark")],
    ids=["desk, light", "phone, dark"],
)


@pytest.mark.slow
def test_every_figure_is_drawn_without_an_error(browser):
    """Plane figures are drawn before anybody scrolls to them."""
    browser.open(PHONE, "dark")
    assert browser.wait(lambda: browser.run(ALL_DRAWN))
    places = browser.find_all(".plot")
    assert len(places) >= 12
    for place in places:
        browser.scroll_to(f"#{place.get_attribute('id')}")
    assert browser.errors == []


@SIGHTS
def test_nothing_overflows(browser, size, scheme):
    browser.open(size, scheme)
    needed, available_width = browser.run(WIDTHS)
    assert needed <= available_width == size[0]
    assert browser.run(OVERFLOWING) == []


@SIGHTS
def test_the_links_of_the_page_stand_in_one_line(browser, size, scheme):
    browser.open(size, scheme)
    assert browser.find("nav").size["height"] < 60


@SIGHTS
def test_the_background_follows_the_scheme(browser, size, scheme):
    browser.open(size, scheme)
    assert (sum(browser.run(BACKGROUND)) > 600) == (scheme == "light")


@pytest.mark.slow
def test_all_figures_are_printed_in_light(browser):
    """For the paper they are drawn anew."""
    browser.open(PHONE, "dark")
    assert browser.wait(lambda: browser.run(ALL_DRAWN))
    printed = browser.driver.execute_cdp_cmd(
        "Page.printToPDF", {"printBackground": True}
    )
    assert len(printed["data"]) > 50_000
    assert browser.run(EMPTY_PLOTS) == 0
    assert browser.errors == []


@pytest.mark.slow
def test_the_summary_is_one_page_of_paper(browser):
    browser.open(DESK)
    assert browser.wait(lambda: browser.run(ALL_DRAWN))
    browser.run("window.print = () => {}")
    browser.find("[data-print]").click()
    printed = browser.driver.execute_cdp_cmd("Page.printToPDF", {})
    pages = re.findall(rb"/Type\s*/Page\b", base64.b64decode(printed["data"]))
    assert len(pages) == 1


# -- used ----------------------------------------------------------------------


def test_the_keyboard_reaches_the_content(browser):
    browser.open(DESK)
    browser.press(TAB)
    focused = browser.run("return document.activeElement.textContent")
    assert focused == "Skip to the content"
    browser.press(ENTER)
    assert browser.wait(lambda: browser.run("return location.hash") == "#main")


@pytest.mark.slow
def test_modes_move_until_they_are_stopped(browser):
    """Stopped, they stand at their largest deflection."""
    browser.open(DESK)
    button, floor = browser.find("[data-move]"), browser.find(".mode rect")
    browser.run(INTO_VIEW, button)
    moving = browser.run(SHIFT, floor)
    assert browser.wait(lambda: browser.run(SHIFT, floor) != moving)
    button.click()
    assert button.text == "Move"
    largest = floor.get_attribute("style").removeprefix("--to: ").rstrip("px; ")
    assert browser.run(SHIFT, floor) == pytest.approx(float(largest))

    still = [{"name": "prefers-reduced-motion", "value": "reduce"}]
    browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": still})
    browser.driver.refresh()
    assert browser.find_all(".moving") == []


def column(table, number):
    """Numbers of a column, with all digits."""
    values = []
    for row in table.find_elements("css selector", "tbody tr"):
        cell = row.find_elements("css selector", "th, td")[number]
        values.append(float(cell.get_attribute("data-v") or cell.text))
    return values


@pytest.mark.slow
def test_a_table_is_sorted_by_mouse_and_by_key(browser):
    browser.open(DESK)
    table = browser.find("#measured table")
    buttons = table.find_elements("css selector", "button.sort")
    names = [button.text for button in buttons]
    number = next(k for k, name in enumerate(names) if name.startswith("peak"))
    peak, before = buttons[number], column(table, number)
    assert before != sorted(before)

    peak.click()
    assert column(table, number) == sorted(before)
    browser.run("arguments[0].focus()", peak)
    peak.send_keys(ENTER)
    assert column(table, number) == sorted(before, reverse=True)

    head = peak.find_element("xpath", "..")
    assert head.get_attribute("aria-sort") == "descending"
    assert "peak" in browser.find("#status").get_attribute("textContent")
    assert browser.errors == []


def test_a_table_is_copied_with_all_digits(browser):
    browser.open(DESK)
    browser.run(CATCH_COPIES)
    table = browser.find("#model .table")
    browser.run(INTO_VIEW, table)
    table.find_element("css selector", "[data-copy]").click()
    copied = browser.wait(lambda: browser.run("return window.copied || ''"))
    cells = [line.split("\t") for line in copied.splitlines()[1:]]
    assert [float(row[1]) for row in cells] == list(loop_report().model.masses)


@pytest.mark.slow
def test_a_surface_turns_by_drag_by_arrow_keys_and_by_buttons(browser):
    browser.open(PHONE)
    place = browser.scroll_to(".turns")
    if not browser.run(HAS_WEBGL):
        pytest.skip("this browser draws nothing in space (no WebGL)")

    def eye():
        return browser.run(EYE, place)

    start = browser.wait(eye)
    mouse = webdriver.ActionChains(browser.driver)
    drag = mouse.move_to_element(place).click_and_hold()
    for _ in range(5):
        drag = drag.move_by_offset(14, 6)
    drag.release().perform()
    assert browser.wait(lambda: eye() != start)

    dragged = eye()
    browser.run("arguments[0].focus()", place)
    browser.press(ARROW_LEFT)
    assert browser.wait(lambda: eye() != dragged)

    pressed = eye()
    browser.find("[data-turn=down]").click()
    assert browser.wait(lambda: eye()[2] < pressed[2])
    browser.find("[data-turn=home]").click()
    assert browser.wait(lambda: eye() == pytest.approx(start))
    assert browser.errors == []
