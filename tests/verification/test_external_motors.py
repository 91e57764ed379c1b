"""Motors that push a walker from outside: a wind on every mass does what a slope does, and a tow does its work."""

import re
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from casadi import SX, Function
from named import named, solved

import gaitopt as go
from gaitopt.engines.plant import Reference
from gaitopt.errors import ProblemError
from gaitopt.gait import curves
from gaitopt.gait.measures import observe
from gaitopt.model.declaration import actuator_units
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.crawler import Crawler

SLOPE = np.radians(1)
G = 9.8


class WindyCompass(CompassBiped):
    """A compass whose masses a horizontal wind pushes in proportion to their mass."""

    model = "windy_compass"
    actuators = ("wind",)
    external = ("wind",)
    tracked = ()

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> go.Mechanism:
        """The wind acts on the centre of mass."""
        plain = super().mechanism(q, p)
        mass = sum(body.mass for body in plain.bodies)
        return replace(plain, motors=(sum((body.mass * body.position[0] for body in plain.bodies), SX(0)) / mass,))


class TowedCrawler(Crawler):
    """A crawler whose front is towed by a rope that points upward."""

    model = "towed_crawler"
    actuators = ("drive", "tow")
    external = ("tow",)
    tracked = ()

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> go.Mechanism:
        """The rope has the direction (0.8, 0.6)."""
        rope = 0.8 * (q.x + q.gap) + 0.6 * (q.y + q.rise)
        return replace(super().mechanism(q, p), motors=(q.gap, rope))


@cache
def windy() -> go.Gait:
    """The passive compass on level ground, in a wind that has the effect of its slope."""
    text = go.load_problem("compass-passive-a").text
    text = text.replace("compass_biped", "windy_compass")
    text = text.replace("gravity: 9.8 ", f"gravity: {float(G * np.cos(SLOPE))!r} ")
    text = text.replace("slope: 1 deg", "slope: 0")
    text += f"control: {{type: constant_torque, wind: {float(10 * G * np.sin(SLOPE))!r}}}\n"
    return solved(go.parse_problem(text, walkers=[WindyCompass]))


def test_a_wind_on_level_ground_is_a_slope() -> None:
    """Motion, contact forces, slips and multipliers are the same; the wind does the work of gravity."""
    passive, gait = named("compass-passive-a"), windy()
    assert gait.period == pytest.approx(passive.period, abs=1e-10)
    np.testing.assert_allclose(gait.state, passive.state, atol=1e-10)
    np.testing.assert_allclose(gait.multipliers, passive.multipliers, atol=1e-8)
    for ours, theirs in zip(gait.arcs, passive.arcs, strict=True):
        np.testing.assert_allclose(observe(ours).force, observe(theirs).force, atol=1e-7)
    assert gait.measures["cost_of_transport"] == pytest.approx(np.tan(SLOPE), rel=1e-9)
    assert gait.measures["slip_distance"] == pytest.approx(passive.measures["slip_distance"], rel=1e-8)
    verification = go.verify(gait)
    assert verification.passed
    assert "energy balance" in {claim.name for claim in verification.claims}
    with pytest.raises(ProblemError, match="windy_compass has motors that push from outside; the engines cannot model"):
        Reference(gait)


def test_the_momentum_along_the_ground_changes_by_friction_and_wind() -> None:
    """Differences of the positions of the masses alone show it: m d2X/dt2 = f_t + F."""
    gait = windy()
    problem, force = gait.problem, gait.problem.parameters["control.wind"]
    eom = go.equations_of_motion(WindyCompass)
    mass_place = sum((body.mass * body.position[0] for body in eom.mechanism.bodies), SX(0))
    place = Function("place", [eom.z, eom.p], [mass_place])
    p = [getattr(problem.walker, name) for name in WindyCompass.model_fields]
    walk = go.simulate(gait, steps=1)
    assert len(walk.trajectory.steps[0].arcs) == 3
    for arc in walk.trajectory.steps[0].arcs:
        n = arc.times.size - 1
        X = np.array([float(place(state, p)) for state in arc.states])
        s = 2 * (arc.times - arc.start) / arc.duration - 1
        fit = np.polynomial.chebyshev.Chebyshev.fit(s, X, n)
        acceleration = fit.deriv(2)(s) * (2 / arc.duration) ** 2
        np.testing.assert_allclose(acceleration, observe(arc).force[:, 0] + force, atol=1e-3 * abs(force))


def test_a_tow_changes_both_forces_of_its_contact_and_does_work() -> None:
    tow, text = 0.2, go.load_problem("crawler").text.replace("model: crawler", "model: towed_crawler")
    text = re.sub("{drive: (-?4.95)}", rf"{{drive: \1, tow: {tow}}}", text)
    gait, plain = go.solve(go.parse_problem(text, walkers=[TowedCrawler]), progress=False), named("crawler")
    assert gait.converged
    advance = gait.measures["step_length"]
    assert advance > plain.measures["step_length"] + 1e-3
    assert go.verify(gait).passed
    normal = [observe(arc).force[:, 1::2].sum(axis=1) for arc in gait.arcs]
    weight = 2.5 * 9.81 * np.cos(0.1)
    np.testing.assert_allclose(np.concatenate(normal), weight - 0.6 * tow, rtol=1e-9)
    work = sum(curves.integral(observe(arc).power[:, 1], arc.duration) for arc in gait.arcs)
    assert work == pytest.approx(0.8 * tow * advance, rel=1e-9)
    assert actuator_units(WindyCompass) == {"wind": "N"}
    assert actuator_units(TowedCrawler) == {"drive": "N", "tow": "N"}


def spoiled(attributes: dict[str, Any], motor: Any) -> type[CompassBiped]:
    def mechanism(cls: Any, q: SimpleNamespace, p: SimpleNamespace) -> go.Mechanism:
        return replace(CompassBiped.mechanism(q, p), motors=(motor(q),))

    own = {"model": "spoiled", "actuators": ("wind",), "tracked": (), "__module__": __name__}
    return type("Spoiled", (CompassBiped,), {**own, "mechanism": classmethod(mechanism), **attributes})


@pytest.mark.parametrize(
    ("attributes", "motor", "words"),
    [
        ({}, lambda q: q.x, r"Mechanism.motors\[0\] must be a function of the shape coordinates and parameters; name"),
        ({"external": ("wind",)}, lambda q: q.x**2, r"Mechanism.motors\[0\] must depend on x with a constant factor"),
        ({"external": ("wind",)}, lambda q: q.x * q.theta1, r"must depend on x with a constant factor: the place"),
        ({"external": ("tow",)}, lambda q: q.x, "external names tow, which is not an actuator"),
        ({"external": "wind"}, lambda q: q.x, "external is 'wind', but must be a tuple of names"),
    ],
)
def test_only_a_motor_that_the_class_names_pushes_the_base(attributes: dict[str, Any], motor: Any, words: str) -> None:
    text = windy().problem.text.replace("windy_compass", "spoiled")
    with pytest.raises(ProblemError, match=words):
        go.parse_problem(text, walkers=[spoiled(attributes, motor)])
