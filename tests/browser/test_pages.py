"""Pages in a real browser: they load without a violation, gaits are chosen by click and key, walkers move."""

import math
import re
from functools import cache

import pytest
from pictured import TORSO, atlas, branch, gait

from gaitopt import Floor, simulate
from gaitopt.show.film import FilmContactRecord, FilmPhaseRecord, FilmRecord
from gaitopt.show.motion import motion_of
from gaitopt.show.pages import animation_page, atlas_report, branch_report, comparison_report, walk_report, walks_page

FORCE = ".walker .force"
UNROLLED = "return { ...film, phases, columns };"
"""Statement that returns a film after a script has read it; everything drawn reads this value."""
WATCHED = """
  const watched = (kind, record) => new Proxy(record, {
    get(known, key) {
      if (typeof key === "string" && !(key in known)) throw new Error(`a ${kind} has no ${key}`);
      (window.read ??= new Set()).add(`${kind}.${String(key)}`);
      return known[key];
    },
  });
  const contacts = film.contacts.map((contact) => watched("contact", contact));
  return watched("film", { ...film, contacts, phases: phases.map((phase) => watched("phase", phase)), columns });
"""
"""The same, but reading a key that a film lacks is an error, and the keys that are read are remembered."""
OF_PYTHON = {"film.cycle", "film.frames", "contact.point"}
"""Keys that templates or ``unrolled`` read."""


def position(page):
    return page.locator(FORCE).first.get_attribute("d")


@cache
def compared(*names):
    """The page of some gaits side by side."""
    return comparison_report([gait(name) for name in names])


@pytest.fixture(scope="module")
def branch_page():
    return branch_report(gait("compass-passive-a").problem, "friction", branch())


@pytest.mark.parametrize("name", ["compass-passive-a", "rimless-wheel-slip", TORSO])
def test_the_walker_walks_at_the_chosen_speed_stops_and_is_scrubbed(visit, name):
    page = visit(animation_page(motion_of(gait(name))))
    first = position(page)
    page.wait_for_function(f"first => document.querySelector('{FORCE}').getAttribute('d') !== first", arg=first)
    page.get_by_label("speed").select_option("2")
    page.wait_for_function("() => document.querySelector('.caption').textContent.includes('step 3')", timeout=5000)
    page.get_by_role("button", name="Pause").click()
    still = position(page)
    page.wait_for_timeout(150)
    assert position(page) == still
    slider = page.get_by_role("slider", name="time")
    slider.fill("700")
    assert "step 3" in page.locator(".caption").inner_text()
    slider.press("ArrowRight")
    assert slider.input_value() == "701"


def test_a_low_and_long_walker_is_whole_in_the_picture(visit):
    page = visit(animation_page(motion_of(gait("crawler"))))
    frame = page.locator("svg.walker").bounding_box()
    for k in range(page.locator(".walker .leg").count()):
        line = page.locator(".walker .leg").nth(k).bounding_box()
        assert frame["x"] <= line["x"]
        assert line["x"] + line["width"] <= frame["x"] + frame["width"]


def test_a_place_of_an_atlas_shows_its_gait_in_its_region_on_its_sheet(visit):
    page = visit(atlas_report(atlas()), motion="reduce")
    heading, map_ = page.locator("article h2"), page.locator(".map svg[role=img]")
    assert page.locator(".map path.region").count() == 2
    assert page.locator(".map path.unstable-area").count() == 1
    assert "Neimark" in page.locator(".map .key").inner_text()
    box = map_.bounding_box()
    chosen = []
    for part, stability in ((0.25, "unstable"), (0.85, "stable")):
        page.mouse.click(box["x"] + part * box["width"], box["y"] + 0.4 * box["height"])
        assert page.locator("article .badge").inner_text() == stability
        assert page.locator("article svg.walker").count() == 1
        for title, mark, place in (("Floquet multipliers", "circle", 2), ("Force ratio", "rect.beyond", 0)):
            page.locator("figure", has_text=title).locator(mark).nth(place).wait_for(state="attached")
        chosen.append(heading.inner_text())
    assert len(set(chosen)) == 2
    assert all("°" in words and "μ = " in words for words in chosen)
    map_.focus()
    page.keyboard.press("ArrowDown")
    assert heading.inner_text() != chosen[-1]
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.5 * box["height"])
    assert page.locator(".tip").inner_text().endswith("unstable")
    page.get_by_role("button", name="sheet 2").click()
    assert page.locator("article p").first.inner_text().count("2 times") == 1
    assert page.evaluate("document.documentElement.scrollWidth") <= page.evaluate("innerWidth")


