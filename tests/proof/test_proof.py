"""Proofs of gaits: closed forms lie inside, this project's values lie next to them, and what is false is refused."""

import json
from copy import deepcopy
from dataclasses import replace
from functools import cache
from operator import neg

import pytest
from certificates import certificate_of, failed, failures, gait, negated, proof, refusals, restored, reworded
from flint import acb, arb, arb_mat, ctx

from gaitopt import check_proof, load_problem, parse_problem, prove, simulate, solve
from gaitopt.errors import StorageError, UnknownNameError
from gaitopt.gait.measures import measure
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.problem.writing import ExactValues, write_problem
from gaitopt.proof import claims, orbit
from gaitopt.proof.arithmetic import PRECISION, NotProved, ball
from gaitopt.proof.check import Proof, check, check_box, connection_claim
from gaitopt.proof.prove import prove_special
from gaitopt.proof.statement import restore_box
from gaitopt.proof.taylor import VectorField

QUICK = ("rimless-wheel-slip", "crawler", "hopper")
STABLE = {
    "rimless-wheel-stick": True,
    "rimless-wheel-slip": True,
    "rimless-wheel-slope": True,
    "compass-passive-stick": True,
    "compass-passive-a": True,
    "compass-passive-b": False,
    "compass-passive-static-kinetic": True,
    "compass-torque-stick": True,
    "compass-torque-slip": True,
    "compass-torque-impact-slip": False,
    "compass-torque-efficient": True,
    "compass-torque-stable-slip": True,
    "compass-torque-stable-slip-cheap": True,
    "compass-minimum-friction": True,
    "compass-pd-impact-slip": True,
    "compass-pd-designed": True,
    "compass-pd-slippery": True,
    "compass-passive-two-step": True,
    "compass-unequal": True,
    "round-feet-passive": True,
    "torso-passive": True,
    "compass-shaped": True,
    "torso-upright": True,
    "crawler": True,
    "hopper": True,
    "slip-run": True,
    "compass-push-off": True,
    "kneed-passive": True,
    "telescopic-passive": True,
    "heel-toe": True,
    "heel-toe-slip": True,
    "heel-toe-impact-slip": False,
    "inchworm": True,
}
"""Named gaits that are proved, and whether they are stable."""
NAMED = [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in STABLE]
WIDTHS = {"rimless-wheel": 1e-9, "heel-toe-impact-slip": 3e-5}
"""Largest width of the bounds of a multiplier, by the beginning of the name. A multiplier of -2.8 and three changes of
modes widen those of all others."""
WIDTH = 1e-6
"""Largest width of the bounds of the multipliers of other gaits."""
STATE_TOLERANCE = 3e-12
"""Three times the integration error that a solution aims at, as rates have other units than angles."""
MEASURED = 1e-9
"""Accuracy that is promised for the doubles of a gait, in SI."""


@cache
def traversed(name):
    """The equations of a proved gait, the box in which it is unique, and its motions."""
    statement = restored(proof(name).certificate)
    with ctx.workprec(PRECISION):
        equations, box = restore_box(statement, *statement.record.boxes)
        return equations, box, equations.enclose(box)


@pytest.mark.parametrize("name", NAMED)
def test_a_named_gait_is_proved_where_the_solver_and_the_simulator_find_it(name):
    result, solved = proof(name), gait(name)
    widest = next((width for start, width in WIDTHS.items() if name.startswith(start)), WIDTH)
    assert result.proved, failed(result)
    assert result.stable is STABLE[name]
    assert result.statement["mode_sequence"] == str(solved.cycle.untimed)
    assert check(certificate_of(name)).to_record() == result.to_record()
    for value, bounds in zip(solved.state, result.state.values(), strict=True):
        assert abs(float(bounds.mid()) - value) < STATE_TOLERANCE
        assert float(bounds.rad()) < (1e-15 if "wheel" in name else 1e-12)
    for (_, duration), bounds in zip(solved.phases, result.durations, strict=True):
        assert abs(float(bounds.mid()) - duration) < STATE_TOLERANCE
    for multiplier in solved.multipliers:
        assert min(abs(complex(m.mid()) - multiplier) for m in result.multipliers) < 1e-9
    for multiplier in result.multipliers:
        assert max(float(multiplier.real.rad()), float(multiplier.imag.rad())) < widest
    walked = measure(simulate(solved, steps=len(solved.steps)).trajectory.steps)
    vanishing = (walked["min_normal_force"] or 0.0) < 1e-6  # then no ratio of forces is bounded
    for key, bounds in result.measures.items():
        for value in (walked[key], solved.measures[key]):
            if bounds is None:
                assert value is None or (vanishing and key == "required_friction"), key
            else:
                assert arb(value, MEASURED).contains(bounds), key


