"""The simulator under control laws: breakpoints, horizons, and torques that graze the friction cone."""

import numpy as np
import pytest
from casadi import SX, exp
from numpy.typing import NDArray
from paper_walkers import COMPASS
from paper_walkers import COMPASS_START as START

from gaitopt import Control, Instant, Mode
from gaitopt.gait import curves
from gaitopt.gait.measures import observe
from gaitopt.model.curve import Curve, Piece
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.model.tracking import ProportionalDerivative
from gaitopt.model.transitions import Ending
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.simulation.engine import is_installed
from gaitopt.simulation.scipy_stepper import ScipyStepper
from gaitopt.simulation.simulator import Simulator
from gaitopt.verification.return_map import ReturnMap

Array = NDArray[np.float64]


class Staircase(Control):
    """Torques that are constant between breakpoints."""

    type = "staircase"
    jumps = True

    times: tuple[float, ...]
    levels: tuple[tuple[float, float], ...]

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return self.times

    def torques(self, now: Instant) -> dict[str, SX]:
        return {"ankle": now.r[0], "hip": now.r[1]}

    def data(self, segment: int) -> Array:
        return np.array(self.levels[segment])


class Pulse(Control):
    """A smooth pulse of the ankle torque."""

    type = "pulse"

    time: float
    width: float
    amplitude: float

    def torques(self, now: Instant) -> dict[str, SX]:
        return {"ankle": now.p.amplitude * exp(-(((now.t - now.p.time) / now.p.width) ** 2))}


def staircase(breakpoints: tuple[float, ...], *levels: tuple[float, float], friction: float = 0.3) -> Simulator:
    system = HybridSystem(CompassBiped, Staircase(times=breakpoints, levels=levels))
    return Simulator(Dynamics(system, np.array([*COMPASS, friction])))


def test_breakpoints_without_a_jump_change_nothing() -> None:
    plain = staircase((), (0.2, 0.1)).run(START).steps[0]
    cut = staircase((0.1, 0.2, 0.4), *[(0.2, 0.1)] * 4).run(START).steps[0]
    assert staircase((5.0, 100.0), (0, 0), (1, 0), (2, 0)).run(START).ending is Ending.COMPLETED  # beyond the step
    assert cut.period == pytest.approx(plain.period, abs=1e-12)
    assert cut.impact.state == pytest.approx(plain.impact.state, abs=1e-11)


def test_a_jump_of_the_torque_out_of_the_cone_starts_a_slip_at_the_breakpoint_that_is_no_switch_by_itself() -> None:
    """An ankle torque pulls the foot. The mode changes twice, but only the end of the slip is an event."""
    for torque, slip in ((30, Mode.SLIP_BACKWARD), (-30, Mode.SLIP_FORWARD)):
        simulator = staircase((0.3, 0.32), (0, 0), (torque, 0), (0, 0), friction=0.18)
        step = simulator.run(START).steps[0]
        assert [arc.mode for arc in step.arcs[:2]] == [Mode.STICK, slip]
        assert step.arcs[1].start == 0.3
        if slip is Mode.SLIP_BACKWARD:
            limited = Simulator(simulator.dynamics, max_switches=1).run(START).steps[0]
            assert [mode for mode, _ in limited.phases] == [Mode.STICK, slip, Mode.STICK]
            assert limited.impact is not None


@pytest.mark.parametrize(
    ("levels", "friction", "modes"),
    [
        (((0.3, 0.1), (-1.5, 0.6), (0.5, 0)), 1.0, [Mode.STICK] * 3),
        (((0, 0), (45, 0), (0, 0)), 0.3, [Mode.STICK, Mode.SLIP_BACKWARD, Mode.SLIP_BACKWARD, Mode.STICK]),
    ],
)
def test_deviations_pass_a_jump_of_the_torque_unchanged(levels, friction, modes):
    """A breakpoint lies at a fixed time for all neighbours: it is not an event, even where the foot begins to slip."""
    mapped, xi, h = ReturnMap(staircase((0.3, 0.32), *levels, friction=friction), Mode.STICK), START[[0, 3, 4]], 1e-6
    (step,) = mapped(xi).steps
    assert step is not None
    assert [arc.mode for arc in step.arcs] == modes
    columns = [(mapped(xi + h * unit).xi - mapped(xi - h * unit).xi) / (2 * h) for unit in np.eye(3)]
    assert np.column_stack(columns) == pytest.approx(mapped.jacobian([step]), rel=1e-5, abs=1e-5)