def test_in_flight_there_is_neither_force_nor_mark_on_the_ground(visit):
    page = visit(animation_page(motion_of(gait("hopper"))), motion="reduce")
    for place, flying in ((0, False), (40, True), (200, True), (252, False)):
        page.get_by_role("slider", name="time").fill(str(place))
        assert ("flight" in page.locator(".caption").inner_text()) is flying
        assert page.locator(FORCE).is_visible() is not flying
    assert page.locator(".walker .mark").count() == 0


def test_slip_leaves_marks_on_the_ground_and_the_magnifier_glows_while_the_foot_slips(visit):
    page = visit(animation_page(motion_of(gait("compass-passive-a"))), motion="reduce")
    still = position(page)
    page.wait_for_timeout(200)
    assert position(page) == still  # nothing moves by itself
    assert page.get_by_role("button", name="Play").is_visible()
    assert page.locator(".lens text").all_text_contents() == ["2 mm", "×100"]
    for place, mode in ((5, "slip_forward"), (100, None), (248, "slip_backward")):
        page.get_by_role("slider", name="time").fill(str(place))
        classes = page.locator(".lens .rim").get_attribute("class").split()
        assert classes == (["rim", "glows", mode] if mode else ["rim"])
    page.get_by_role("slider", name="time").fill("1000")
    marks = page.locator(".walker .mark:not(.lens *)")
    assert marks.count() == 8  # forward and backward in each of four steps
    assert all(marks.nth(k).evaluate("mark => mark.style.display") == "" for k in range(8))
    assert visit(animation_page(motion_of(gait("compass-passive-stick")))).locator(".lens").count() == 0


def test_a_click_in_the_plane_of_starts_or_a_button_plays_its_walk(visit):
    shown = gait("compass-passive-a")
    starts = {f"{a}, {b}": {"dtheta1": a, "dtheta2": b} for a in (0.7, 0.72) for b in (-0.54, -0.5)}
    walks = {label: simulate(shown, state, steps=2) for label, state in starts.items()}
    page = visit(walks_page(shown, walks, "", ("dtheta1", "dtheta2")), motion="reduce")
    cells = page.locator("rect.cell:not(.chosen)")
    assert cells.count() == len(walks)
    for k, label in enumerate(walks):
        cells.nth(k).click(force=True)
        assert page.locator("#choice > p").inner_text().startswith(f"{label}: ")
    page = visit(walks_page(shown, walks, ""), motion="reduce")
    button = page.get_by_role("button", name=label, exact=True)
    button.click()
    assert button.get_attribute("aria-pressed") == "true"
    assert page.locator("#choice > p").inner_text().startswith(f"{label}: ")


