"""The application: names of files, the token, and the page in a real browser."""

import asyncio
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from newcomer import test_first_hour as newcomer

from pysindy_nrf.cli import run
from pysindy_nrf.cli.app.columns import NOT_USED, columns_of, mapping_file_text
from pysindy_nrf.cli.app.server import Guard
from pysindy_nrf.cli.app.window import Window, safe_name
from pysindy_nrf.exceptions import NRFError
from pysindy_nrf.records import read_mapping

HOSTILE = '--json ../<img src=x onerror=alert(1)>".csv'


# -- without a browser ---------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        HOSTILE,
        "../../etc/passwd",
        "C:\\x\\y.csv",
        "-o",
        "",
        ".",
        "mapping.toml",
        "ü 1.csv",
    ],
)
def test_a_name_stays_in_its_folder_and_is_no_option(name, tmp_path):
    safe = safe_name(name)
    assert (tmp_path / safe).parent == tmp_path
    assert safe and safe[0] not in "-.="
    assert not set('<>"\\/') & set(safe)
    assert safe != "mapping.toml"


def test_two_files_of_one_name_are_kept_apart():
    assert safe_name("a.csv", ["a.csv", "a-2.csv"]) == "a-3.csv"


@pytest.fixture
def in_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("in_folder")
def test_the_table_of_columns_writes_the_mapping_of_inspect():
    pytest.importorskip("pint")
    file = Path(newcomer.german())
    columns = columns_of([file])
    assert sorted(column.channel for column in columns) == sorted(
        ["t", "a1", "a2", "x1", "x2", "F2", NOT_USED]
    )
    assert all(len(column.line) > 50 for column in columns)
    Path("app.toml").write_text(mapping_file_text([file], columns, {"fs": None}))
    assert run(["inspect", str(file), "--write-mapping", "own.toml"]) == 0
    assert read_mapping("app.toml").channels == read_mapping("own.toml").channels


@pytest.mark.usefixtures("in_folder")
def test_what_cannot_be_read_is_an_error_in_words():
    Path("no.csv").write_text("nothing at all")
    with pytest.raises(NRFError):
        columns_of([Path("no.csv")])


@pytest.mark.usefixtures("in_folder")
def test_a_window_looks_at_its_files_and_takes_its_folder_along():
    pytest.importorskip("pint")
    window = Window()
    place = window.place_for(HOSTILE)
    shutil.move(newcomer.japanese_upside_down(), place)
    columns = columns_of([place])
    window.write_mapping(mapping_file_text([place], columns, {}))
    look = window.look()
    assert look.error == ""
    assert "256 Hz" in look.words
    assert window.command(["--known-mass", "1=8"]).endswith("--known-mass 1=8")
    window.close()
    assert not window.folder.exists()


def answered(guard, scope):
    """Status of the answer to one request, and its headers."""
    messages = []

    async def send(message):
        messages.append(message)

    async def receive():
        return {"type": "http.request"}

    asyncio.run(guard(scope, receive, send))
    first = messages[0]
    return first.get("status", first["type"]), dict(first.get("headers", []))


async def welcome(scope, receive, send):
    await send({"type": "http.response.start", "status": 200, "headers": []})
    await send({"type": "http.response.body", "body": b""})


def request(query=b"", host=b"127.0.0.1:8123", cookie=b"", kind="http"):
    headers = [(b"host", host), (b"cookie", cookie)]
    return {"type": kind, "query_string": query, "headers": headers}


def test_only_the_token_lets_in():
    guard = Guard(welcome, "secret", 8123)
    assert answered(guard, request())[0] == 403
    assert answered(guard, request(b"token=wrong"))[0] == 403
    status, headers = answered(guard, request(b"token=secret"))
    assert status == 200
    cookie = headers[b"set-cookie"].split(b";")[0]
    assert b"HttpOnly" in headers[b"set-cookie"]
    assert answered(guard, request(cookie=cookie))[0] == 200


def test_another_name_of_this_machine_has_no_way_in():
    guard = Guard(welcome, "secret", 8123)
    assert (
        answered(guard, request(b"token=secret", host=b"evil.example:8123"))[0] == 403
    )


