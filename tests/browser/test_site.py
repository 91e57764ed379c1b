"""The documentation as a site: no page scrolls sideways on a phone, and formulas are whole."""

import warnings
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGES = [
    page.relative_to(DOCS).with_suffix(".html") for page in sorted((*DOCS.glob("*.md"), *DOCS.glob("developer/*.md")))
]
PHONE = {"width": 390, "height": 844}

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    sphinx = pytest.importorskip("sphinx.cmd.build", reason="needs pip install '.[docs]'")
    folder = tmp_path_factory.mktemp("site")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # those of Sphinx's own dependencies
        assert sphinx.build_main(["-q", str(DOCS), str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def phone(chromium):
    context = chromium.new_context(viewport=PHONE, reduced_motion="reduce")
    yield context.new_page()
    context.close()


def test_no_page_is_wider_than_a_phone_and_formulas_are_whole(site, phone):
    blocks = "Array.from(document.querySelectorAll('math[display=block]'), (formula) => formula.parentElement)"
    found = 0
    for page in PAGES:
        phone.goto((site / page).as_uri())
        assert phone.evaluate("document.documentElement.scrollWidth") <= PHONE["width"], page
        widths = phone.evaluate(f"{blocks}.map((block) => [block.scrollWidth, block.clientWidth])")
        assert all(formula <= room for formula, room in widths), page
        found += len(widths)
    assert found >= 15


def test_the_start_page_shows_a_still_walker_to_those_who_dislike_motion(site, phone):
    phone.goto((site / "index.html").as_uri())
    assert phone.locator("img.still").is_visible()
    assert phone.locator("img.moving").is_hidden()


def test_the_live_branch_follows_the_dark_switch_and_the_slider_has_more_friction_to_the_right(site, chromium):
    page = chromium.new_page(color_scheme="null")  # not emulated, which would hold for frames too
    page.goto((site / "index.html").as_uri())
    live = page.frame_locator("iframe.live >> nth=0")
    for theme in ("dark", "light"):
        page.evaluate(f"document.body.dataset.theme = '{theme}'")
        ink = {"dark": "rgb(236, 236, 234)", "light": "rgb(27, 27, 27)"}[theme]
        page.wait_for_timeout(300)
        assert live.locator("body").evaluate("body => getComputedStyle(body).color") == ink
    values = []
    for key in ("ArrowLeft", "ArrowLeft", "ArrowRight"):
        live.locator("#point").press(key)
        values.append(float(live.locator("article h2").inner_text().rpartition("= ")[2]))
    assert values[1] < values[0] == values[2]
    page.close()


def test_every_walker_of_the_gallery_is_wide_enough_to_be_seen(site, chromium):
    page = chromium.new_page(viewport={"width": 1200, "height": 900})
    page.goto((site / "gallery.html").as_uri())
    cards = page.locator("#gallery > ul img")
    assert cards.count() >= 8
    assert min(cards.nth(k).bounding_box()["width"] for k in range(cards.count())) >= 200
    page.close()
