"""What every integrator of arcs must do, and what scipy's does where it fails.

An engine takes part by being a member of ``Engine``. A rolling wheel is the walker: its period is an integral, its
energy is conserved.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from casadi import SX
from numpy.typing import NDArray
from paper_walkers import HALF_ANGLE, KAPPA, SLOPE, compass_numbers, rolling_period, wheel

from gaitopt import Control, Instant, Mechanism, Mode
from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import Ending, transitions
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.requests import Engine
from gaitopt.simulation import scipy_stepper
from gaitopt.simulation.engine import Stepper, is_installed
from gaitopt.simulation.scipy_stepper import ScipyStepper
from gaitopt.simulation.simulator import Simulator, stepper_class

Array = NDArray[np.float64]

START = np.array([-HALF_ANGLE, 0, 0.7, 0])


def required(engine: Engine) -> None:
    if engine is Engine.HEYOKA and not is_installed():
        pytest.skip("heyoka is not installed")


@pytest.fixture(scope="module", params=[engine for engine in Engine if engine is not Engine.AUTO])
def stepper(request: pytest.FixtureRequest) -> Stepper:
    required(request.param)
    return stepper_class(request.param)(wheel())


def energy(states: Array) -> Array:
    return np.asarray(states[:, 2] ** 2 * (1 + KAPPA) / 2 + np.cos(states[:, 0] + SLOPE))


def test_the_event_is_where_the_integral_of_the_energy_says(stepper: Stepper) -> None:
    arrival = stepper.advance(Mode.STICK, 0, 0.0, START, 5.0)
    assert (arrival.event, arrival.failure) == ("touchdown", "")
    assert arrival.time == pytest.approx(rolling_period(START[2]), abs=1e-12)
    assert arrival.state[0] == pytest.approx(HALF_ANGLE, abs=1e-13)


def test_an_arc_without_an_event_or_a_length_ends_exactly_at_its_limit(stepper: Stepper) -> None:
    arrival = stepper.advance(Mode.STICK, 0, 0.1, START, 0.25)
    assert (arrival.time, arrival.event, arrival.failure) == (0.25, None, "")
    nowhere = stepper.advance(Mode.STICK, 0, 0.25, START, 0.25)
    assert nowhere.time == 0.25
    assert np.array_equal(nowhere.state, START)


def test_an_arc_may_be_cut_anywhere(stepper: Stepper) -> None:
    whole = stepper.advance(Mode.STICK, 0, 0.0, START, 5.0)
    middle = stepper.advance(Mode.STICK, 0, 0.0, START, 0.4)
    rest = stepper.advance(Mode.STICK, 0, middle.time, middle.state, 5.0)
    assert rest.event == whole.event
    assert rest.time == pytest.approx(whole.time, abs=1e-13)
    assert rest.state == pytest.approx(whole.state, abs=1e-12)


def test_samples_lie_on_the_arc_and_keep_its_energy(stepper: Stepper) -> None:
    end = stepper.advance(Mode.STICK, 0, 0.0, START, 5.0)
    times = np.array([0.0, 1e-9, 0.1, 0.1 + 1e-14, 0.5, end.time])
    states = stepper.sample(Mode.STICK, 0, START, times)
    for t, z in zip(times[1:], states[1:], strict=True):
        assert z == pytest.approx(stepper.advance(Mode.STICK, 0, 0.0, START, t).state, abs=1e-12)
    assert energy(states) == pytest.approx(energy(states)[0], abs=1e-13)


def test_variations_of_an_arc_are_those_of_its_parts_one_after_the_other(stepper: Stepper) -> None:
    def carried(state: Array, deviations: Array, *times: float) -> Array:
        return stepper.propagate_variations(Mode.STICK, 0, state, deviations, np.array(times))

    middle = stepper.advance(Mode.STICK, 0, 0.0, START, 0.3).state
    whole = carried(START, np.eye(4), 0.0, 0.5)
    assert carried(middle, carried(START, np.eye(4), 0.0, 0.3), 0.3, 0.5) == pytest.approx(whole, abs=1e-10)
    assert carried(START, np.eye(4), 0.3, 0.3) == pytest.approx(np.eye(4), abs=1e-15)


def test_variations_are_the_derivatives_of_the_end(stepper: Stepper) -> None:
    small = 1e-6 * np.array([0.0, 0.0, 1.0, 0.0])
    ends = [stepper.advance(Mode.STICK, 0, 0.0, START + side * small, 0.5).state for side in (-1, 1)]
    variation = stepper.propagate_variations(Mode.STICK, 0, START, small[:, None], np.array([0.0, 0.5]))
    assert variation[:, 0] / 1e-6 == pytest.approx((ends[1] - ends[0]) / 2e-6, abs=1e-8)


class Growing(Control):
    """An ankle torque that grows from nothing with the square of the time."""

    type = "growing"

    def torques(self, now: Instant) -> dict[str, SX]:
        return {"ankle": 10 * now.t**2}


def test_a_batch_looks_ahead_in_time_where_margins_and_their_rates_are_zero() -> None:
    """Without friction the compass stands upright at both edges of the cone, until the torque pulls its foot."""
    required(Engine.HEYOKA)
    from gaitopt.simulation.heyoka_batch import BatchArcs

    dynamics = Dynamics(HybridSystem(CompassBiped, Growing()), compass_numbers(0.0, slope=0.0))
    together, alone = BatchArcs(dynamics), stepper_class("heyoka")(dynamics)
    arrivals = together.advance(Mode.STICK, np.zeros(1, dtype=int), np.zeros(1), np.zeros((1, 6)), np.full(1, 0.1))
    arrival = alone.advance(Mode.STICK, 0, 0.0, np.zeros(6), 0.1)
    names = transitions(CompassBiped).margin_names(Mode.STICK)
    assert names[int(arrivals.events[0])] == arrival.event
    assert arrival.event.startswith("cone")


def test_an_arc_of_too_many_steps_fails_in_a_batch_as_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The others in its lanes go on, whatever they end with."""
    required(Engine.HEYOKA)
    from gaitopt.simulation.heyoka_batch import FAILURE, LIMIT, BatchArcs

    for module in ("heyoka_batch", "heyoka_stepper"):
        monkeypatch.setattr(f"gaitopt.simulation.{module}.MAX_ARC_STEPS", 3)
    together, alone = BatchArcs(wheel()), stepper_class("heyoka")(wheel())
    states, times, limits = np.tile(START, (20, 1)), np.zeros(20), np.tile([5.0, 0.05, 0.01, 0.2], 5)
    arrivals = together.advance(Mode.STICK, np.zeros(20, dtype=int), times, states, limits)
    assert {FAILURE, LIMIT} == set(arrivals.events.tolist())
    for k in range(20):
        arrival = alone.advance(Mode.STICK, 0, 0.0, START, limits[k])
        assert bool(arrival.failure) == (arrivals.events[k] == FAILURE)
        assert arrivals.times[k] == pytest.approx(arrival.time, abs=1e-14)
        assert np.array_equal(arrivals.states[k], arrivals.states[k % 4])