def test_gaits_of_a_branch_are_chosen_by_pointer_key_and_special_point(visit, branch_page):
    page = visit(branch_page)
    heading, tip = page.locator("article h2"), page.locator(".tip")
    before, numbers = heading.inner_text(), page.locator("article .overview table").inner_text()
    dots = page.locator(".diagram circle.dot")
    for _ in range(6):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.id") == "point":
            break
    page.keyboard.press("ArrowLeft")  # less friction
    assert heading.inner_text().endswith("μ = 0.145")
    assert "0.145" in page.locator("#point").get_attribute("aria-valuetext")
    dots.nth(2).hover(force=True)
    assert tip.is_visible()
    assert "0.14" in tip.inner_text()
    page.mouse.move(2, 2)
    assert tip.is_hidden()
    box = dots.nth(5).bounding_box()
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    assert heading.inner_text() == "Branch 1, coefficient of friction μ = 0.15" != before
    assert page.locator("article .overview table").inner_text() != numbers
    assert "unstable" in page.locator("article .badge").inner_text()
    page.get_by_role("button", name="branch ends").click()
    assert heading.inner_text() == "Branch 1, coefficient of friction μ = 0.16"
    page.wait_for_function("() => document.querySelector('article').getBoundingClientRect().top < innerHeight / 2")


def test_special_points_are_explained_and_what_is_chosen_outlasts_another_gait(visit, branch_page):
    page = visit(branch_page)
    shapes = {page.locator(".diagram .special").nth(k).get_attribute("class") for k in range(2)}
    assert len(shapes) == 2
    assert "Neimark" in page.locator(".diagram .key").last.inner_text()
    assert "0.135" in page.locator(".diagram text").all_text_contents()  # beside its mark
    page.get_by_label("speed").select_option("0.5")
    page.get_by_role("button", name="Pause").click()
    page.locator("#point").press("ArrowLeft")
    assert page.get_by_label("speed").input_value() == "0.5"
    assert page.get_by_role("button", name="Play").is_visible()
    page.get_by_label("Show").select_option("speed")
    assert "speed" in page.locator(".diagram figcaption").inner_text()


def test_the_controls_of_an_animation_are_visible_in_a_notebook(visit):
    page = visit(gait("rimless-wheel-slip").animate()._repr_html_(), width=1100)
    buttons = page.frame_locator("iframe").locator(".controls")
    frame, controls = page.locator("iframe").bounding_box(), buttons.bounding_box()
    assert controls["y"] + controls["height"] < frame["y"] + frame["height"]


def test_gaits_side_by_side_share_their_axes_show_the_difference_and_have_round_circles(visit):
    page = visit(compared("compass-passive-a", "compass-pd-impact-slip"))
    assert page.locator("article").count() == 2
    assert "difference" in page.locator("#numbers thead").inner_text()
    ticks = [page.locator("article").nth(k).locator(".chart").first.locator("text").all_inner_texts() for k in (0, 1)]
    assert ticks[0] == ticks[1]
    panels = page.locator("figure", has_text="Floquet multipliers")
    assert panels.count() == 2
    for k in range(2):
        frame, circle = (panels.nth(k).locator("path.axis").nth(n).bounding_box() for n in range(2))
        assert circle["width"] == pytest.approx(circle["height"], abs=1)
        assert circle["width"] > 0.75 * max(frame["width"], frame["height"])  # it fills its panel


@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.slow)])
@pytest.mark.parametrize("width", [360, 768, 1400])
def test_nothing_is_wider_than_the_screen(visit, branch_page, width, scheme):
    for text in (compared("compass-pd-impact-slip"), branch_page):
        page = visit(text, width=width, scheme=scheme)
        page.evaluate("document.querySelectorAll('details').forEach((part) => (part.open = true))")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        ink, paper = (page.evaluate(f"getComputedStyle(document.body).{key}") for key in ("color", "backgroundColor"))
        assert contrast(ink, paper) > 7


def contrast(first, second):
    """Contrast ratio of two CSS colours, WCAG 2.1."""

    def luminance(colour):
        parts = [int(part) / 255 for part in colour.removeprefix("rgb(").removesuffix(")").split(",")]
        red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
        return 0.2126 * red + 0.7152 * green + 0.0722 * blue

    low, high = sorted((luminance(first), luminance(second)))
    return (high + 0.05) / (low + 0.05)


