"""Dampers and springs in joints: the torso and the telescopic leg against equations of their own."""

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from casadi import vertcat
from named import named, verification
from oracles import constrained, slope_gravity, up
from scipy.integrate import solve_ivp

import gaitopt as go
from gaitopt import Damper, Mode, check_walker
from gaitopt.gait.measures import observe
from gaitopt.model.walkers.telescopic import TelescopicCompass


def torso_positions(w, q):
    """Leg, leg, torso of ``torso_walker``, in rows; q = (theta1, theta2, torso)."""
    hip = w.leg_length * up(q[0])
    return np.array([
        w.leg_com * up(q[0]), hip - (w.leg_length - w.leg_com) * up(-q[1]), hip + w.torso_com * up(q[2]),
    ])  # fmt: skip


def torso_forces(w, q, dq):
    """Springs and dampers of both hips: what acts on theta1, theta2 and torso."""
    stance, swing = (w.hip_stiffness * a + w.hip_damping * r for a, r in ((q[2] - q[0], dq[2] - dq[0]),
                                                                          (q[2] + q[1], dq[2] + dq[1])))  # fmt: skip
    return np.array([stance, -swing, -stance - swing])


def telescopic_positions(w, q):
    """Leg, hip, leg of ``telescopic_compass``, in rows; q = (theta1, theta2, retraction)."""
    hip = w.leg_length * up(q[0])
    foot = hip - w.leg_length * (1 - q[2]) * up(-q[1])
    return np.array([w.leg_com * up(q[0]), hip, foot + w.leg_com * up(-q[1])])


def telescopic_forces(w, q, dq):
    shortened = w.leg_length * q[2]
    force = -w.stiffness * (shortened - w.travel) - w.damping * w.leg_length * dq[2]
    return np.array([0, 0, w.leg_length * force])


CASES = {
    "torso-passive": (torso_positions, torso_forces, lambda w: [w.leg_mass, w.leg_mass, w.torso_mass], 1),
    "telescopic-passive": (telescopic_positions, telescopic_forces, lambda w: [w.leg_mass, w.hip_mass, w.leg_mass], 0),
}


def newton(name):
    """(t, y) -> rates of (q, dq) of a sticking walker."""
    positions, forces, masses, turns = CASES[name]
    w = named(name).problem.walker
    inertia = np.diag([0, 0, w.torso_inertia]) if turns else 0.0

    def rates(t, y):
        q, dq = np.split(y, 2)
        loads, gravity = forces(w, q, dq), slope_gravity(w.gravity, w.slope)
        ddq, _ = constrained(partial(positions, w), masses(w), gravity, q, dq, loads=loads, inertia=inertia)
        return [*dq, *ddq]

    return rates


@pytest.mark.parametrize("name", CASES)
def test_first_phase_is_that_of_newtons_law_by_hand(name):
    gait = named(name)
    arc = gait.steps[0].arcs[0]
    start = np.delete(arc.states[0], [3, 7])
    motion = solve_ivp(newton(name), (0, arc.end), start, method="DOP853", rtol=1e-11, atol=1e-12)
    assert motion.y[:, -1] == pytest.approx(np.delete(arc.states[-1], [3, 7]), abs=1e-8)


@pytest.mark.parametrize("name", CASES)
def test_energy_is_lost_to_dampers_and_impacts_alone(name):
    """The gain of potential energy over a step is what dampers and impacts have taken."""
    gait = named(name)
    assert verification(name).passed
    observed = [observe(arc) for arc in gait.arcs]
    jumps = [o.energy[-1] - after.energy[0] for o, after in pairwise(observed)]
    w = gait.problem.walker
    last, first = observed[-1].energy[-1], observed[0].energy[0]
    weight = float(gait.system.weight(gait.p))
    descent = weight * gait.measures["step_length"] * np.sin(w.slope)
    lost = sum(o.energy[0] - o.energy[-1] for o in observed)
    assert gait.measures["damping_loss"] == pytest.approx(lost, abs=1e-9)
    assert gait.measures["damping_loss"] > 0.05
    impact = last - (first - descent)  # the stance foot is the origin after it
    assert impact > 0
    assert gait.measures["damping_loss"] + sum(jumps) + impact == pytest.approx(descent, abs=1e-9)


def test_the_swing_foot_of_the_telescopic_leg_clears_the_ground():
    gait = named("telescopic-passive")
    arc = gait.steps[0].arcs[0]
    heights = observe(arc).swing_foot[:, 1]
    assert arc.mode == "stick, leg free"
    assert heights[2:].min() > 0
    softer = gait.problem.replace({"walker.stiffness": 100})
    assert go.simulate(softer).trajectory.ending == "scuffing"


def test_a_damper_at_the_ankle_acts_on_the_leg_that_stands():
    """It may jump from one leg to the other when the feet swap roles: it stores no energy."""

    class Ankle(TelescopicCompass):
        @classmethod
        def mechanism(cls, q, p):
            return replace(super().mechanism(q, p), dampers=(Damper(coefficient=p.damping, across=vertcat(q.theta1)),))

    check_walker(Ankle, named("telescopic-passive").problem.walker.model_dump())
    assert Mode("stick, leg free") in Ankle.modes()
