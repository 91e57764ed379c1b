"""Arcs by scipy's integrator: accuracy, failures, and the seam for other integrators."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from gaitopt import Mechanism, Mode
from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import Ending
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.simulation import scipy_stepper
from gaitopt.simulation.scipy_stepper import ScipyStepper
from gaitopt.simulation.simulator import Simulator

HALF_ANGLE, SLOPE, KAPPA = np.pi / 10, np.radians(13), 1 / 3
P = np.array([10, 1, 1, KAPPA, 1, SLOPE, 1.0])
START = np.array([-HALF_ANGLE, 0, 0.7, 0])


class Cliff(RimlessWheel):
    """A wheel on a spring whose force is not defined beyond theta = 0.1."""

    model = "cliff"

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        wheel = RimlessWheel.mechanism(q, p)
        return Mechanism(**{**{name: getattr(wheel, name) for name in Mechanism.__slots__}, "potential": _cliff(q)})


def _cliff(q: SimpleNamespace) -> Any:
    return 0.1 * (0.1 - q.theta) ** 1.5


def stepper(**tolerances: float) -> ScipyStepper:
    return ScipyStepper(Dynamics(HybridSystem(RimlessWheel, NoControl()), P), **tolerances)


def exact_period() -> float:
    def slowness(theta: float) -> float:
        return 1 / np.sqrt(0.49 + 2 * (np.cos(HALF_ANGLE - SLOPE) - np.cos(theta + SLOPE)) / (1 + KAPPA))

    return quad(slowness, -HALF_ANGLE, HALF_ANGLE, epsabs=1e-14, epsrel=1e-14)[0]


def test_the_event_is_as_accurate_as_the_integration() -> None:
    errors = []
    for rtol in (1e-7, 1e-9, 1e-11, 1e-13):
        arrival = stepper(rtol=rtol, atol=rtol / 100).advance(Mode.STICK, 0, 0.0, START, 5.0)
        assert arrival.event == "touchdown"
        errors.append(abs(arrival.time - exact_period()))
    assert all(error < rtol for error, rtol in zip(errors, (1e-7, 1e-9, 1e-11, 2e-13), strict=True))


def test_a_motion_that_becomes_singular_is_a_numerical_ending() -> None:
    trajectory = Simulator(Dynamics(HybridSystem(Cliff, NoControl()), P)).run(START)
    assert trajectory.ending is Ending.NUMERICAL
    assert trajectory.steps[0].arcs[-1].states[-1][0] == pytest.approx(0.1, abs=1e-6)
    assert "the motion is singular" in trajectory.message


def test_a_motion_that_is_undefined_from_the_start_is_a_numerical_ending() -> None:
    trajectory = Simulator(Dynamics(HybridSystem(Cliff, NoControl()), P)).run(np.array([0.2, 0, 0.7, 0]))
    assert trajectory.ending is Ending.NUMERICAL
    assert trajectory.steps == ()
    slipping = Simulator(Dynamics(HybridSystem(Cliff, NoControl()), P)).run(np.array([0.2, 0, 0.7, 0.1]))
    assert slipping.ending is Ending.NUMERICAL


def test_endless_integration_is_a_numerical_ending(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scipy_stepper, "MAX_ARC_STEPS", 3)
    trajectory = Simulator(Dynamics(HybridSystem(RimlessWheel, NoControl()), P)).run(START)
    assert trajectory.ending is Ending.NUMERICAL
    assert "more than 3 integration steps" in trajectory.message
