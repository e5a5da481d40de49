"""The page at /docs, in Chromium without a window: what a person does there, and what the browser says to it.

Needs a Chromium or Chrome of the system's (`apt-get install chromium`), or the one that CHROMIUM names; without
one these are skipped. DENSECLOUD_SCREENSHOTS names a folder that pictures of the page are left in.
"""

import os
import pathlib
import shutil

import pytest

from conftest import serving

playwright = pytest.importorskip("playwright.sync_api")
CHROMIUM = os.environ.get("CHROMIUM") or next(
    filter(None, map(shutil.which, ["chromium", "chromium-browser", "google-chrome"])), None
)
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
# Nothing here takes nearly as long, in milliseconds.
PATIENCE = 120_000


@pytest.fixture(scope="module")
def server():
    with serving("--max-points-in", 5000) as address:
        yield f"http://{address}"


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        # Its own sandbox cannot be had by root or inside most containers; the page is ours.
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(params=[(1100, 900, "light"), (390, 844, "dark")], ids=["desktop", "phone"])
def page(request, server, browser):
    """The page, loaded; at the end, nothing was asked of another server and the browser had no complaint."""
    width, height, scheme = request.param
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    asked, complaints = [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    reply = page.goto(f"{server}/docs")
    assert "default-src 'none'" in reply.headers["content-security-policy"]
    page.wait_for_selector("#operations details")
    yield page
    folder = os.environ.get("DENSECLOUD_SCREENSHOTS")
    if folder:
        pathlib.Path(folder).mkdir(parents=True, exist_ok=True)
        page.screenshot(path=f"{folder}/{request.node.name}.png", full_page=True)
    assert page.evaluate("document.documentElement.scrollWidth") <= width, "nothing sticks out"
    context.close()
    others = [url for url in asked if not url.startswith((server, f"blob:{server}"))]
    assert not others
    # The browser itself tells of every answer that is an error.
    assert not [text for text in complaints if "Failed to load resource" not in text]


def test_a_file_goes_up_and_a_denser_one_comes_down(page, upsample, sphere, tmp_path):
    source = tmp_path / "scan.xyz"
    source.write_text("".join(f"{x} {y} {z}\n" for x, y, z in sphere[0]))
    page.set_input_files("#file", source)
    page.fill("#ratio", "3")
    page.fill("#seed", "7")
    page.fill("#X-Request-Timeout", "60")
    page.select_option("#keep_input", "true")
    page.select_option("#accept", "application/x-ply")
    page.click("button")
    link = page.wait_for_selector("#download")
    assert link.inner_text() == "scan-dense.ply"
    assert "1500 points have become 4500" in page.inner_text("#result")
    with page.expect_download() as download:
        link.click()
    upsample(source, tmp_path / "here.ply", "--ratio", 3, "--seed", 7, "--keep-input")
    assert pathlib.Path(download.value.path()).read_bytes() == (tmp_path / "here.ply").read_bytes()
    assert "server-timing" in page.inner_text("#told")


def test_a_result_is_saved_under_the_name_that_programs_know_it_by(page, sphere, tmp_path):
    source = tmp_path / "scan.xyz"
    source.write_text("".join(f"{x} {y} {z}\n" for x, y, z in sphere[0]))
    page.set_input_files("#file", source)
    page.fill("#ratio", "2")
    page.select_option("#accept", "text/x-colmap-points3d")
    page.click("button")
    assert page.wait_for_selector("#download").inner_text() == "points3D.txt"


def test_what_is_wrong_is_said(page, tmp_path):
    source = tmp_path / "scan.xyz"
    source.write_text("1 2 3\n4 five 6\n")
    page.set_input_files("#file", source)
    page.click("button")
    page.locator("#result", has_text="line 2").wait_for()
    assert "400" in page.inner_text("#result")
    assert page.is_enabled("button")


def test_every_operation_opens(page):
    details = page.query_selector_all("#operations details")
    assert len(details) > 15
    for one in details:
        one.query_selector("summary").click()
        assert all(table.is_visible() for table in one.query_selector_all("table"))
    text = page.inner_text("#operations")
    assert "Idempotency-Key" in text
    assert "undefined" not in text
