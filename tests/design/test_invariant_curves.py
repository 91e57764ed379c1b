"""Designs of virtual constraints that the impact leads back to: hybrid invariance as equations of the design."""

import numpy as np
import pytest
from named import verified

import gaitopt as go

COMPASS = """
name: invariant-compass
walker: {model: compass_biped, leg_length: 1.6, leg_mass: 4, leg_com: 0.8, hip_mass: 2, gravity: 9.8, slope: 0}
friction: FRICTION
control:
  type: virtual_constraints
  outputs: [theta2]
  phase: theta1
  span: [-0.1, 0.1]
  reference: REFERENCE
  gains: {kp: 36, kd: 12}
  model: actual
gait:
  phases: PHASES
  impact: IMPACT
  guess: {state: STATE}
objective: torque_squared
constraints: {speed: SPEED}
"""
POINTS = [-0.1, -0.127, -0.045, 0.419, 0.156, 0.139, 0.1]
CURVE = f"{{curve: {{degree: 6, within: 0.9, invariant: true, points: {{theta2: {POINTS}}}}}}}"
STICKS = {
    "FRICTION": "0.25", "PHASES": "[stick]", "IMPACT": "stick", "SPEED": "0.25", "REFERENCE": CURVE,
    "STATE": "{theta1: -0.1, dtheta1: 0.46, dtheta2: -0.373}",
}  # fmt: skip


def stated(**changes):
    text = COMPASS
    for key, value in {**STICKS, **changes}.items():
        text = text.replace(key, value)
    return go.parse_problem(text)


def after_impact(gait):
    """The largest output and rate just after the impact, by the simulator."""
    walk, system = go.simulate(gait, steps=2), gait.system
    arc = walk.trajectory.steps[1].arcs[0]
    known = system.quantities(arc.mode)(t=0, z=arc.states[0], p=gait.p, r=system.data(arc.segment))
    return max(float(np.abs(np.asarray(known[name])).max()) for name in ("outputs", "rates"))


def test_a_design_finds_curves_that_the_impact_leads_back_to():
    gait = verified(stated())
    assert after_impact(gait) < 1e-10
    zero = gait.to_record()["zero_dynamics"]
    assert zero["invariant"]
    assert zero["delta_squared"] == pytest.approx(gait.spectral_radius, abs=1e-8)
    assert gait.measures["speed"] == pytest.approx(0.25, abs=1e-9)


@pytest.mark.slow
def test_invariance_costs_torque():
    free = go.solve(stated(REFERENCE=CURVE.replace("invariant: true, ", "")), progress=False)
    assert free.measures["torque_squared"] < go.solve(stated(), progress=False).measures["torque_squared"]
    assert after_impact(free) > 0.01


@pytest.mark.slow
def test_a_design_with_slip_is_invariant_too():
    problem = go.load_problem("compass-virtual-constraint-slip")
    given = go.solve(problem, progress=False)
    bezier = {
        "theta2": [{"free": [c - 0.15, c + 0.15], "guess": c} for c in problem.control.reference.points["theta2"]]
    }
    changes = {"control.reference": {"bezier": bezier, "invariant": True}, "control.model": "actual"}
    changes |= {"gait.phases": ["stick", "slip_backward"], "gait.guess.durations": [1.418, 0.0435]}
    changes |= {"objective": {"torque_squared": 1.0}}
    changes["constraints"] = {name: given.measures[name] for name in ("slip_distance", "speed")}
    gait = verified(problem.replace(changes))
    assert after_impact(gait) < 1e-10
    assert gait.measures["torque_squared"] < given.measures["torque_squared"]


def test_curves_that_cannot_be_invariant_are_refused():
    with pytest.raises(go.GaitoptError, match=r"reference\.invariant: needs two free control points"):
        stated(REFERENCE=f"{{bezier: {{theta2: {POINTS}}}, invariant: true}}")
    with pytest.raises(go.GaitoptError, match=r"control\.law: pd does not keep the outputs at zero"):
        stated(REFERENCE=f"{CURVE}\n  law: pd")
    assert not stated(REFERENCE=CURVE.replace("true", "false")).control.is_invariant
    curve = {"degree": 3, "start": "compass-passive-stick", "invariant": True}
    with pytest.raises(go.GaitoptError, match=r"curve\.invariant: applies to virtual_constraints"):
        go.load_problem("compass-pd-designed").replace({"control.reference": {"curve": curve, "beyond_end": "hold"}})