def closed_form(slope):
    """Multiplier and rate after the impact of the sticking wheel."""
    kappa, half = arb("0.3333333333333333"), arb.pi() / 10
    beta = (kappa + (2 * half).cos()) / (1 + kappa)
    gain = 4 * ball(slope).sin() * half.sin() / (1 + kappa)
    return beta**2, (beta**2 * gain / (1 - beta**2)).sqrt()


def test_the_closed_form_of_the_sticking_wheel_lies_inside():
    result = proof("rimless-wheel-stick")
    with ctx.workprec(PRECISION):
        multiplier, rate = closed_form("13 deg")
        assert result.multipliers[0].real.contains(multiplier)
        assert result.state["dtheta"].contains(rate)
        assert result.measures["step_length"].contains(2 * (arb.pi() / 10).sin())


@pytest.mark.parametrize(
    ("name", "entry"),
    [("crawler", 2), *(pytest.param(n, 0, marks=() if n in QUICK else pytest.mark.slow) for n in STABLE)],
)
def test_a_box_beside_the_orbit_is_refused(name, entry):
    """A gap or a height of a contact is one more entry."""
    certificate = certificate_of(name)
    (box,) = certificate["boxes"]
    box["centre"][entry] = repr(float(box["centre"][entry]) + 1e-6)
    assert failures(certificate).keys() == {"existence and uniqueness"}


def test_a_wrong_mode_sequence_is_refused():
    phases = "phases: [stick, slip_forward]"
    certificate = reworded(certificate_of("rimless-wheel-slip"), (phases, "phases: [stick]"))
    assert "mode sequence" in failures(certificate)["statement"]
    assert failures(reworded(certificate_of("rimless-wheel-slip"), (phases, "phases: [stick, slip_backward]")))


"""Accuracy that is promised for the doubles of a gait, in SI."""


def test_parameters_other_than_those_of_the_problem_are_refused():
    certificate = certificate_of("rimless-wheel-stick")
    assert "parameters" not in certificate  # the checker reads them in the text
    assert failures(reworded(certificate, ("slope: 13 deg", "slope: 13.01 deg"))).keys() == {"existence and uniqueness"}
    certificate["designed"] = {"walker.slope": "13.01"}
    assert "not those that its problem leaves free: walker.slope" in failures(certificate)["statement"]


def test_an_arc_that_its_steps_overrun_and_a_box_that_krawczyk_does_not_map_into_itself_are_refused():
    certificate = certificate_of("rimless-wheel-stick")
    certificate["arcs"][0]["fractions"] = [1.1 * f for f in certificate["arcs"][0]["fractions"]]
    assert "a step of" in failures(certificate)["existence and uniqueness"]
    certificate["arcs"][0]["fractions"][0] = -0.1
    with pytest.raises(StorageError, match=r"arcs\.0\.fractions\.0"):
        failures(certificate)
    del certificate["arcs"][0]["fractions"][0]
    assert "does not fit" in failures(certificate)["statement"]
    certificate = certificate_of("rimless-wheel-stick")
    certificate["boxes"][0]["radii"] = ["1e-32"] * len(certificate["boxes"][0]["radii"])
    assert "Krawczyk" in failures(certificate)["existence and uniqueness"]


def test_sticking_is_refused_just_below_the_friction_that_it_needs():
    """It needs 0.91412078."""
    certificate = certificate_of("rimless-wheel-stick")
    for friction, refused in (("0.9142", False), ("0.9141", True)):
        certificate["problem"]["set"] = {"friction": float(friction)}
        words = failures(certificate)
        assert bool(words) is refused
    assert list(words) == ["arc 1, stick: cone_forward"]
    assert "at the end of the arc" in words["arc 1, stick: cone_forward"]


