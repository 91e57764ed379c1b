"""What every integrator of arcs must do. An engine takes part by being a member of ``Engine``.

A rolling wheel is the walker: its period is an integral, its energy is conserved.
"""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import quad

from gaitopt import Mode
from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.model.transitions import transitions
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.requests import Engine
from gaitopt.simulation.engine import Stepper, is_installed
from gaitopt.simulation.simulator import stepper_class

Array = NDArray[np.float64]

HALF_ANGLE, SLOPE, KAPPA = np.pi / 10, np.radians(13), 1 / 3
P = np.array([10, 1, 1, KAPPA, 1, SLOPE, 1.0])
START = np.array([-HALF_ANGLE, 0, 0.7, 0])
SYSTEM = HybridSystem(RimlessWheel, NoControl())


def required(engine: Engine) -> None:
    if engine is Engine.HEYOKA and not is_installed():
        pytest.skip("heyoka is not installed")


@pytest.fixture(scope="module", params=[engine for engine in Engine if engine is not Engine.AUTO])
def stepper(request: pytest.FixtureRequest) -> Stepper:
    required(request.param)
    return stepper_class(request.param)(Dynamics(SYSTEM, P))


def energy(states: Array) -> Array:
    return np.asarray(states[:, 2] ** 2 * (1 + KAPPA) / 2 + np.cos(states[:, 0] + SLOPE))


def test_the_event_is_where_the_integral_of_the_energy_says(stepper: Stepper) -> None:
    def slowness(theta: float) -> float:
        return 1 / np.sqrt(0.49 + 2 * (np.cos(HALF_ANGLE - SLOPE) - np.cos(theta + SLOPE)) / (1 + KAPPA))

    arrival = stepper.advance(Mode.STICK, 0, 0.0, START, 5.0)
    assert (arrival.event, arrival.failure) == ("touchdown", "")
    assert arrival.time == pytest.approx(quad(slowness, -HALF_ANGLE, HALF_ANGLE, epsabs=1e-14)[0], abs=1e-12)
    assert arrival.state[0] == pytest.approx(HALF_ANGLE, abs=1e-13)


def test_an_arc_without_an_event_ends_exactly_at_its_limit(stepper: Stepper) -> None:
    arrival = stepper.advance(Mode.STICK, 0, 0.1, START, 0.25)
    assert (arrival.time, arrival.event, arrival.failure) == (0.25, None, "")


def test_an_arc_of_no_length_is_where_it_starts(stepper: Stepper) -> None:
    arrival = stepper.advance(Mode.STICK, 0, 0.25, START, 0.25)
    assert arrival.time == 0.25
    assert np.array_equal(arrival.state, START)


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


def test_every_state_of_a_batch_ends_where_it_does_alone() -> None:
    required(Engine.HEYOKA)
    from gaitopt.simulation.heyoka_batch import LIMIT, BatchArcs

    together, alone = BatchArcs(Dynamics(SYSTEM, P)), stepper_class("heyoka")(Dynamics(SYSTEM, P))
    states = START + np.outer(np.arange(9), [0, 0, 0.01, 0])
    times, limits = np.linspace(0, 0.2, 9), np.tile([5.0, 0.25, 0.2], 3)
    limits[8] = times[8]  # no length
    arrivals = together.advance(Mode.STICK, np.zeros(9, dtype=int), times, states, limits)
    for k in range(9):
        arrival = alone.advance(Mode.STICK, 0, times[k], states[k], limits[k])
        code = int(arrivals.events[k])
        assert (None if code == LIMIT else transitions(RimlessWheel).margin_names(Mode.STICK)[code]) == arrival.event
        assert arrivals.times[k] == pytest.approx(arrival.time, abs=1e-12)
        assert arrivals.states[k] == pytest.approx(arrival.state, abs=1e-12)


def test_the_order_of_a_batch_changes_no_bit() -> None:
    required(Engine.HEYOKA)
    from gaitopt.simulation.heyoka_batch import BatchArcs

    batch = BatchArcs(Dynamics(SYSTEM, P))
    states = START + np.outer(np.arange(7), [0, 0, 0.01, 0])
    order = np.random.default_rng(0).permutation(7)
    args = np.zeros(7, dtype=int), np.zeros(7)
    there, back = (batch.advance(Mode.STICK, *args, rows, np.full(7, 5.0)) for rows in (states, states[order]))
    assert np.array_equal(there.times[order], back.times)
    assert np.array_equal(there.states[order], back.states)


def test_an_arc_of_too_many_steps_fails_in_a_batch_as_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The others in its lanes go on, whatever they end with."""
    required(Engine.HEYOKA)
    from gaitopt.simulation.heyoka_batch import FAILURE, LIMIT, BatchArcs

    for module in ("heyoka_batch", "heyoka_stepper"):
        monkeypatch.setattr(f"gaitopt.simulation.{module}.MAX_ARC_STEPS", 3)
    together, alone = BatchArcs(Dynamics(SYSTEM, P)), stepper_class("heyoka")(Dynamics(SYSTEM, P))
    states, times, limits = np.tile(START, (20, 1)), np.zeros(20), np.tile([5.0, 0.05, 0.01, 0.2], 5)
    arrivals = together.advance(Mode.STICK, np.zeros(20, dtype=int), times, states, limits)
    assert {FAILURE, LIMIT} == set(arrivals.events.tolist())
    for k in range(20):
        arrival = alone.advance(Mode.STICK, 0, 0.0, START, limits[k])
        assert bool(arrival.failure) == (arrivals.events[k] == FAILURE)
        assert arrivals.times[k] == pytest.approx(arrival.time, abs=1e-14)
        assert np.array_equal(arrivals.states[k], arrivals.states[k % 4])
