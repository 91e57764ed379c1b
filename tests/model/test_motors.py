"""A motor acts between any two bodies, neighbours or not, or between a body and the ground."""

from dataclasses import replace
from typing import Any

import numpy as np
from casadi import SX, atan2, cos, sqrt

import gaitopt as go
from gaitopt import Mode
from gaitopt.model.declaration import actuator_units
from gaitopt.model.walkers.crawler import Crawler
from gaitopt.model.walkers.rabbit import Rabbit
from gaitopt.systems import problem_dynamics


class SprungRabbit(Rabbit):
    """``Rabbit`` with a motor between its thighs, which no joint connects, and one between stance shin and ground."""

    model = "sprung_rabbit"
    actuators = (*Rabbit.actuators, "thighs", "ankle")
    tracked = ()

    @classmethod
    def mechanism(cls, q: Any, p: Any) -> Any:
        """The mechanism of the links with two more motors."""
        plain = super().mechanism(q, p)
        return replace(plain, motors=(*plain.motors, q.swing_thigh - q.stance_thigh, q.stance_shin))


TORQUES = {name: 1.5 * k - 2 for k, name in enumerate(SprungRabbit.actuators)}


def test_each_torque_turns_one_body_and_the_other_one_back() -> None:
    """Torques on the links, whose absolute angles are the coordinates: each motor has one pair of them, by hand."""
    state = {"torso": 0.05, "stance_thigh": -0.35, "stance_shin": -0.15, "swing_thigh": 0.1}
    text = f"""
name: sprung
walker: {{model: sprung_rabbit}}
friction: 0.6
control: {{type: constant_torque, {", ".join(f"{name}: {u}" for name, u in TORQUES.items())}}}
gait: {{phases: [stick], impact: stick, guess: {{state: {state | {"d" + name: 0.1 for name in SprungRabbit.shape}}}}}}
""".replace("'", "")
    problem = go.parse_problem(text, walkers=[SprungRabbit])
    driven, passive = (problem_dynamics(one) for one in (problem, problem.replace({"control": {"type": "none"}})))
    n, rng = len(SprungRabbit.shape), np.random.default_rng(2)
    for _ in range(3):
        z = np.array([*rng.uniform(-0.4, 0.4, n), 0, *rng.uniform(-1, 1, n), 0])
        rates = [
            np.asarray(d.system.flow(Mode.STICK)(0, z, d.p, d.system.data(0))).ravel()[n + 1 : 2 * n + 1]
            for d in (driven, passive)
        ]
        hips, knees = ([TORQUES[f"{leg}_{joint}"] for leg in ("stance", "swing")] for joint in ("hip", "knee"))
        thighs, ankle = TORQUES["thighs"], TORQUES["ankle"]
        stance = hips[0] - knees[0] - thighs, knees[0] + ankle
        on_links = [-sum(hips), *stance, hips[1] - knees[1] + thighs, knees[1]]
        terms = driven.system.momentum(Mode.STICK)
        momenta = [
            np.asarray(terms(t=0, z=np.array([*z[: n + 1], *v, 0]), p=driven.p, r=[])["momentum"]).ravel()
            for v in np.eye(n)
        ]
        np.testing.assert_allclose(np.array(momenta).T @ (rates[0] - rates[1]), on_links, atol=1e-9)


class MotorizedCrawler(Crawler):
    """``Crawler`` with an angle, and motors on lengths and angles that are offset, or computed from each other."""

    model = "motorized_crawler"
    shape = ("gap", "rise", "bend")
    actuators = ("offset", "hinge", "cylinder", "strut", "direction")

    @classmethod
    def mechanism(cls, q: Any, p: Any) -> Any:
        """The mechanism of the crawler with five motors."""
        cylinder = sqrt(p.rest**2 + q.gap**2 - 2 * p.rest * q.gap * cos(q.bend))
        strut = p.rest * sqrt(2 - 2 * cos(q.bend))
        motors = (q.gap - 0.5, q.bend - 1.57, cylinder, strut, atan2(SX(q.gap), q.rise))
        return replace(super().mechanism(q, p), motors=motors)


def test_a_motor_on_a_length_has_a_force_and_one_on_an_angle_a_torque() -> None:
    """A length is in m whether it is a coordinate or follows from angles, and an angle between lengths is an angle."""
    assert [*actuator_units(MotorizedCrawler).values()] == ["N", "N m", "N", "N", "N m"]
    assert {*actuator_units(SprungRabbit).values()} == {"N m"}