@pytest.mark.parametrize(
    ("torque", "friction", "mode", "ending"),
    [
        ((-400, 0), 0.3, Mode.STICK, Ending.LIFT_OFF),
        ((-400, 0), 0.06, Mode.SLIP_FORWARD, Ending.LIFT_OFF),
        ((0, -150), 0.06, Mode.SLIP_FORWARD, Ending.LIFT_OFF),
        ((30, 0), 0.18, Mode.STICK, Ending.COMPLETED),
        ((3, 0), 0.18, Mode.STICK, Ending.COMPLETED),
    ],
)
def test_every_engine_decides_anew_at_a_breakpoint(torque, friction, mode, ending):
    """A jump lifts the foot, starts a slip or leaves it at rest; a motion that ends has a name."""
    scipy = staircase((0.3, 0.32), (0, 0), torque, (0, 0), friction=friction)
    steppers = [ScipyStepper]
    if is_installed():
        from gaitopt.simulation.heyoka_batch import BatchSimulator
        from gaitopt.simulation.heyoka_stepper import HeyokaStepper

        steppers.append(HeyokaStepper)
        batch = BatchSimulator(scipy.dynamics).step(np.tile(START, (2, 1)))
        assert [*batch.outcomes] == [ending, ending]
    for stepper in steppers:
        outcome = Simulator(scipy.dynamics, stepper).step(START)
        assert outcome.ending is ending
        assert outcome.step is not None
        assert outcome.step.phases[0][0] is mode
        if ending is Ending.LIFT_OFF:
            assert outcome.step.period == 0.3
            assert "0.3 s after the impact" in outcome.message
        if is_installed():
            assert batch.times == pytest.approx([outcome.step.period] * 2, abs=1e-11)
            assert list(batch.sequence(0)) == [mode for mode, _ in outcome.step.phases]


def test_a_reference_that_ends_before_touchdown_ends_the_motion() -> None:
    piece = Piece(start=0, end=0.4, rows=((0.0,), (0.0,)))
    law = ProportionalDerivative(
        kp=1.0, kd=1.0, reference=Curve(names=CompassBiped.tracked, pieces=(piece,), horizon=0.4)
    )
    trajectory = Simulator(Dynamics(HybridSystem(CompassBiped, law), np.array([*COMPASS, 0.5, 1.0, 1.0]))).run(START)
    assert trajectory.ending is Ending.NO_TOUCHDOWN
    assert trajectory.steps[0].period == 0.4
    assert "where the control law ends" in trajectory.message


def pulsed(friction: float) -> tuple[HybridSystem, Array]:
    law = Pulse(time=0.5, width=0.1, amplitude=15.0)
    return HybridSystem(CompassBiped, law), np.array([*COMPASS, friction, *law.parameters.values()])


def test_a_slip_between_two_roots_of_the_cone_margin_shrinks_with_the_root_of_its_depth() -> None:
    """Beyond a parabola of depth e and curvature a the foot slips for 3 sqrt(2 e / a); before it, never."""
    system, p = pulsed(1.0)
    arc = Simulator(Dynamics(system, p)).run(START, dense=True).steps[0].arcs[0]
    force = observe(arc).force
    place, needed = curves.maximum(force[:, 0] / force[:, 1])
    assert -1 < place < 1
    durations = []
    for depth in (1e-4, 1e-6, 1e-8, 1e-10):
        system, p = pulsed(needed - depth)
        phases = Simulator(Dynamics(system, p)).run(START).steps[0].phases
        assert [mode is Mode.STICK for mode, _ in phases] == [True, False, True]
        durations.append(phases[1][1])
    assert durations[2] == pytest.approx(durations[1] / 10, rel=1e-2)
    assert durations[3] == pytest.approx(durations[1] / 100, rel=1e-2)
    system, p = pulsed(needed + 1e-10)
    assert [mode for mode, _ in Simulator(Dynamics(system, p)).run(START).steps[0].phases] == [Mode.STICK]
