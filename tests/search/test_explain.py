"""Why there is no gait, what there is instead, and where it begins."""

import pytest

from gaitopt import explain, load_problem, solve
from gaitopt.search.explain import end_of_family, nearest_begin


def explained(name, overrides, **options):
    return explain(load_problem(name).replace(overrides), starts=1, **options)


@pytest.fixture(scope="module")
def wheel():
    """The sticking wheel on a floor of friction 0.8."""
    return explained("rimless-wheel-stick", {"friction": 0.8})


@pytest.mark.slow
def test_the_cause_is_the_friction_that_sticking_needs_and_instead_there_is_the_gait_that_slips(wheel):
    """At the nearest values the gait exists, and beyond them it does not."""
    assert not wheel.exists
    assert wheel.causes[0].what == "friction"
    assert wheel.causes[0].needed == pytest.approx(0.914121, abs=1e-6)
    assert [str(gait.problem.cycle) for gait in wheel.instead] == ["stick, slip_forward; stick"]
    assert wheel.walk.to_record()["steps"] == 20
    friction = {n.parameter: n for n in wheel.nearest}["friction"]
    assert friction.value == pytest.approx(wheel.causes[0].needed, abs=1e-7)  # which is not refined
    assert friction.type == "mode_change"
    for nearest in wheel.nearest:
        away = 1e-6 * (nearest.value - wheel.problem.parameters[nearest.parameter])
        for value, exists in ((nearest.value + away, True), (nearest.value - away, False)):
            assert solve(wheel.problem.replace({nearest.parameter: value})).converged is exists
    record = wheel.to_record()
    assert record.keys() >= {"problem", "exists", "causes", "instead", "nearest"}
    assert record["causes"][0].keys() == {"what", "phase", "time", "needed", "available", "words"}
    assert record["nearest"][0].keys() >= {"parameter", "value", "type"}


@pytest.mark.slow
def test_families_show_where_a_sequence_begins_and_ends():
    stick, slip = (solve(load_problem(f"rimless-wheel-{kind}")) for kind in ("stick", "slip"))
    begin = nearest_begin([slip], "friction", [0.1, 1.0], stick.problem.cycle)
    end = end_of_family(stick, "friction", 0.4, None)
    assert begin.value == pytest.approx(end.value, abs=1e-8)
    assert end.value == pytest.approx(0.914121, abs=1e-6)
    assert nearest_begin([slip], "friction", [0.5], stick.problem.cycle) is None
    assert nearest_begin([slip], "friction", [1.0], stick.problem.cycle, within=0.5) is None


def test_conditions_and_the_end_of_the_family_are_told_before_the_search():
    told = []
    heavy = load_problem("compass-passive-stick").replace({"walker.hip_mass": 30})
    explanation = explain(heavy, seconds=0.0, found=told.append, progress=False)
    assert not explanation.complete
    assert not explanation.to_record()["complete"]
    assert "needs friction 0.2127, has 0.2" in told[0].causes[0].description
    assert [(n.parameter, round(n.value, 6)) for n in told[0].nearest] == [("walker.hip_mass", 14.896175)]
    assert explanation.nearest == told[0].nearest


@pytest.mark.slow
def test_what_is_told_on_the_way_is_part_of_the_answer(wheel):
    told = []
    explanation = explain(wheel.problem, starts=1, found=told.append, progress=False)
    assert explanation.complete
    assert all({n.parameter for n in part.nearest} <= {n.parameter for n in explanation.nearest} for part in told)
    assert explanation.causes == wheel.causes
    assert [n.value for n in explanation.nearest] == [n.value for n in wheel.nearest]
    assert [gait.state.tolist() for gait in explanation.instead] == [gait.state.tolist() for gait in wheel.instead]


def test_a_gait_that_exists_needs_no_explanation():
    explanation = explained("rimless-wheel-stick", {})
    assert (explanation.exists, explanation.causes, explanation.nearest) == (True, (), ())


def test_an_explanation_that_is_interrupted_is_not_taken_for_one_at_a_time_limit():
    slippery, asked = load_problem("rimless-wheel-stick").replace({"friction": 0.8}), []
    with pytest.raises(KeyboardInterrupt):
        explain(slippery, found=asked.append, progress=False, should_stop=lambda: bool(asked))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "overrides", "value"),
    [
        ("compass-torque-slip", {"control.hip": 0.0}, 0.501870492312),
        ("compass-torque-impact-slip", {"friction": 0.4}, 0.232244917992),
        ("compass-passive-b", {"friction": 0.32}, 0.304416755066),
    ],
)
def test_what_was_changed_is_the_cause_with_the_value_at_which_the_gait_ends(name, overrides, value):
    """A torque that is too weak, and floors that are not slippery enough."""
    explanation = explained(name, overrides)
    ((parameter, has),) = overrides.items()
    assert explanation.causes[0].what == "impact_change"
    assert (explanation.causes[0].needed, explanation.causes[0].available) == (pytest.approx(value, abs=1e-8), has)
    assert {n.parameter: n for n in explanation.nearest}[parameter].value == explanation.causes[0].needed


@pytest.mark.slow
def test_an_event_that_does_not_happen_is_listed_after_the_value_at_which_it_begins_to_happen():
    """At a friction of 1.2 the sticking wheel never reaches the edge of the cone."""
    problem = load_problem("rimless-wheel-slip").replace({"friction": 1.2}).from_guess()
    first, second = explain(problem, starts=1).causes
    assert (first.what, second.what) == ("mode_change", "cone_forward")
    assert "has no end" in second.description


@pytest.mark.slow
def test_of_a_design_every_free_number_has_a_value_at_which_the_sequence_begins():
    """The sticking wheel at friction 0.8, whose inertia may vary, but not so far that it sticks."""
    free = {"free": [0.3, 0.35], "guess": 1 / 3}
    overrides = {"friction": 0.8, "walker.inertia_ratio": free, "objective": "speed"}
    nearest = {n.parameter: n for n in explained("rimless-wheel-stick", overrides).nearest}
    assert nearest.keys() == {"walker.inertia_ratio", "friction", "walker.slope"}
    value = nearest["walker.inertia_ratio"].value
    for ratio, exists in ((value * (1 - 1e-6), True), (value * (1 + 1e-6), False)):
        problem = load_problem("rimless-wheel-stick").replace({"friction": 0.8, "walker.inertia_ratio": ratio})
        assert solve(problem).converged is exists
