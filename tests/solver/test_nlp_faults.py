"""Terms of the NLP that no shipped gait depends on: backward impacts, slips of no length, curved sections."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from casadi import MX, Function, asin, jacobian, sin, vertcat
from foot_impacts import foot_impact

from gaitopt import Cycle, Mechanism, Mode, Status, load_problem, solve
from gaitopt.design.spectral_radius import certified_radius
from gaitopt.model.control import NoControl
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.solver.mesh import mesh_of
from gaitopt.solver.shooting import MultipleShooting

P = np.array([1.6, 4, 0.8, 2, 9.8, np.radians(1), 0.05])
FORWARD, BACKWARD, STICK = Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD, Mode.STICK


@pytest.mark.parametrize("mode", [FORWARD, BACKWARD])
def test_margin_of_a_slipping_impact_is_positive_where_the_foot_slips_as_the_mode_says(mode: Mode) -> None:
    system = HybridSystem(CompassBiped, NoControl())
    t = MultipleShooting(system, mesh_of(Cycle.of_one_step((mode, STICK), mode), [0.1, 0.5], []))
    rows, labels = t.inequalities
    row = [label.name for label in labels].index("impact_slip_velocity")
    margin = Function("margin", [t.w, t.parameters], [rows[row]])
    for dx in (-2.0, 2.0):
        last = np.array([0.15, 0.15, 0.1, 0.9, -0.3, dx])
        w = t.pack(np.tile(last[:, None], t.n_nodes), np.array([0.1, 0.5]))
        slip = float(foot_impact(system, mode)(last, P)[2])
        assert np.sign(float(margin(w, P))) == np.sign(slip * mode.direction)


def test_event_that_ends_a_slip_from_rest_has_no_root_where_the_slip_has_no_length() -> None:
    """Slip velocity over duration tends to the acceleration; the velocity itself would be zero."""
    system = HybridSystem(CompassBiped, NoControl())
    t = MultipleShooting(system, mesh_of(Cycle.of_one_step((FORWARD, STICK), STICK), [0.1, 0.5], []))
    start = np.array([-0.15, -0.15, 0, 0.73, -0.5, 0])
    rate = np.asarray(system.flow(FORWARD)(0, start, P, [])).ravel()
    event = system.n_z * (t.n_nodes - 1)
    values = []
    for duration in (1e-3, 1e-5, 1e-7):
        w = t.pack((start + np.outer(np.linspace(0, duration, t.n_nodes), rate)).T, np.array([duration, 0.5]))
        nodes, _, _ = t.unpack(w)
        nodes[:, t.mesh.arc_nodes[1].start] = start + duration * rate
        values.append(float(t.violation(t.pack(nodes, np.array([duration, 0.5])), P)[event]))
    assert values == pytest.approx([values[0]] * 3, rel=1e-6)
    assert abs(values[0]) > 1e-3


class SineCompass(CompassBiped):
    """The compass with the sine of the swing leg's angle as a coordinate: its section is curved."""

    model = "sine_compass"
    shape = ("theta1", "sine2")
    tracked = ("theta1", "sine2")

    @classmethod
    def mechanism(cls, q: SimpleNamespace, p: SimpleNamespace) -> Mechanism:
        plain = CompassBiped.mechanism(SimpleNamespace(theta1=q.theta1, theta2=asin(q.sine2), x=q.x, y=q.y), p)
        fields = {name: getattr(plain, name) for name in Mechanism.__slots__}
        return Mechanism(**{**fields, "relabel": vertcat(-asin(q.sine2), -sin(q.theta1))})

    @classmethod
    def after_impact(cls, free: SimpleNamespace, p: SimpleNamespace) -> tuple[Any, ...]:
        return (free.theta1, sin(free.theta1))


def test_gradient_of_the_radius_knows_that_the_section_is_curved() -> None:
    gait = solve(load_problem("compass-passive-a"))
    durations = [duration for _, duration in gait.phases]
    mesh = mesh_of(gait.problem.cycle, durations, []).refined(gait.shooting.intervals)
    t = MultipleShooting(HybridSystem(SineCompass, NoControl()), mesh, ())
    nodes = gait.shooting.states.T.copy()
    nodes[4] *= np.cos(nodes[1])
    nodes[1] = np.sin(nodes[1])
    w, radius, symbol = t.pack(nodes, np.array(durations)), certified_radius(t), MX.sym("w", t.w.numel())
    slope = np.asarray(Function("slope", [symbol], [jacobian(radius(symbol, gait.p), symbol)])(w)).ravel()
    assert float(radius(w, gait.p)) == pytest.approx(gait.spectral_radius, rel=1e-3)
    start = np.zeros(w.size)
    start[: t.system.n_z] = 1.0, np.cos(nodes[0, 0]), 0.0, 0.5, 0.5, 0.0
    step = 1e-6
    difference = float(radius(w + step * start, gait.p)) - float(radius(w - step * start, gait.p))
    assert slope @ start == pytest.approx(difference / (2 * step), rel=1e-4)


def test_a_cycle_that_closes_with_another_energy_is_no_gait():
    """The last reset takes one Newton step to the section; from far off it ends on the other side, with -dx."""
    gait = solve(load_problem("bounding").replace({"walker.inertia": 3.9}).from_guess())
    assert gait.status is Status.NOT_CONVERGED
    assert gait.message.startswith("not periodic: the cycle returns to a state off its section")