def test_a_socket_without_the_token_is_closed():
    guard = Guard(welcome, "secret", 8123)
    assert answered(guard, request(kind="websocket"))[0] == "websocket.close"


def test_without_its_extra_the_command_names_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "nicegui", None)
    assert run(["app", "--no-browser"]) == 1
    assert "pysindy_nrf[app]" in capsys.readouterr().err


# -- in a browser --------------------------------------------------------------

BROWSER = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))),
    None,
)
DRIVER = shutil.which("chromedriver")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-dev-shm-usage",
)


@pytest.fixture(scope="module")
def address(tmp_path_factory):
    """The address of a running application."""
    pytest.importorskip("nicegui")
    folder = tmp_path_factory.mktemp("app")
    program = "from pysindy_nrf.cli import main; main()"
    root = str(Path(__file__).parents[3])
    path = os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])
    environment = {"PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}
    for name, value in os.environ.items():
        # NiceGUI takes tests of its own for ours where it sees pytest
        if not name.startswith("PYTEST"):
            environment.setdefault(name, value)
    server = subprocess.Popen(
        [sys.executable, "-c", program, "app", "--no-browser"],
        cwd=folder,
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
    )
    line = server.stdout.readline()
    yield re.search(r"http://\S+", line)[0]
    server.send_signal(signal.SIGINT)
    server.wait(30)


@pytest.fixture(scope="module")
def driver(tmp_path_factory):
    webdriver = pytest.importorskip("selenium.webdriver")
    if BROWSER is None or DRIVER is None:
        pytest.skip("chromium and chromedriver are not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = BROWSER
    profile = tmp_path_factory.mktemp("profile")
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=webdriver.ChromeService(DRIVER))
    driver.set_window_size(1280, 900)
    yield driver
    driver.quit()


class Person:
    """Somebody in front of one window of the application."""

    def __init__(self, driver, address):
        self.driver = driver
        self.clicks = 0
        driver.get(address)
        self.wait("input[type=file]")

    def find(self, selector):
        return self.driver.find_elements("css selector", selector)

    def wait(self, selector, seconds=120):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            for element in self.find(selector):
                if element.tag_name == "input" or element.is_displayed():
                    return element
            time.sleep(0.1)
        raise AssertionError(f"{selector} did not appear: {self.text}")

    @property
    def text(self):
        return self.driver.find_element("css selector", "body").text

    def drop(self, *files):
        self.find("input[type=file]")[0].send_keys("\n".join(map(str, files)))
        self.clicks += 1
        self.wait("[data-what=run]")

    def click(self, what):
        button = self.wait(f"[data-what={what}]")
        self.driver.execute_script("arguments[0].scrollIntoView()", button)
        time.sleep(0.3)
        button.click()
        self.clicks += 1

    @property
    def errors(self):
        entries = self.driver.get_log("browser")
        return [entry["message"] for entry in entries if entry["level"] == "SEVERE"]


# The command line is tested with all vendors; one of each kind of file is here.
VENDORS = [
    newcomer.german,
    newcomer.excel,
    newcomer.tdms,
    newcomer.matlab,
]


@pytest.mark.browser
@pytest.mark.usefixtures("in_folder")
@pytest.mark.parametrize("vendor", VENDORS)
def test_a_dropped_file_gets_the_verdict_of_run(vendor, address, driver, capsys):
    pytest.importorskip("pint")
    file = Path(vendor()).resolve()
    person = Person(driver, address)
    person.drop(file)
    person.click("run")
    shown = person.wait("[data-what=verdict]").text
    assert person.clicks <= 6
    assert person.errors == []

    assert run(["inspect", str(file), "--write-mapping", "own.toml"]) == 0
    capsys.readouterr()
    code = run(["run", "--mapping", "own.toml", "--json", "--no-figures"])
    verdict = json.loads(capsys.readouterr().out)["verdict"]
    assert verdict["sentence"] in shown
    words = {"green": "Can be used", "amber": "Use with care", "red": "Not to be used"}
    assert words[verdict["state"]] in shown
    assert (code == 4) == (verdict["state"] == "red")
    person.wait("iframe.report")


@pytest.mark.browser
@pytest.mark.usefixtures("in_folder")
def test_a_hostile_name_is_text(address, driver):
    pytest.importorskip("pint")
    hostile = Path("<img src=x onerror=alert(1)>.csv")
    shutil.move(newcomer.american(), hostile)
    person = Person(driver, address)
    person.drop(hostile.resolve())
    assert person.find("img[src=x]") == []
    assert person.errors == []


@pytest.mark.browser
@pytest.mark.usefixtures("in_folder")
def test_files_of_one_test_are_joined(address, driver):
    """Forces in one file, accelerations in another."""
    pytest.importorskip("pint")
    test = newcomer.shaken()
    forces = pd.DataFrame({"t": test.time, "F2": test.force[:, 1]})
    forces.to_csv("forces.csv", index=False)
    motions = pd.DataFrame(test.acceleration, columns=["a1", "a2"])
    motions.insert(0, "t", test.time)
    motions.to_csv("motions.csv", index=False)
    person = Person(driver, address)

    person.drop(Path("forces.csv").resolve(), Path("motions.csv").resolve())
    person.wait("[data-what=together]")
    person.click("together")
    driver.find_element("xpath", "//*[text()='channels of one test']").click()

    end = time.monotonic() + 60
    while "Nothing looks wrong" not in person.text and time.monotonic() < end:
        time.sleep(0.3)
    assert "motions.a1" in person.text
    person.click("run")
    person.wait("iframe.report")
    assert person.errors == []


@pytest.mark.browser
@pytest.mark.usefixtures("in_folder")
def test_two_windows_do_not_know_each_other(address, driver):
    pytest.importorskip("pint")
    first, second = Path(newcomer.american()), Path(newcomer.suffixes())
    person = Person(driver, address)
    person.drop(first.resolve())
    window = driver.current_window_handle
    driver.switch_to.new_window("tab")
    other = Person(driver, address)
    other.drop(second.resolve())
    assert "logger" in other.text
    assert "test 7" not in other.text
    driver.close()
    driver.switch_to.window(window)
    assert "test 7" in person.text
    assert "logger" not in person.text


@pytest.mark.browser
@pytest.mark.usefixtures("in_folder")
def test_a_run_is_stopped_and_started_again(address, driver):
    pytest.importorskip("pint")
    person = Person(driver, address)
    person.drop(Path(newcomer.german()).resolve())
    person.click("run")
    person.click("stop")
    assert "Stopped" in person.wait("[data-what=verdict]").text
    assert person.find("iframe.report") == []
    person.click("run")
    end = time.monotonic() + 120
    while "friction" not in person.text and time.monotonic() < end:
        time.sleep(0.3)
    assert "friction" in person.text
    assert person.errors == []


@pytest.mark.browser
@pytest.mark.slow
@pytest.mark.usefixtures("in_folder")
def test_two_hundred_megabytes_are_taken(address, driver):
    rng = np.random.default_rng(0)
    n = 3_200_000
    test = newcomer.shaken()
    repeats = -(-n // test.n_samples)
    columns = np.column_stack(
        [
            np.tile(test.force[:, 1], repeats)[:n],
            np.tile(test.acceleration, (repeats, 1))[:n],
        ]
    )
    columns += rng.normal(scale=1e-6, size=columns.shape)
    with open("large.csv", "w") as file:
        file.write("t,F2,a1,a2\n")
        times = np.arange(n) / 256.0
        np.savetxt(file, np.column_stack([times, columns]), fmt="%.9g", delimiter=",")
    large = Path("large.csv").resolve()
    assert large.stat().st_size > 130_000_000
    person = Person(driver, address)
    person.drop(large)
    end = time.monotonic() + 180
    while "Nothing looks wrong" not in person.text and time.monotonic() < end:
        time.sleep(0.5)
    assert "Nothing looks wrong" in person.text or "Take care" in person.text
    person.click("run")
    person.click("stop")
    assert "Stopped" in person.wait("[data-what=verdict]").text


@pytest.mark.browser
def test_nobody_without_the_token_is_let_in(address):
    base = address.partition("?")[0]
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(base)
    assert refused.value.code == 403
    assert urllib.request.urlopen(address).status == 200
