"""The page that shows clouds, in Chromium without a window: files dropped, made denser, compared, measured and saved.

Needs a Chromium as test_page.py does. DENSECLOUD_SCREENSHOTS names a folder that pictures of the page are left in.
"""

import io
import json
import os
import pathlib
import re
import subprocess

import numpy as np
import pytest
from PIL import Image

from conftest import PROGRAM, serving

playwright = pytest.importorskip("playwright.sync_api")
from test_page import CHROMIUM, PATIENCE  # noqa: E402

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
# Drawn by the processor: it draws the same everywhere.
DRAWING = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SIZES = {"desktop": (1200, 800, "light"), "phone": (390, 844, "dark")}


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=DRAWING)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    with serving("--data-dir", tmp_path_factory.mktemp("jobs"), "--max-points-in", 2_000_000) as address:
        yield f"http://{address}"


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    """2,500 coloured points of a knot, and their file."""
    folder = tmp_path_factory.mktemp("scan")
    plain, coloured = folder / "plain.xyz", folder / "scan.ply"
    subprocess.run([PROGRAM, "sample", "shape:knot", plain, "--points", "2500"], check=True)
    points = np.loadtxt(plain)
    shares = (points - points.min(axis=0)) / np.ptp(points, axis=0)
    row = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
    rows = np.zeros(len(points), row)
    for name, column in zip("xyz", points.T, strict=True):
        rows[name] = column
    for name, column in zip(["red", "green", "blue"], shares.T, strict=True):
        rows[name] = 255 * column
    kinds = {"<f4": "float", "u1": "uchar"}
    properties = "".join(f"property {kinds[kind]} {name}\n" for name, kind in row)
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(rows)}\n{properties}end_header\n"
    coloured.write_bytes(head.encode() + rows.tobytes())
    return coloured


def until(page, condition):
    """Waits for a condition of the page's own; the browser's waiting for it would be against the page's policy."""
    for _ in range(PATIENCE // 50):
        if page.evaluate(condition):
            return
        page.wait_for_timeout(50)
    raise AssertionError(condition)


class Page:
    """The page in a browser; what it asked of whom, and what the browser said to it."""

    def __init__(self, browser, address, size="desktop", fragment=""):
        width, height, scheme = SIZES[size]
        self.context = browser.new_context(
            viewport={"width": width, "height": height}, color_scheme=scheme, accept_downloads=True
        )
        self.page = self.context.new_page()
        self.page.set_default_timeout(PATIENCE)
        self.asked, self.complaints = [], []
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", self._console)
        self.address = address
        self.page.goto(f"{address}/{fragment}")
        # All choices are there once the server has told of itself.
        until(self.page, "document.getElementById('format').options.length > 2")

    def _console(self, message):
        # The browser itself tells of every answer that is an error.
        if message.type == "error" and "Failed to load resource" not in message.text:
            self.complaints.append(message.text)

    def open(self, path):
        self.page.set_input_files("#file", path)
        self.page.wait_for_selector("#go:enabled")

    def upsample(self, ratio=4):
        self.page.fill("#ratio", str(ratio))
        self.page.click("#go")
        self.page.wait_for_selector("#compare:not([hidden])")
        self.page.wait_for_selector("#stop", state="hidden")

    def drawn(self, count):
        """Waits until so many points are on the screen."""
        until(self.page, f"document.getElementById('drawn').textContent.replace(/\\D/g, '') === '{count}'")

    def compare(self, comparison):
        self.page.locator(f"label:has([value={comparison}])").click()

    def picture(self):
        """The part of the page that clouds are drawn in, as an array."""
        shot = self.page.locator("#canvas").screenshot()
        return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), dtype=int)

    def covered(self):
        """The share of the picture that is not ground."""
        picture = self.picture()
        return (np.abs(picture - picture[-1, 0]).sum(axis=2) > 40).mean()

    def saved(self):
        with self.page.expect_download() as download:
            self.page.click("#download")
        return download.value.suggested_filename, pathlib.Path(download.value.path()).read_bytes()

    def close(self, name=None):
        folder = os.environ.get("DENSECLOUD_SCREENSHOTS")
        if folder and name:
            pathlib.Path(folder).mkdir(parents=True, exist_ok=True)
            self.page.screenshot(path=f"{folder}/{name}.png")
        width = self.page.viewport_size["width"]
        assert self.page.evaluate("document.documentElement.scrollWidth") <= width, "nothing sticks out"
        assert self.page.evaluate("[scrollY, document.documentElement.scrollTop]") == [0, 0], "only the panel scrolls"
        self.context.close()
        assert not [url for url in self.asked if not url.startswith((self.address, f"blob:{self.address}"))]
        assert not self.complaints


@pytest.fixture(params=list(SIZES))
def page(request, browser, server):
    page = Page(browser, server, request.param)
    yield page
    page.close(request.node.name)