def test_the_multiplier_holds_saltation():
    """If rates did not change while an event comes later, it would be another one."""
    equations, box, cycle = traversed("rimless-wheel-slip")
    (expected,) = gait("rimless-wheel-slip").multipliers
    first = equations.system.n_shape + 1
    shapes = arb_mat([[int(i == j < first) for j in range(equations.n)] for i in range(equations.n)])
    still = [(i, j, shapes * block if j in equations.durations else block) for i, j, block in cycle.blocks]
    with ctx.workprec(PRECISION):
        derivatives = [
            orbit.return_map(equations, box, motions, orbit.precondition(equations, motions))[0, 0]
            for motions in (cycle, replace(cycle, blocks=still))
        ]
    assert abs(derivatives[0].mid() - expected.real) < 1e-9
    assert not derivatives[1].overlaps(derivatives[0])


def changed_impact(change, name=None):
    """Impacts one of whose margins, or all of them, are changed."""

    def mutation(impact):
        def margins(self, mode, j):
            graph, names = impact(self, mode, j), self.system.transitions.impact_margin_names(mode, self.arcs[j].mode)

            def spoiled(y):
                values, *rest = graph(y)
                pairs = zip(names, values, strict=True)
                return [[change(value) if name in (None, own) else value for own, value in pairs], *rest]

            return spoiled

        return margins

    return mutation


def singular(self, cycle):
    raise NotProved("singular")


WHEEL = "rimless-wheel-slip"
MUTATIONS = {
    "lift of the other foot": (WHEEL, orbit.Orbit, "impact", changed_impact(neg, "lift_velocity"), "impact"),
    "normal impulse": (WHEEL, orbit.Orbit, "impact", changed_impact(neg, "impulse"), "impact"),
    "cone of the impact": (WHEEL, orbit.Orbit, "impact", changed_impact(neg, "impulse_cone_forward"), "impact"),
    "another consistent impact": (WHEEL, orbit.Orbit, "impact", changed_impact(abs), "impact"),
    "impulse of a stop": ("hopper", orbit.Orbit, "impact", changed_impact(neg), "impact"),
    "zero at the start of a slip": (WHEEL, claims, "_order_of_zero", lambda order: lambda *_: 0, "slip_velocity"),
    "order of a slip": ("crawler", claims, "_order_of_zero", lambda order: lambda *_: 0, "slip_velocity.front"),
    "too high an order": ("crawler", claims, "_order_of_zero", lambda o: lambda *a: o(*a) and o(*a) + 1, "motion"),
    "order of a stop": ("hopper", claims, "zeros_after_impact", lambda order: lambda *_: 0, "leg"),
    "end of an arc": (WHEEL, claims, "ENDS", lambda pattern: "p+", "cone_forward"),
    "touchdown": (WHEEL, claims, "TOUCHDOWN", lambda pattern: "p+", "touchdown"),
    "direction of the slip": (WHEEL, claims, "SLIPS", lambda slips: slips[::-1], "mode at rest"),
    "apparent mass": (WHEEL, VectorField, "apparent_masses", lambda masses: negated(masses.func), "apparent mass"),
    "regularity": ("crawler", VectorField, "regularities", lambda old: negated(old.func), "unique forces"),
    "lift-off at rest": (WHEEL, VectorField, "margins", lambda margins: without_weight(margins.func), "mode at rest"),
    "section": ("crawler", orbit.Orbit, "require_section", lambda old: singular, "section"),
}
"""Named gait, owner, attribute and mutation of it, and the claim that notices it."""


def without_weight(graph):
    """Margins of a mode with a normal force of the other sign."""

    def margins(self):
        place = self._space.system.transitions.margin_names(self.mode).index("normal_force")
        return lambda y: [[-value if k == place else value for k, value in enumerate(v)] for v in graph(self)(y)]

    return property(margins)


@pytest.mark.parametrize(
    ("multipliers", "stable"),
    [((0.9, -0.1), True), ((acb(0, 1.1), 0.9), False), ((arb(-1, 0.1), 0.1), None), ((), None)],
)
def test_bounds_of_the_multipliers_decide_whether_a_gait_is_stable(multipliers, stable):
    assert Proof(problem="", claims=(), certificate={}, multipliers=tuple(map(acb, multipliers))).stable is stable


