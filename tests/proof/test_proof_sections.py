"""Proofs of gaits whose feet swap roles within the cycle, which ends at a margin or with a clock."""

import json
from dataclasses import replace
from functools import cache
from math import pi

import pytest
from casadi import sin

flint = pytest.importorskip("flint")
from named import named  # noqa: E402
from own_laws import MidCompass  # noqa: E402

from gaitopt import parse_problem, prove, solve  # noqa: E402
from gaitopt.gait import curves  # noqa: E402
from gaitopt.model.clocked import Period  # noqa: E402
from gaitopt.model.control import Control  # noqa: E402
from gaitopt.model.walkers.heel_toe import HeelToe  # noqa: E402
from gaitopt.model.walkers.kneed import KneedWalker  # noqa: E402
from gaitopt.model.walkers.push_off import PushOffCompass  # noqa: E402
from gaitopt.model.walkers.rimless_wheel import RimlessWheel  # noqa: E402
from gaitopt.problem.statement import problem_data  # noqa: E402
from gaitopt.proof.check import check  # noqa: E402


def with_section(base, name, at, touchdown=None, place=0.0, factor=1.0):
    """A walker with a margin that falls to zero where its first coordinate is ``at``, and another touchdown.

    The margin also vanishes where this coordinate is zero or ``factor``, if that is not one.
    """

    class Sectioned(base):
        model = name
        sections = ("middle",)

        @classmethod
        def mechanism(cls, q, p):
            plain, (first, *_) = super().mechanism(q, p), cls.shape
            guard = plain.touchdown if touchdown is None else plain.touchdown * touchdown(vars(q)[first])
            angle = vars(q)[first]
            factors = 1.0 if factor == 1.0 else angle * (angle - factor)
            margins = {"middle": lambda dq: (at - angle - place * q.x) * factors}
            return replace(plain, sections=margins, touchdown=guard)

    return Sectioned


MidWheel = with_section(RimlessWheel, "mid_wheel", 0.0)
WALKERS = {
    "rimless-wheel-slip": MidWheel,
    "compass-passive-a": MidCompass,
    "compass-push-off": with_section(PushOffCompass, "mid_push_off", 0.05),
    "kneed-passive": with_section(KneedWalker, "mid_kneed", -0.2),
    "heel-toe": with_section(HeelToe, "mid_heel_toe", 0.1),
    "heel-toe-slip": with_section(HeelToe, "mid_heel_toe", 0.1),
}
STRIDE_FROM = {"compass-push-off": 0.05, "kneed-passive": -0.2, "heel-toe": 0.1, "heel-toe-slip": 0.1}


class HipClock(Control):
    """A spring in the hip whose rest length oscillates, whatever the feet do."""

    type = "hip_clock"
    restarts = False
    cycle: Period

    @property
    def period(self):
        return self.cycle

    def torques(self, now):
        angle = now.robot.mechanism.motors[now.robot.walker.actuators.index("hip")]
        return {"hip": 0.3 * (0.3 * sin(2 * pi * now.t / self.cycle) - angle)}


@cache
def mid_stride(name, at=None, walker=None):
    """A named gait from the middle of a stride, or from ``at``, to the next one."""
    plain, walker, at = named(name), walker or WALKERS[name], STRIDE_FROM.get(name, 0.0) if at is None else at
    k = next(k for k, arc in enumerate(plain.arcs) if arc.states[0, 0] < at < arc.states[-1, 0])
    states = plain.arcs[k].states
    (here,) = curves.evaluate(curves.coefficients(states), curves.roots(states[:, 0] - at))
    data, impact = problem_data(plain.problem), plain.cycle.impact
    phases = [mode.data if isinstance(mode.data, dict) else {"mode": mode.data} for mode in plain.cycle.phases]
    struck = str(impact.contact)
    if impact.is_named:
        struck = {n: "leaves" if word == "off" else word for n, word in impact.contacts.items() if "swing" not in n}
        struck["feet"] = "swapped"
    gait = {
        "section": {"margin": "middle"},
        "phases": [*phases[k:], {**phases[0], "impact": struck}, *phases[1 : k + 1]],
        "guess": {"state": {n: float(v) for n, v in zip(plain.system.state_names, here, strict=True) if n != "x"}},
    }
    changed = data | {"walker": data["walker"] | {"model": walker.model}, "gait": gait}
    gait = solve(parse_problem(json.dumps(changed), walkers=[walker]), progress=False)
    assert gait.converged, gait.message
    return gait


