"""The page in a real headless Chromium: drawn, sorted, turned, at phone and desk width,
in light and dark.
"""

import shutil
import time

import pytest
from report_cases import loop_report

from pysindy_nrf.report import available

webdriver = pytest.importorskip(
    "selenium.webdriver", reason="selenium is not installed"
)
BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
    None,
)
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


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    driver.set_page_load_timeout(120)
    driver.set_script_timeout(60)
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "report.html"
    loop_report().to_html(path)
    return path.as_uri()


def opened(browser, address, size, scheme="light"):
    metrics = {
        "width": size[0],
        "height": size[1],
        "deviceScaleFactor": 1,
        "mobile": size[0] < 600,
    }
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    media = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    browser.get(address)
    browser.execute_script("document.documentElement.style.scrollBehavior = 'auto'")


def until(condition, seconds=60):
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.1)
    return condition()


def shown(browser, selector):
    """The first element of a kind, scrolled to and drawn."""
    place = browser.find_element("css selector", selector)
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", place)
    drawn = (
        "const p = arguments[0].querySelector('svg.main-svg, canvas'); return p &&"
        " p.getBoundingClientRect().width > 100"
    )
    assert until(lambda: browser.execute_script(drawn, place)), (
        f"{selector} was not drawn"
    )
    return place


def errors(browser):
    return [
        entry["message"]
        for entry in browser.get_log("browser")
        if entry["level"] == "SEVERE"
    ]


def eye(browser, place):
    return browser.execute_script(
        "const c = arguments[0]._fullLayout.scene.camera.eye; return [c.x, c.y, c.z]",
        place,
    )


def column(table, k):
    return [
        (cell := row.find_elements("css selector", "th, td")[k]).get_attribute("data-v")
        or cell.text
        for row in table.find_elements("css selector", "tbody tr")
    ]


@pytest.mark.parametrize(
    ("size", "scheme"),
    [(DESK, "light"), (PHONE, "dark")],
    ids=["desk, light", "phone, dark"],
)
def test_every_figure_is_drawn_without_an_error_and_nothing_overflows_and_print_is_light(
    browser, address, size, scheme
):
    """Plane figures are drawn before anybody scrolls to them."""
    opened(browser, address, size, scheme)
    assert until(
        lambda: browser.execute_script(
            "return document.documentElement.dataset.drawn === 'all'"
        )
    )
    places = browser.find_elements("css selector", ".plot")
    assert len(places) >= 12
    for place in places:
        shown(browser, f"#{place.get_attribute('id')}")
    assert errors(browser) == []
    wide = "return [document.documentElement.scrollWidth, window.innerWidth]"
    needed, given = browser.execute_script(wide)
    assert needed <= given == size[0]
    out = """return [...document.querySelectorAll('main *')].filter(e => !e.closest('.scroll, pre, .plot, .hidden')
        && e.getBoundingClientRect().right > window.innerWidth + 1).map(e => e.outerHTML.slice(0, 80))"""
    assert browser.execute_script(out) == []
    light = browser.execute_script(
        "return"
        " getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)"
    )
    assert (sum(light) > 600) == (scheme == "light")
    if scheme == "dark":  # for the paper all figures are drawn anew, in light
        pdf = browser.execute_cdp_cmd("Page.printToPDF", {"printBackground": True})[
            "data"
        ]
        assert len(pdf) > 50_000 and errors(browser) == []
    empty = (
        "return [...document.querySelectorAll('.plot:not(.turns)')].filter(p =>"
        " !p.querySelector('svg')).length"
    )
    assert browser.execute_script(empty) == 0


def test_the_keyboard_reaches_the_content_and_a_table_is_sorted_and_copied_with_all_digits(
    browser, address
):
    opened(browser, address, DESK)
    webdriver.ActionChains(browser).send_keys("\ue004").perform()  # Tab
    assert (
        browser.execute_script("return document.activeElement.textContent")
        == "Skip to the content"
    )
    webdriver.ActionChains(browser).send_keys("\ue007").perform()
    assert until(lambda: browser.execute_script("return location.hash") == "#main")
    table = browser.find_element("css selector", "#measured table")
    peak = next(
        b
        for b in table.find_elements("css selector", "button.sort")
        if b.text.startswith("peak")
    )
    k = [b.text for b in table.find_elements("css selector", "button.sort")].index(
        peak.text
    )
    before = [float(x) for x in column(table, k)]
    assert before != sorted(before)
    peak.click()
    assert [float(x) for x in column(table, k)] == sorted(before)
    browser.execute_script("arguments[0].focus()", peak)
    peak.send_keys("\ue007")  # Enter
    assert [float(x) for x in column(table, k)] == sorted(before, reverse=True)
    head = peak.find_element("xpath", "..")
    assert head.get_attribute("aria-sort") == "descending"
    assert "peak" in browser.find_element("id", "status").get_attribute("textContent")
    assert len(column(table, 0)) == len(before) and errors(browser) == []
    catch = (
        "Object.defineProperty(navigator, 'clipboard', {value: {writeText: t => {"
        " window.copied = t; return Promise.resolve(); }}})"
    )
    browser.execute_script(catch)
    table = browser.find_element("css selector", "#model .table")
    browser.execute_script("arguments[0].scrollIntoView({block: 'center'})", table)
    table.find_element("css selector", "[data-copy]").click()
    lines = until(
        lambda: browser.execute_script("return window.copied || ''")
    ).splitlines()
    masses = loop_report().model.masses
    assert [float(line.split("\t")[1]) for line in lines[1:]] == list(masses)


def test_a_surface_turns_by_drag_by_arrow_keys_and_by_buttons(browser, address):
    opened(browser, address, PHONE)
    place = shown(browser, ".turns")
    if not browser.execute_script(
        "return Boolean(document.createElement('canvas').getContext('webgl'))"
    ):
        pytest.skip("this browser draws nothing in space (no WebGL)")
    start = until(lambda: eye(browser, place))
    drag = webdriver.ActionChains(browser).move_to_element(place).click_and_hold()
    for _ in range(5):
        drag = drag.move_by_offset(14, 6)
    drag.release().perform()
    assert until(lambda: eye(browser, place) != start)
    dragged = eye(browser, place)
    browser.execute_script("arguments[0].focus()", place)
    webdriver.ActionChains(browser).send_keys("\ue012").perform()  # left arrow
    assert until(lambda: eye(browser, place) != dragged)
    pressed = eye(browser, place)
    browser.find_element("css selector", "[data-turn=down]").click()
    assert until(lambda: eye(browser, place)[2] < pressed[2])
    browser.find_element("css selector", "[data-turn=home]").click()
    assert (
        until(lambda: eye(browser, place) == pytest.approx(start))
        and errors(browser) == []
    )
