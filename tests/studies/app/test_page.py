"""The page in a browser: from logs to a checked and exported controller, in two windows, over a server that is killed."""

import subprocess
import sys

import pytest

from tests.studies.app.conftest import record
from tests.workbench.report.browser import CHROMIUM, FLAGS

pytestmark = [pytest.mark.slow, pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")]
MOST_CLICKS = 15
SECONDS = 90_000  # ms that a command may take beside other tests


class Bench:
    """`workbench app` on a folder, and what it has printed as its address."""

    def __init__(self, folder):
        words = [sys.executable, "-m", "studies.cli", "app", str(folder), "--no-browser"]
        self.process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        self.address = next(line.split()[1] for line in self.process.stdout if line.startswith("open:"))

    def end(self):
        self.process.kill()
        self.process.stdout.close()
        self.process.wait()


@pytest.fixture
def bench(tmp_path):
    own = Bench(tmp_path / "session")
    yield own
    own.end()


@pytest.fixture
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        yield found
        found.close()


class Window:
    """A page that counts clicks and keeps what went wrong in it."""

    def __init__(self, browser, address, width=1280, height=800):
        self.page = browser.new_page(viewport={"width": width, "height": height})
        self.wrong, self.clicks = [], 0
        self.page.on("pageerror", lambda reason: self.wrong.append(str(reason)))
        self.page.on("console", lambda said: self.wrong.append(said.text) if said.type == "error" else None)
        self.page.goto(address)

    def click(self, selector):
        self.clicks += 1
        self.page.click(selector, timeout=SECONDS)

    def say(self, channel, role):
        self.clicks += 1
        self.page.select_option(f"[aria-label='role of {channel}']", role)
        self.sees(f"[aria-label='role of {channel}']", value=role)

    def sees(self, selector, text=None, value=None):
        from playwright.sync_api import expect

        place = expect(self.page.locator(selector))
        place.to_have_value(value, timeout=SECONDS) if text is None else place.to_have_text(text, timeout=SECONDS)

    def sees_part(self, selector, text):
        from playwright.sync_api import expect

        expect(self.page.locator(selector)).to_contain_text(text, timeout=SECONDS)

    def run(self, stage, word):
        """Go to a stage, press its button, and wait for what it says."""
        self.click(f"#stages a[href='#{stage}']")
        self.click("#go")
        self.sees("#word", word)


def test_from_logs_to_a_checked_controller(tmp_path, bench, browser):
    logs = [str(record(tmp_path / f"{name}.csv", seed, 1500)) for name, seed in (("a", 1), ("b", 2), ("c", 3))]
    window = Window(browser, bench.address)
    assert "token" not in window.page.url
    window.clicks += 1
    window.page.set_input_files("#pick", logs)
    window.sees("#word", "Done")
    window.say("U", "input")
    window.say("n", "output")
    window.run("model", "Done")
    window.click("#stages a[href='#machine']")
    window.click("text=Guess from the records")
    window.page.wait_for_selector("#go:enabled", timeout=SECONDS)
    window.run("diagnosis", "Done")

    other = Window(browser, bench.address, 390, 844)  # a second window, as narrow as a phone, sees the same
    other.page.click("#stages a[href='#diagnosis']")
    other.sees("#word", "Done")
    assert other.page.locator("body").bounding_box()["width"] <= 390
    assert not other.wrong

    window.run("controller", "Done")
    window.sees_part("#sketched", "keep these bounds")
    before = window.page.inner_text("#sketched")
    window.page.locator("#controller-effort").fill("6")  # a slider that is dragged redraws margins, Nyquist curves and steps
    window.page.wait_for_selector(f"#sketched:not(:text-is('{before}'))", timeout=SECONDS)
    assert window.page.locator("#sketch svg").count() == 3
    window.click("#stages a[href='#check']")
    window.click("text=Guess from the records")
    window.page.select_option("#check-plant", "")
    window.click("#go")
    window.page.wait_for_selector("#word >> text=/^(Kept|Not decided)$/", timeout=SECONDS)
    assert window.clicks <= MOST_CLICKS
    frame = window.page.frame_locator("iframe")
    assert frame.locator("h1").inner_text(timeout=SECONDS).startswith("Check of")
    window.run("export", "Done")
    assert list((tmp_path / "session").glob("*-export/*.c"))
    assert not window.wrong


def test_a_run_survives_the_server_and_is_stopped_from_a_new_page(tmp_path, bench, browser):
    record(bench_records(tmp_path) / "a.csv", 1, 3000)
    window = Window(browser, bench.address)
    window.run("logs", "Done")
    window.say("U", "input")
    window.say("n", "output")
    window.click("#stages a[href='#model']")
    window.page.select_option("#model-kind", "hammerstein")
    window.click("#go")
    window.sees("#word", "Running")
    bench.end()
    again = Bench(tmp_path / "session")
    try:
        second = Window(browser, again.address)
        second.click("#stages a[href='#model']")
        second.sees("#word", "Running")
        second.click("text=Stop")
        second.sees("#word", "Stopped")
        second.page.reload()
        second.click("#stages a[href='#model']")
        second.sees("#word", "Stopped")
        assert not second.wrong
    finally:
        again.end()


def bench_records(tmp_path):
    return tmp_path / "session" / "records"
