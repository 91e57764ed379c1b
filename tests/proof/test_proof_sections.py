"""Proofs of gaits whose feet swap roles within the cycle, which ends at a margin or with a clock."""

import json
from functools import cache

import pytest
from certificates import failed, through_json
from flint import arb
from mid_stride import WALKERS, HipClock, clocked, entrained, mid_stride_gait, with_section
from named import named

from gaitopt import prove
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.proof.check import check


@cache
def proof(name):
    return prove(mid_stride_gait(name))


def certificate_text():
    return json.dumps(proof("rimless-wheel-slip").certificate)


QUICK = ("rimless-wheel-slip",)


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in WALKERS])
def test_a_gait_is_proved_wherever_its_cycle_begins(name):
    gait, plain = mid_stride_gait(name), named(name)
    result = proof(name)
    assert result.proved, failed(result)
    assert result.stable
    assert result.minimal_period
    for key in ("period", "step_length", "work", "required_friction"):
        assert abs(float(result.measures[key].mid()) - plain.measures[key]) < 1e-9, key
        assert abs(gait.measures[key] - plain.measures[key]) < 1e-9, key
    assert abs(float(result.spectral_radius.mid()) - plain.spectral_radius) < 1e-7
    again = check(through_json(result.certificate), walkers=[WALKERS[name]])
    assert again.proved
    assert [claim.name for claim in again.claims] == [claim.name for claim in result.claims]


@pytest.mark.slow
def test_a_compass_on_a_free_clock_is_proved():
    walk = entrained()
    result = prove(walk)
    assert result.proved, failed(result)
    assert result.measures["period"].overlaps(arb(clocked()["cycle"]))
    assert abs(float(result.measures["work"].mid()) - walk.measures["work"]) < 1e-12
    assert abs(float(result.spectral_radius.mid()) - walk.spectral_radius) < 1e-6
    assert check(through_json(result.certificate), controls=[HipClock]).proved


@pytest.mark.parametrize(
    ("change", "refused"),
    [
        # the foot comes down before the section, passes the ground, and rises again
        ({"touchdown": lambda angle: ((angle + 0.1) ** 2 - 0.05**2) / 0.05}, {"arc 2, slip_forward: touchdown"}),
        # the margin has a zero before that which is said to end the cycle
        ({"at": 0.05}, {"existence and uniqueness"}),
        # the section moves along the slope from step to step
        ({"by_x": 0.1}, {"statement"}),
    ],
)
def test_a_landing_or_a_section_that_the_certificate_conceals_is_refused(change, refused):
    walker = with_section(RimlessWheel, "mid_wheel", **{"at": 0.0, **change})
    result = check(json.loads(certificate_text()), walkers=[walker])
    assert failed(result).keys() == refused, failed(result)


def test_a_fall_to_zero_just_before_a_landing_is_not_that_which_ends_the_cycle():
    """The margin falls to zero just before the landing, jumps with the angle, and falls to zero once more."""
    early = with_section(RimlessWheel, "mid_wheel", -0.309)
    data = through_json(prove(mid_stride_gait("rimless-wheel-slip", -0.309, early)).certificate)
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
    arcs = data["arcs"]
    for wrong in ([arcs[0], arcs[1], {**arcs[2], "phase": 1}], [*arcs, arcs[2]]):
        result = check(data | {"arcs": wrong}, walkers=[WALKERS["rimless-wheel-slip"]])
        assert failed(result).keys() == {"statement"}