@pytest.fixture
def desktop(request, browser, server):
    page = Page(browser, server)
    yield page
    page.close(request.node.name)


def test_a_file_is_seen_made_denser_compared_and_saved(page, scan, upsample, tmp_path):
    page.open(scan)
    page.drawn(2500)
    assert "10\u202f000 points" in page.page.inner_text("#estimate")
    assert page.covered() > 0.02
    page.upsample()
    page.drawn(12_500)
    pictures = {}
    for comparison in ["before", "after", "side", "slider"]:
        page.compare(comparison)
        page.drawn({"before": 2500, "after": 10_000}.get(comparison, 12_500))
        pictures[comparison] = page.picture()
    for one, other in [("before", "after"), ("after", "slider"), ("slider", "side")]:
        assert (pictures[one] != pictures[other]).any(axis=2).mean() > 0.005, (one, other)
    # The slider's left half is before, its right half after.
    before, after, both = (pictures[name] for name in ["before", "after", "slider"])
    middle = both.shape[1] // 2
    # Both lie at the same place.
    grounds = [np.abs(picture - picture[-1, 0]).sum(axis=2) < 40 for picture in (before, after)]
    shared = (~grounds[0] & ~grounds[1]).sum() / (~grounds[0] | ~grounds[1]).sum()
    assert shared > 0.8, shared
    for there, one in [(np.s_[60:-60, : middle - 40], before), (np.s_[60:-60, middle + 40 :], after)]:
        assert (both[there] == one[there]).all(axis=2).mean() > 0.99
    name, saved = page.saved()
    upsample(scan, tmp_path / "here.ply", "--ratio", 4)
    assert name == "scan-dense.ply"
    assert saved == (tmp_path / "here.ply").read_bytes()


def test_a_dropped_file_is_opened(desktop, scan):
    numbers = list(scan.read_bytes())
    desktop.page.evaluate(
        """numbers => {
          const files = new DataTransfer();
          files.items.add(new File([Uint8Array.from(numbers)], "dropped.ply"));
          document.dispatchEvent(new DragEvent("drop", { dataTransfer: files, bubbles: true, cancelable: true }));
        }""",
        numbers,
    )
    desktop.drawn(2500)
    assert desktop.page.inner_text("#title") == "dropped.ply"


def test_points_are_coloured_by_what_they_have(desktop, scan):
    desktop.open(scan)
    desktop.page.click("summary")
    desktop.page.check("#confidence")
    desktop.page.check("#normals")
    desktop.upsample()
    desktop.drawn(12_500)
    names = desktop.page.eval_on_selector_all("#colouring option", "all => all.map(one => one.value)")
    assert set(names) == {"rgb", "height", "normal", "confidence", "distance", "plain"}
    pictures = []
    for name in names:
        desktop.page.select_option("#colouring", name)
        if name == "distance":
            desktop.page.wait_for_selector("#legend canvas")
        desktop.drawn(12_500)
        desktop.page.wait_for_timeout(300)
        pictures.append(desktop.picture())
    for i, one in enumerate(pictures):
        for other in pictures[:i]:
            assert (one != other).any(axis=2).mean() > 0.01
    desktop.page.select_option("#colouring", "distance")
    least, greatest = desktop.page.inner_text("#legend .ends").split()
    assert float(least) == 0
    assert 0 < float(greatest) < 0.1


def test_any_format_can_be_saved_and_a_box_cuts(desktop, scan, inspect, tmp_path):
    desktop.open(scan)
    desktop.page.click("#box")
    desktop.page.fill("#box-3", "500")
    for kind, ending in [("application/vnd.laszip", "laz"), ("text/csv", "csv"), ("model/e57", "e57")]:
        desktop.page.select_option("#format", kind)
        name, saved = desktop.saved()
        assert name == f"scan.{ending}"
        (tmp_path / name).write_bytes(saved)
        told = inspect(tmp_path / name)
        assert 500 < told["points"] < 2000, told
    desktop.page.click("#box")
    name, saved = desktop.saved()
    (tmp_path / name).write_bytes(saved)
    assert inspect(tmp_path / name)["points"] == 2500


def test_a_distance_is_measured(desktop, tmp_path):
    corners = tmp_path / "corners.xyz"
    rows = [(x, y, 0) for x in np.linspace(0, 10, 41) for y in np.linspace(0, 10, 41)]
    corners.write_text("".join(f"{x} {y} {z}\n" for x, y, z in rows))
    desktop.open(corners)
    desktop.drawn(1681)
    desktop.page.click("#measure")
    # Seen from one corner, that is the lowest on the page, and the one across is the highest.
    picture = desktop.picture()
    rows, columns = np.nonzero(np.abs(picture - picture[-1, 0]).sum(axis=2) > 40)
    # Without what is written in the corners.
    inside = (np.abs(columns / picture.shape[1] - 0.5) < 0.2) & (rows > 60)
    rows, columns = rows[inside], columns[inside]
    for end in [rows.argmax(), rows.argmin()]:
        place = {"x": int(columns[end]), "y": int(rows[end])}
        desktop.page.locator("#canvas").click(position=place)
    told = desktop.page.inner_text("#measure-told")
    assert told.startswith("14.142 apart"), told
    assert desktop.page.inner_text("#measured") == "14.142"


