"""Proofs of gaits: closed forms lie inside, this project's values lie next to them, and what is false is refused."""

from copy import deepcopy
from functools import cache

import numpy as np
import pytest

flint = pytest.importorskip("flint")
from flint import arb, ctx  # noqa: E402

from gaitopt import load_problem, prove, solve  # noqa: E402
from gaitopt.errors import UnknownNameError  # noqa: E402
from gaitopt.proof import check, make_certificate, orbit  # noqa: E402
from gaitopt.proof.parameters import ball, exact_texts  # noqa: E402

WHEELS = ("rimless-wheel-stick", "rimless-wheel-slip")
OTHERS = {
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
}
STATE_TOLERANCE = 3e-11
"""The estimated integration error of the gaits that are proved is 2e-11."""


@cache
def gait(name, friction=None):
    problem = load_problem(name)
    return solve(problem if friction is None else problem.replace({"friction": friction}))


@cache
def proof(name, friction=None):
    return prove(gait(name, friction))


def failures(certificate):
    return {claim.name: claim.words for claim in check(certificate).claims if not claim.proved}


def encloses(result, found):
    """Whether a gait in doubles lies next to its proof."""
    state = [abs(float(box.mid()) - value) for box, value in zip(result.state.values(), found.state, strict=True)]
    multipliers = [complex(m.real.mid(), m.imag.mid()) for m in result.multipliers]
    distances = [min(abs(m - other) for other in multipliers) for m in found.multipliers]
    return max(state) < STATE_TOLERANCE and max(distances) < 1e-9


@pytest.mark.parametrize("name", [pytest.param(WHEELS[0], marks=pytest.mark.slow), WHEELS[1]])
def test_a_wheel_is_proved(name):
    result = proof(name)
    assert result.proved
    assert result.stable
    assert encloses(result, gait(name))
    assert max(float(box.rad()) for box in result.state.values()) < 1e-15
    assert all(float(m.real.rad()) < 1e-9 for m in result.multipliers)


def test_the_closed_form_of_the_sticking_wheel_lies_inside():
    result = proof("rimless-wheel-stick")
    with ctx.workprec(128):
        kappa, slope, half = arb("0.3333333333333333"), 13 * arb.pi() / 180, arb.pi() / 10
        beta = (kappa + (2 * half).cos()) / (1 + kappa)
        gain = 4 * slope.sin() * half.sin() / (1 + kappa)
        assert result.multipliers[0].real.contains(beta**2)
        assert result.state["dtheta"].contains((beta**2 * gain / (1 - beta**2)).sqrt())
        assert result.measures["step_length"].contains(2 * half.sin())


@pytest.mark.slow
@pytest.mark.parametrize(("name", "stable"), OTHERS.items())
def test_every_other_named_gait_is_proved(name, stable):
    result = proof(name)
    assert result.proved, [claim for claim in result.claims if not claim.proved]
    assert result.stable is stable
    assert encloses(result, gait(name))
    assert max(float(box.rad()) for box in result.state.values()) < 1e-12
    assert all(float(m.real.rad()) < 1e-6 and float(m.imag.rad()) < 1e-6 for m in result.multipliers)


def test_a_certificate_is_checked_again_from_its_text():
    result = proof("rimless-wheel-slip")
    again = check(dict(result.certificate))
    assert again.to_record() == result.to_record()


@pytest.mark.parametrize("name", [*WHEELS, *(pytest.param(name, marks=pytest.mark.slow) for name in OTHERS)])
def test_a_box_beside_the_orbit_is_refused(name):
    certificate = deepcopy(dict(proof(name).certificate))
    shifted = float(certificate["centre"][0]) + 1e-6
    certificate["centre"][0] = repr(shifted)
    assert failures(certificate).keys() == {"existence and uniqueness"}


def test_a_wrong_mode_sequence_is_refused():
    certificate = deepcopy(dict(proof("rimless-wheel-slip").certificate))
    certificate["resolved"]["gait"]["phases"] = ["stick"]
    assert "mode sequence" in failures(certificate)["statement"]
    backward = deepcopy(dict(proof("rimless-wheel-slip").certificate))
    backward["resolved"]["gait"]["phases"] = ["stick", "slip_backward"]
    backward["arcs"][1]["mode"] = "slip_backward"
    assert failures(backward)


def test_an_event_that_does_not_end_its_arc_is_refused():
    certificate = deepcopy(dict(proof("rimless-wheel-slip").certificate))
    certificate["arcs"][0]["event"] = "cone_backward"
    assert "arc 1" in failures(certificate)["statement"]


def test_parameters_other_than_those_of_the_problem_are_refused():
    certificate = deepcopy(dict(proof("rimless-wheel-stick").certificate))
    certificate["parameters"]["walker.slope"] = "13.01 deg"
    assert "walker.slope" in failures(certificate)["statement"]


