"""The documentation as a site: no page scrolls sideways on a phone, and formulas are whole."""

import warnings
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
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


def test_no_page_is_wider_than_a_phone(site, phone):
    for page in sorted(DOCS.glob("*.md")):
        phone.goto((site / f"{page.stem}.html").as_uri())
        assert phone.evaluate("document.documentElement.scrollWidth") <= PHONE["width"], page.name


def test_formulas_of_the_theory_are_whole_on_a_phone(site, phone):
    phone.goto((site / "theory.html").as_uri())
    blocks = "document.querySelectorAll('math[display=block]')"
    widths = phone.evaluate(f"Array.from({blocks}, (m) => [m.scrollWidth, m.parentElement.clientWidth])")
    assert len(widths) >= 8
    assert all(formula <= room for formula, room in widths)


def test_the_start_page_shows_a_still_walker_to_those_who_dislike_motion(site, phone):
    phone.goto((site / "index.html").as_uri())
    assert phone.locator("img.still").is_visible()
    assert phone.locator("img.moving").is_hidden()
    assert phone.locator("#gallery img").count() == 6