@pytest.mark.parametrize("mutation", MUTATIONS)
def test_a_mutation_of_the_checker_is_noticed(monkeypatch, mutation):
    name, owner, attribute, spoil, claim = MUTATIONS[mutation]
    certificate = certificate_of(name)
    monkeypatch.setattr(owner, attribute, spoil(getattr(owner, attribute)))
    assert any(claim in refused for refused in refusals(certificate))


def test_a_multiplier_that_may_be_one_leaves_the_return_map_unproved(monkeypatch):
    """Its derivative is 1 - H^-1; bounds that hold a singular H are a claim that is not proved."""
    equations, box, cycle = traversed("rimless-wheel-slip")
    with ctx.workprec(PRECISION):
        inverse = orbit.precondition(equations, cycle)
        monkeypatch.setattr(orbit, "matrix", lambda n, entries: arb_mat(len(entries) // n, n))
        with pytest.raises(NotProved, match="a multiplier may be one"):
            orbit.return_map(equations, box, cycle, inverse)


def test_without_the_motion_of_events_there_is_no_orbit():
    """The end of an arc moves with its duration; a derivative without that fails Krawczyk's test."""
    equations, box, _ = traversed("rimless-wheel-slip")
    wide = replace(box, deviation=[arb(0, 1e-4)] * equations.size)
    with ctx.workprec(PRECISION):
        right = equations.enclose(wide)
        spoiled_blocks = [block for block in right.blocks if block[1] not in equations.durations]
        image = orbit.krawczyk(equations, wide, right, orbit.precondition(equations, right))
        orbit.require_contraction(equations, wide, image)
        with pytest.raises(NotProved):
            orbit.precondition(equations, replace(right, blocks=spoiled_blocks))


def test_a_sticking_gait_is_proved_for_an_interval_of_friction():
    """Where friction does not enter the motion, one box is enough."""
    result = prove(gait("rimless-wheel-stick"), {"friction": "0.95..1"})
    assert result.proved
    assert len(result.certificate["boxes"]) == 1
    certificate = deepcopy(dict(result.certificate))
    certificate["intervals"]["friction"] = "0.91..1"
    assert failures(certificate).keys() == {"arc 1, stick: cone_forward"}
    with pytest.raises(UnknownNameError, match=r"walker\.slope"):
        prove(gait("rimless-wheel-stick"), {"slope": "13 deg..14 deg"})


@cache
def family():
    """The sticking wheel for all slopes of an interval, along which its state moves."""
    return prove(gait("rimless-wheel-stick"), {"walker.slope": "12.999 deg..13.001 deg"})


def test_an_interval_along_which_the_orbit_moves_is_covered_by_boxes():
    """The closed form at both ends lies inside."""
    result = family()
    assert result.proved
    assert len(result.certificate["boxes"]) == 2
    assert "connected family" in {claim.name for claim in result.claims}
    with ctx.workprec(PRECISION):
        for slope in ("12.999 deg", "13 deg", "13.001 deg"):
            multiplier, rate = closed_form(slope)
            assert result.state["dtheta"].contains(rate)
            assert result.multipliers[0].real.contains(multiplier)
    assert float(result.state["dtheta"].rad()) < 1e-3


@pytest.mark.slow
def test_a_long_family_is_covered():
    """The slipping wheel over two percent of its friction; the measures of gaits in between lie inside."""
    result = prove(gait("rimless-wheel-slip"), {"friction": "0.395..0.405"})
    assert result.proved, failed(result)
    for friction in (0.395, 0.4004, 0.405):
        other = solve(load_problem("rimless-wheel-slip").replace({"friction": friction}))
        assert result.state["dtheta"].contains(arb(other.scalar("state.dtheta"), 1e-9))
        assert result.multipliers[0].real.contains(arb(other.multipliers[0].real, 1e-9))


def test_boxes_that_do_not_meet_are_no_family():
    certificate = family().certificate
    with ctx.workprec(PRECISION):
        statement = restored(certificate)
        boxes = [check_box(statement, record) for record in statement.record.boxes]
        assert connection_claim(boxes, statement.interval).proved
        beyond = connection_claim(boxes, ("12.98 deg", "13.001 deg"))
        assert "both ends" in beyond.finding
        apart = connection_claim(
            [replace(boxes[0], interval=("12.999 deg", "12.9995 deg")), boxes[1]], statement.interval
        )
        moved = {
            name: replace(box, centre=[box.centre[0] + arb("1e-3"), *box.centre[1:]])
            for name, box in (("outer", boxes[0].outer), ("inner", boxes[0].inner))
        }
        elsewhere = connection_claim([replace(boxes[0], **moved), boxes[1]], statement.interval)
    for claim in (apart, elsewhere):
        assert not claim.proved
        assert "are not shown to hold the same orbit" in claim.finding


@pytest.mark.parametrize("part", ["centre", "tilt"])
def test_a_family_beside_its_orbits_is_refused(part):
    certificate = deepcopy(dict(family().certificate))
    values = certificate["boxes"][0][part]
    values[1] = repr(float(values[1]) + 1e-4)
    assert failures(certificate).keys() == {"existence and uniqueness"}


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        pytest.param("flat-foot", "more than 3600 unknowns", marks=pytest.mark.slow),
        ("slip-walk", "massless contacts with coordinates of their own"),
    ],
)
def test_what_no_proof_knows_is_refused_by_name(name, reason):
    assert not proof(name).proved
    assert reason in " ".join(failed(proof(name)).values())