def failed(result):
    return {claim.name: claim.words for claim in result.claims if not claim.proved}


@cache
def certificate_text():
    return json.dumps(prove(mid_stride("rimless-wheel-slip")).certificate)


QUICK = ("rimless-wheel-slip",)


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in WALKERS])
def test_a_gait_is_proved_wherever_its_cycle_begins(name):
    gait, plain = mid_stride(name), named(name)
    result = prove(gait)
    assert result.proved, failed(result)
    assert result.stable
    assert result.minimal_period
    for key in ("period", "step_length", "work", "required_friction"):
        assert abs(float(result.measures[key].mid()) - plain.measures[key]) < 1e-9, key
        assert abs(gait.measures[key] - plain.measures[key]) < 1e-9, key
    assert abs(float(result.spectral_radius.mid()) - plain.spectral_radius) < 1e-7
    again = check(json.loads(json.dumps(result.certificate)), walkers=[WALKERS[name]])
    assert again.proved
    assert [claim.name for claim in again.claims] == [claim.name for claim in result.claims]


@pytest.mark.slow
def test_a_compass_on_a_free_clock_is_proved():
    data = problem_data(named("compass-passive-a").problem)
    gait = {
        "section": "clock",
        "phases": ["stick", "slip_backward", {"mode": "slip_forward", "impact": "stick"}, "stick"],
        "guess": {"state": {"theta1": -0.0751, "theta2": -0.1479, "dtheta1": 0.3936, "dtheta2": 0.3549}},
    }
    control = {"type": "hip_clock", "cycle": named("compass-passive-a").scalar("period")}
    walk = solve(parse_problem(json.dumps(data | {"control": control, "gait": gait}), controls=[HipClock]))
    result = prove(walk)
    assert result.proved, failed(result)
    assert result.measures["period"].overlaps(flint.arb(control["cycle"]))
    assert abs(float(result.measures["work"].mid()) - walk.measures["work"]) < 1e-12
    assert abs(float(result.spectral_radius.mid()) - walk.spectral_radius) < 1e-6
    assert check(json.loads(json.dumps(result.certificate)), controls=[HipClock]).proved


@pytest.mark.parametrize(
    ("change", "refused"),
    [
        # the foot comes down before the section, passes the ground, and rises again
        ({"touchdown": lambda angle: ((angle + 0.1) ** 2 - 0.05**2) / 0.05}, {"arc 2, slip_forward: touchdown"}),
        # the margin has a zero before that which is said to end the cycle
        ({"at": 0.05}, {"existence and uniqueness"}),
        # the section is at another place of the slope each time
        ({"place": 0.1}, {"statement"}),
    ],
)
def test_a_landing_or_a_section_that_the_certificate_conceals_is_refused(change, refused):
    walker = with_section(RimlessWheel, "mid_wheel", **{"at": 0.0, **change})
    result = check(json.loads(certificate_text()), walkers=[walker])
    assert failed(result).keys() == refused, failed(result)


def test_a_fall_to_zero_just_before_a_landing_is_not_that_which_ends_the_cycle():
    """The margin falls to zero just before the landing, jumps with the angle, and falls to zero once more."""
    early = with_section(RimlessWheel, "mid_wheel", -0.309)
    data = json.loads(json.dumps(prove(mid_stride("rimless-wheel-slip", -0.309, early)).certificate))
    *_, last = data["arcs"]
    (box,), n, arcs = data["boxes"], 5, len(data["arcs"])
    assert len(last["fractions"]) == 1
    last["fractions"] = []  # one step, along which the margin is said to fall, whatever its sign
    for values in (box["centre"], box["tilt"], box["radii"]):
        del values[-arcs - 2 * n : -arcs - n]
    twice = with_section(RimlessWheel, "mid_wheel", -0.309, factor=0.3138)
    refused = failed(check(data, walkers=[twice]))
    assert refused.keys() == {"middle"}
    assert refused["middle"].startswith("middle is [-7.0")  # just before the landing


def test_a_landing_within_the_cycle_cannot_be_left_out_of_a_certificate():
    data = json.loads(certificate_text())
    merged = {**data, "arcs": [data["arcs"][0], data["arcs"][1], {**data["arcs"][2], "phase": 1}]}
    assert failed(check(merged, walkers=[MidWheel])).keys() == {"statement"}
    twice = {**data, "arcs": [*data["arcs"], data["arcs"][2]]}
    assert failed(check(twice, walkers=[MidWheel])).keys() == {"statement"}