def test_two_steps_have_their_own_jumps_crosses_and_no_slip_between_them(visit):
    page = visit(compared("compass-passive-two-step"))
    titles = page.locator("figcaption").all_inner_texts()
    assert "Slip of the stance foot" not in titles
    assert "2 times stick; impact: stick" in page.locator("article").inner_text()
    portrait, force = page.locator(".chart").nth(0), page.locator(".chart").nth(1)
    assert portrait.locator("circle.dot").count() == 4
    assert portrait.locator(".jump").count() == 4
    assert force.locator("path.curve.second").count() == 2


def test_the_page_of_a_passive_gait_has_its_multipliers_a_smooth_slip_and_no_motors(visit):
    page = visit(compared("compass-passive-a"), width=390)
    assert page.locator("h1").inner_text() not in page.locator("h2").all_inner_texts()
    assert page.locator(".multipliers tbody tr").count() == 2  # a conjugate pair shares a line
    assert "±" in page.locator(".multipliers tbody").inner_text()
    numbers = page.locator("table").first.inner_text()
    assert not re.search("cost of transport|dampers", numbers)
    assert "x\u0307" in numbers
    assert "|f_t|/f_n while sticking" in numbers
    page.locator("figure", has_text="Largest difference").locator("svg").wait_for()
    heights = page.evaluate("Array.from(document.querySelectorAll('.charts figure'), (figure) => figure.offsetHeight)")
    assert max(heights) < 1.25 * heights[0]  # figures that are swiped leave no gap below the first
    chart = page.locator("figure", has_text="Slip of the stance foot").locator("path.curve")
    assert all(chart.nth(k).get_attribute("d").count("L") >= 30 for k in range(chart.count()))


def test_equal_figures_of_gaits_side_by_side_stand_at_equal_heights(visit):
    page = visit(compared("compass-passive-a", "compass-passive-stick"), width=1200)
    page.locator("figure", has_text="Largest difference").locator("svg").last.wait_for()
    tops = [
        page.locator("article")
        .nth(k)
        .locator("figure")
        .evaluate_all("all => all.map((f) => f.getBoundingClientRect().top)")
        for k in (0, 1)
    ]
    assert tops[0] == tops[1]


def test_a_jump_within_a_step_and_flight_are_drawn(visit):
    page = visit(compared("kneed-passive"))
    portrait = page.locator("figure", has_text="Phase portrait")
    portrait.locator(".jump").last.wait_for(state="attached")
    assert portrait.locator(".jump").count() > len(gait("kneed-passive").system.walker.shape)
    assert "a stop that locks" in portrait.inner_text()
    page = visit(compared("hopper"))
    page.locator("figure", has_text="Normal force").locator("path.flying").wait_for(state="attached")
    assert "ẏ" not in page.locator("figure", has_text="Simulation and NLP").inner_text()
    assert " y" in page.locator("figure", has_text="Simulation and NLP").inner_text()


def test_angles_of_a_branch_are_shown_in_degrees_where_the_file_has_them(visit):
    start = gait("compass-passive-a")
    point = {"record": "point", "parameter": "walker.slope", "branch": 0, "index": 0, "value": math.radians(1)}
    point |= start.to_record() | {"parameters": {"walker.slope": math.radians(1)}}
    page = visit(branch_report(start.problem, "walker.slope", [point]))
    assert page.locator("article h2").inner_text() == "Branch 0, slope = 1°"
    assert "slope [°]" in page.locator(".diagram").inner_text()
    assert "(free)" not in page.locator("article").inner_text()


