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


@pytest.fixture
def visit(chromium, tmp_path):
    """Open the text of a page at a width; whatever the browser complains of fails the test at its end."""
    violations, contexts = [], []

    def call(text, width=1200, scheme="light", motion="no-preference"):
        path = tmp_path / "page.html"
        path.write_text(text, encoding="utf-8")
        size = {"width": width, "height": 900}
        contexts.append(chromium.new_context(viewport=size, color_scheme=scheme, reduced_motion=motion))
        page = contexts[-1].new_page()
        page.on("console", lambda message: violations.append(message.text))
        page.on("pageerror", lambda error: violations.append(str(error)))
        page.on("request", lambda request: request.url.startswith(("file:", "data:")) or violations.append(request.url))
        page.goto(path.as_uri())
        page.evaluate(DRAWN)
        return page

    yield call
    for context in contexts:
        context.close()
    assert violations == []