class Cliff(RimlessWheel):
    """A wheel on a spring whose force is not defined beyond theta = 0.1."""

    model = "cliff"

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        return replace(RimlessWheel.mechanism(q, p), potential=0.1 * (0.1 - q.theta) ** 1.5)


def test_the_event_is_as_accurate_as_the_integration() -> None:
    for rtol, allowed in ((1e-7, 1e-7), (1e-9, 1e-9), (1e-11, 1e-11), (1e-13, 2e-13)):
        arrival = ScipyStepper(wheel(), rtol=rtol, atol=rtol / 100).advance(Mode.STICK, 0, 0.0, START, 5.0)
        assert arrival.event == "touchdown"
        assert abs(arrival.time - rolling_period(START[2])) < allowed


def test_a_motion_that_becomes_singular_or_is_undefined_from_the_start_is_a_numerical_ending() -> None:
    cliff = Simulator(Dynamics(HybridSystem(Cliff, NoControl()), wheel().p))
    trajectory = cliff.run(START)
    assert trajectory.ending is Ending.NUMERICAL
    assert trajectory.steps[0].arcs[-1].states[-1][0] == pytest.approx(0.1, abs=1e-6)
    assert "the motion is singular" in trajectory.message
    for slip in (0, 0.1):
        undefined = cliff.run(np.array([0.2, 0, 0.7, slip]))
        assert undefined.ending is Ending.NUMERICAL
        assert slip or undefined.steps == ()


def test_endless_integration_is_a_numerical_ending(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scipy_stepper, "MAX_ARC_STEPS", 3)
    trajectory = Simulator(wheel()).run(START)
    assert trajectory.ending is Ending.NUMERICAL
    assert "more than 3 integration steps" in trajectory.message