def test_gaits_are_swiped_on_a_phone_and_played_together(visit):
    page = visit(compared("compass-passive-a", "compass-pd-impact-slip"), width=390)
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.evaluate("document.documentElement.scrollHeight") < 6000
    page.get_by_role("navigation").get_by_role("button").nth(1).click()
    page.wait_for_function("() => document.getElementById('gaits').scrollLeft > 200")
    page.get_by_role("button", name="Pause all").click()
    assert page.get_by_role("button", name="Pause", exact=True).count() == 0
    page.get_by_role("button", name="Overlay").click()
    assert page.locator(".overlay svg.walker").count() == 2
    first, second = (page.locator(".overlay svg.walker").nth(k).bounding_box() for k in (0, 1))
    assert first == second
    page.get_by_role("slider", name="time").first.fill("300")
    before = page.locator(".overlay .force:not(.lens *)").nth(1).get_attribute("d")
    page.get_by_role("slider", name="time").first.fill("400")
    page.wait_for_function(
        "d => document.querySelectorAll('.overlay .force:not(.lens *)')[1].getAttribute('d') !== d", arg=before
    )


def test_who_dislikes_motion_is_brought_to_a_gait_at_once(visit):
    page = visit(compared("compass-passive-a", "compass-passive-b"), width=390, motion="reduce")
    page.get_by_role("navigation").get_by_role("button").nth(1).click()
    assert page.evaluate("document.getElementById('gaits').scrollLeft") > 200
    assert page.get_by_role("button", name="Play all").is_visible()


def test_everything_that_is_operated_or_drawn_has_a_name_for_a_screen_reader(visit, branch_page):
    for text in (compared("compass-pd-impact-slip"), branch_page):
        page = visit(text, motion="reduce")
        page.locator(".chart svg").first.wait_for()
        nameless = page.evaluate(
            """() => Array.from(document.querySelectorAll("button, input, select, [role=img], [tabindex], summary"))
                .filter((e) => !(e.getAttribute("aria-label") || e.labels?.length || e.textContent.trim()))
                .map((e) => e.outerHTML.slice(0, 80))"""
        )
        assert nameless == []


def test_a_walk_is_shown_from_start_to_end(visit):
    walk = simulate(gait("compass-passive-a"), {"theta1": -0.15}, steps=9)
    page = visit(walk_report(walk), width=390, motion="reduce", scheme="dark")
    assert page.evaluate("getComputedStyle(document.querySelector('.paper img')).filter") != "none"  # no white picture
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.locator("tbody tr").count() >= len(walk.complete_steps) + 1
    page.get_by_role("slider", name="time").fill("1000")
    assert f"step {len(walk.trajectory.steps)}" in page.locator(".caption").inner_text()


def test_scripts_read_what_a_film_states_and_nothing_else(visit, branch_page):
    kinds = {"film": FilmRecord, "phase": FilmPhaseRecord, "contact": FilmContactRecord}
    stated = {f"{kind}.{key}" for kind, record in kinds.items() for key in record.__annotations__}
    read = set()
    for text in (
        animation_page(motion_of(gait("crawler"))),
        compared("heel-toe", "compass-pd-impact-slip"),
        branch_page,
        walk_report(
            simulate(gait("compass-passive-a"), steps=2, floor=Floor(friction=[0.14, 0.139], height=[0, 1e-4]))
        ),
    ):
        assert text.count(UNROLLED) == 1
        page = visit(text.replace(UNROLLED, WATCHED), motion="reduce")
        page.locator(".walker").first.wait_for()
        page.get_by_role("slider", name="time").first.fill("500")
        read |= set(page.evaluate("[...window.read]"))
    assert read - {"film.columns"} <= stated
    assert stated - read <= OF_PYTHON


def test_a_key_that_a_film_lacks_is_noticed(visit):
    wrong = animation_page(motion_of(gait("crawler"))).replace("${this.film.name}", "${this.film.nome}")
    noted = WATCHED.replace("throw new Error", "(window.errors ??= []).push")
    page = visit(wrong.replace(UNROLLED, noted), motion="reduce")
    page.locator(".walker").first.wait_for()
    assert page.evaluate("window.errors") == ["a film has no nome"]