class ForeignWheel(RimlessWheel):
    """A wheel of another package that is not registered."""

    model = "foreign_wheel"


@pytest.mark.slow
def test_a_walker_that_is_not_registered_is_proved_and_checked_with_its_class(tmp_path):
    text = load_problem("rimless-wheel-stick").text.replace("model: rimless_wheel", "model: foreign_wheel")
    result = prove(solve(parse_problem(text, walkers=[ForeignWheel])))
    assert result.proved, failed(result)
    assert check(dict(result.certificate), walkers=[ForeignWheel]).proved
    assert "foreign_wheel" in failures(result.certificate)["statement"]
    file = tmp_path / "proof.json"
    file.write_text(json.dumps(result.certificate))
    assert check_proof(file, walkers=[ForeignWheel]).proved
    assert "foreign_wheel" in failed(check_proof(file))["statement"]


@pytest.mark.slow
def test_an_interval_over_a_change_of_mode_is_refused():
    """Sticking needs 0.91412078 on 13 deg, and more where it is steeper."""
    problem = load_problem("rimless-wheel-stick").replace({"friction": 0.9142})
    result = prove(solve(problem), {"walker.slope": "12.999 deg..13.01 deg"})
    assert failed(result).keys() == {"arc 1, stick: cone_forward"}


def test_parameters_are_read_as_the_file_writes_them():
    problem = load_problem("rimless-wheel-stick")
    exact = ExactValues(write_problem(problem))
    assert exact("walker.slope", problem.walker.slope) == "13 deg"
    assert exact("walker.inertia_ratio", problem.walker.inertia_ratio) == "0.3333333333333333"
    assert exact("friction", 0.1) == "0.1"  # not the value of the file
    changed = problem.replace({"friction": 0.95, "walker.slope": 0.2})
    exact = ExactValues(write_problem(changed))
    assert (exact("friction", 0.95), exact("walker.slope", 0.2)) == ("0.95", "0.2")
    with ctx.workprec(128):
        assert ball("0.1").overlaps(arb(1) / 10)
        assert not ball("0.1").contains(arb(0.1))
        assert ball("180 deg").overlaps(arb.pi())
    with pytest.raises(ValueError, match="not an exact value"):
        ball("1 grad")


@pytest.mark.slow
def test_where_gait_a_loses_stability():
    """The Neimark-Sacker point of the passive compass: a bracket of 1e-8 in friction, the family in it proved."""
    problem = load_problem("compass-passive-a").replace({"friction": 0.11034958077937082})
    result = prove_special(solve(problem), "friction", "neimark_sacker")
    assert result.proved, failed(result)
    assert "complex pair" in {claim.name: claim.finding for claim in result.claims}["sign change"]
    assert failures(result.certificate) == {}
    assert failures({**result.certificate, "special": "period_doubling"}).keys() == {"sign change"}


def test_an_orbit_with_more_unknowns_than_a_certificate_may_have_is_not_proved(monkeypatch):
    monkeypatch.setattr("gaitopt.proof.prove.MOST_UNKNOWNS", 10)
    result = prove(gait("rimless-wheel-slip"), progress=False)
    (claim,) = result.claims
    assert not result.proved
    assert "the orbit has more than 10 unknowns" in claim.finding