def test_a_link_keeps_the_view(browser, server, scan):
    first = Page(browser, server)
    first.open(scan)
    first.upsample()
    first.page.focus("#canvas")
    for key in ["ArrowLeft", "ArrowLeft", "ArrowUp", "+"]:
        first.page.keyboard.press(key)
    first.page.select_option("#colouring", "height")
    first.compare("after")
    first.page.click("#link")
    until(first.page, "location.hash.includes('job=')")
    fragment = first.page.evaluate("location.hash")
    first.drawn(10_000)
    seen = first.picture()
    first.close()
    second = Page(browser, server, fragment=fragment)
    second.drawn(10_000)
    assert second.page.input_value("#colouring") == "height"
    same = (np.abs(second.picture() - seen).sum(axis=2) < 30).mean()
    assert same > 0.97, same
    second.close()


def test_a_million_points_are_shown_within_the_budget(desktop, tmp_path):
    rng = np.random.default_rng(1)
    directions = rng.normal(size=(1_000_000, 3))
    points = directions / np.linalg.norm(directions, axis=1)[:, None] * 5 + [4e5, 5e6, 100]
    np.save(tmp_path / "million.npy", points)
    desktop.open(tmp_path / "million.npy")
    desktop.drawn(1_000_000)
    assert desktop.covered() > 0.1
    assert re.search("Points\\s+1\u202f000\u202f000", desktop.page.inner_text("#facts"))


def test_a_broken_file_is_told_with_its_line_and_the_page_goes_on(page, scan, tmp_path):
    broken = tmp_path / "broken.xyz"
    broken.write_text("1 2 3\n4 five 6\n")
    page.page.set_input_files("#file", broken)
    page.page.locator("#error", has_text="line 2").wait_for()
    assert page.page.is_visible("#drop")
    page.open(scan)
    page.drawn(2500)
    assert page.page.is_hidden("#error")


def test_jobs_are_listed_and_opened_again(browser, server, scan):
    first = Page(browser, server)
    first.open(scan)
    first.upsample(2)
    first.close()
    second = Page(browser, server)
    row = second.page.locator("#jobs li", has_text="2\u202f500 to 5\u202f000 points").first
    row.get_by_role("button", name="Show").click()
    second.drawn(5000)
    row.get_by_role("button", name="Forget").click()
    second.close()


def test_a_server_that_goes_away_is_told_and_found_again(browser, scan, tmp_path):
    folder = tmp_path / "jobs"
    with serving("--data-dir", folder) as address:
        port = address.rsplit(":", 1)[1]
        page = Page(browser, f"http://{address}")
        page.open(scan)
    page.page.fill("#ratio", "3")
    page.page.click("#go")
    page.page.locator("#error", has_text="does not answer").wait_for()
    assert page.covered() > 0.02, "what is shown stays"
    with serving("--data-dir", folder, port=port):
        page.upsample(3)
        page.drawn(10_000)
        assert page.page.is_hidden("#error")
    page.complaints.clear()
    page.close("away")


def test_keys_are_asked_for_once(browser, scan, tmp_path):
    keys = tmp_path / "keys"
    keys.write_text("alice alices-own-secret-key\n")
    keys.chmod(0o600)
    with serving("--keys", keys) as address:
        context = browser.new_context()
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        page.goto(f"http://{address}/")
        page.fill("#key", "alices-own-secret-key")
        page.click("#ask-key button")
        until(page, "document.getElementById('format').options.length > 2")
        page.set_input_files("#file", scan)
        page.wait_for_selector("#go:enabled")
        page.fill("#ratio", "2")
        page.click("#go")
        page.wait_for_selector("#compare:not([hidden])")
        assert "secret" not in page.url
        context.close()


def test_view_opens_files_for_whoever_has_the_address(browser, scan):
    process = subprocess.Popen([PROGRAM, "view", "--no-open", scan], stdout=subprocess.PIPE, text=True)
    try:
        address = process.stdout.readline().strip()
        context = browser.new_context()
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        page.goto(address)
        until(page, "document.getElementById('drawn').textContent.startsWith('2')")
        assert page.inner_text("#title") == "scan.ply"
        assert "key" not in page.url
        page.click("#go")
        page.wait_for_selector("#compare:not([hidden])")
        refused = context.request.get(f"{address.split('#')[0]}about")
        assert refused.status == 401
        assert json.loads(refused.text())["type"].endswith("unauthorized")
        context.close()
    finally:
        process.terminate()
        assert process.wait(60) == 0
