"""A headless Chromium for the tests of pages; without one on the machine they are skipped, and say so."""

import os
import shutil

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
QUIET = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)
DRAWN = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
"""Charts are drawn once their size is known, in the first frame after loading."""
REQUIRED = "GAITOPT_REQUIRE_BROWSER"
"""Set in the continuous check: there a missing browser is a failure."""


@pytest.fixture(scope="session")
def chromium():
    if CHROMIUM is None:
        message = "no Chromium on this machine (Debian: apt-get install chromium)"
        pytest.fail(message) if os.environ.get(REQUIRED) else pytest.skip(message)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(QUIET))
        yield browser
        browser.close()


@pytest.fixture(scope="session")
def tab(chromium):
    """The tab that shows all pages one after the other; a tab of its own would start a process for each of them."""
    return chromium.new_context().new_page()


@pytest.fixture
def visit(tab, tmp_path):
    """Open the text of a page at a width; whatever the browser complains of fails the test at its end."""
    violations = []
    listeners = {
        "console": lambda message: violations.append(message.text),
        "pageerror": lambda error: violations.append(str(error)),
        "request": lambda request: request.url.startswith(("file:", "data:")) or violations.append(request.url),
    }

    def call(text, width=1200, scheme="light", motion="no-preference"):
        path = tmp_path / "page.html"
        path.write_text(text, encoding="utf-8")
        tab.set_viewport_size({"width": width, "height": 900})
        tab.emulate_media(color_scheme=scheme, reduced_motion=motion)
        tab.goto(path.as_uri())
        tab.evaluate(DRAWN)
        return tab

    for event, listener in listeners.items():
        tab.on(event, listener)
    yield call
    tab.goto("about:blank")
    for event, listener in listeners.items():
        tab.remove_listener(event, listener)
    assert violations == []