def test_another_control_than_that_of_the_problem_is_refused():
    certificate = deepcopy(dict(proof("rimless-wheel-stick").certificate))
    compass = load_problem("compass-torque-stick")
    certificate["resolved"] = compass.resolved()
    texts = {"walker.slope": "0", "friction": "0.2"}
    certificate["parameters"] = {key: texts.get(key, repr(value)) for key, value in compass.parameters.items()}
    assert "control.ankle, control.hip" in failures(certificate)["statement"]


def test_sticking_is_refused_just_below_the_friction_that_it_needs():
    """It needs 0.91412078."""
    certificate = deepcopy(dict(proof("rimless-wheel-stick").certificate))
    for friction, refused in (("0.9142", False), ("0.9141", True)):
        certificate["parameters"]["friction"] = friction
        certificate["resolved"]["friction"] = float(friction)
        failed = failures(certificate)
        assert bool(failed) is refused
    assert list(failed) == ["arc 1, stick: cone_forward"]
    assert "is not shown" in failed["arc 1, stick: cone_forward"]


def test_a_step_whose_speeds_are_too_narrow_is_refused():
    certificate = deepcopy(dict(proof("rimless-wheel-stick").certificate))
    speeds = certificate["arcs"][0]["steps"][0][1]
    speeds[2][1] = speeds[2][0] + 1e-3
    assert "rate of dtheta" in failures(certificate)["existence and uniqueness"]


def test_a_spoiled_saltation_is_noticed(monkeypatch):
    """Without what it takes away at an event, the multipliers are others or none."""
    found = gait("rimless-wheel-slip")
    columns = orbit.Orbit.return_map

    def without(self, passage):
        n_xi, m = len(self.section), len(self.arcs)
        return orbit._block(passage.slope, m, n_xi, 0, n_xi) + orbit.identity(n_xi)

    monkeypatch.setattr(orbit.Orbit, "return_map", without)
    spoiled = check(proof("rimless-wheel-slip").certificate)
    assert not encloses(spoiled, found)
    monkeypatch.setattr(orbit.Orbit, "return_map", columns)
    assert encloses(check(proof("rimless-wheel-slip").certificate), found)


@pytest.mark.parametrize("quantity", ["lift_velocity", "impulse"])
def test_a_wrong_sign_in_the_impact_is_noticed(monkeypatch, quantity):
    impact = orbit.Orbit.impact

    def spoiled(self, mode, z):
        result = impact(self, mode, z)
        value = getattr(result, quantity)
        return orbit.replace(result, **{quantity: [-f for f in value] if isinstance(value, list) else -value})

    monkeypatch.setattr(orbit.Orbit, "impact", spoiled)
    assert "impact" in failures(proof("rimless-wheel-slip").certificate)


def test_a_sticking_gait_is_proved_for_an_interval_of_friction():
    found = gait("rimless-wheel-stick")
    assert prove(found, {"friction": "0.95..1"}).proved
    failed = [claim.name for claim in prove(found, {"friction": "0.91..1"}).claims if not claim.proved]
    assert failed == ["arc 1, stick: cone_forward"]
    with pytest.raises(UnknownNameError, match=r"walker\.slope"):
        prove(found, {"slope": "13 deg..14 deg"})


def test_an_interval_in_which_the_orbit_moves_far_is_refused():
    result = prove(gait("rimless-wheel-slip"), {"friction": "0.399..0.401"})
    assert not result.proved
    assert result.claims[0].name == "existence and uniqueness"


def test_parameters_are_read_as_the_file_writes_them():
    problem = load_problem("rimless-wheel-stick")
    found = gait("rimless-wheel-stick")
    values = dict(zip(found.system.parameters, found.p, strict=True))
    texts = exact_texts(problem, found.system, values)
    assert texts["walker.slope"] == "13 deg"
    assert texts["walker.inertia_ratio"] == "0.3333333333333333"
    changed = exact_texts(problem, found.system, {**values, "friction": 0.1})
    assert changed["friction"] == "0.1"
    with ctx.workprec(128):
        assert ball("0.1").overlaps(arb(1) / 10)
        assert not ball("0.1").contains(arb(0.1))
        assert ball("180 deg").overlaps(arb.pi())
    with pytest.raises(ValueError, match="no exact value"):
        ball("1 grad")


def test_what_is_searched_is_no_part_of_the_proof():
    """A certificate holds everything, and its box is centred on the gait."""
    found = gait("rimless-wheel-slip")
    certificate = make_certificate(found)
    durations = [duration for _, duration in found.phases]
    assert np.allclose([float(x) for x in certificate["centre"]], [found.state[2], *durations], rtol=1e-11)
