"""Joint stops: the kneed walker against equations of its own, published numbers, and both ways of solving it."""

import numpy as np
import pytest
from foot_impacts import foot_impact
from named import named, verification
from oracles import constrained, jacobian, slope_gravity, up

import gaitopt as go
from gaitopt import Cycle, Mode, ModeSequence
from gaitopt.model.control import NoControl
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.system import HybridSystem
from gaitopt.model.walkers.kneed import KneedWalker
from gaitopt.simulation.simulator import Simulator

pytestmark = pytest.mark.portable

WALKER = {
    "thigh_length": 0.45, "thigh_mass": 0.5, "thigh_com": 0.175, "shank_length": 0.55, "shank_mass": 0.07,
    "shank_com": 0.375, "hip_mass": 0.6, "gravity": 9.8, "slope": 0.05,
}  # fmt: skip
FREE, LOCKED = Mode("stick, knee free"), Mode("stick, knee locked")
CONTACTS = {"stick": 0, "slip_forward": 1, "slip_backward": -1}
FRICTION = 0.3


@pytest.fixture(scope="module")
def system():
    return HybridSystem(KneedWalker, NoControl())


def parameters(friction=FRICTION):
    return np.array([*WALKER.values(), friction])


def positions(q):
    """Bodies of the kneed walker by hand, (x, y) in rows; q = (theta1, theta2, theta3, x, y)."""
    w, (a, b, c, x, y) = WALKER, q
    foot, leg = np.array([x, y]), w["thigh_length"] + w["shank_length"]
    hip = foot + leg * up(a)
    knee = hip - w["thigh_length"] * up(-b)
    return np.array([
        foot + w["shank_com"] * up(a), foot + (w["shank_length"] + w["thigh_com"]) * up(a), hip,
        hip - (w["thigh_length"] - w["thigh_com"]) * up(-b), knee - (w["shank_length"] - w["shank_com"]) * up(-c),
    ])  # fmt: skip


MASSES = np.array([WALKER[f"{part}_mass"] for part in ("shank", "thigh", "hip", "thigh", "shank")])


def state(rng, *, slips=0):
    theta1, theta2 = rng.uniform(-0.3, 0.3, 2)
    rates = rng.uniform(-1, 1, 3)
    return np.array([theta1, theta2, theta2, 0.0, *rates, slips * rng.uniform(0.05, 0.3)])


@pytest.mark.parametrize("contact", CONTACTS)
@pytest.mark.parametrize("knee", ["free", "locked"])
def test_motion_obeys_newton_with_all_constraints_written_out(system, contact, knee):
    """M ddq + h = W' f + J_knee' l with the accelerations of foot and locked knee zero, solved as one linear system."""
    rng, mode, s = np.random.default_rng(1), Mode.of(Mode(contact), {"knee": knee}), CONTACTS[contact]
    for _ in range(5):
        z = state(rng, slips=s)
        if knee == "locked":
            z[6] = z[5]
        q, dq = np.array([*z[:4], 0]), np.array([*z[4:], 0])
        gap = np.array([[0, 1, -1, 0, 0]])
        rows = [[0, 0, 0, 0, 1], [0, 0, 0, 1, 0]] if s == 0 else [[0, 0, 0, 0, 1]]
        held = np.array([*rows, *(gap if knee == "locked" else [])], dtype=float)
        forces = held.copy()
        if s:
            forces[0, 3] = -s * FRICTION  # friction comes with the normal force
        gravity = slope_gravity(WALKER["gravity"], WALKER["slope"])
        acceleration, force = constrained(positions, MASSES, gravity, q, dq, held, forces)
        dz = np.asarray(system.flow(mode)(0, z, parameters(), [])).ravel()
        assert dz[4:] == pytest.approx(acceleration[:4], rel=1e-6, abs=1e-6)
        normal = system.margins(mode)(0, z, parameters(), [])[2]
        assert float(normal) == pytest.approx(force[0], rel=1e-6)


@pytest.mark.parametrize("contact", CONTACTS)
def test_strike_obeys_the_balance_of_momentum_with_all_constraints_written_out(system, contact):
    rng, s = np.random.default_rng(2), CONTACTS[contact]
    for _ in range(5):
        z = state(rng, slips=rng.choice([-1, 0, 1]))
        q, dq = np.array([*z[:4], 0]), np.array([*z[4:], 0])
        J = jacobian(positions, q)
        M = J.T * np.repeat(MASSES, 2) @ J
        held = np.array([[0, 0, 0, 0, 1], [0, 1, -1, 0, 0], *([[0, 0, 0, 1, 0]] if s == 0 else [])], dtype=float)
        impulses = held.copy()
        if s:
            impulses[0, 3] = -s * FRICTION
        K = np.block([[M, -impulses.T], [held, np.zeros((len(held), len(held)))]])
        after = np.linalg.solve(K, [*(M @ dq), *np.zeros(len(held))])
        z_plus, impulse, *_ = (
            np.asarray(v).ravel() for v in foot_impact(system, LOCKED.with_contact(Mode(contact)))(z, parameters())
        )
        assert z_plus[:4] == pytest.approx(z[:4], abs=0)
        assert z_plus[4:] == pytest.approx(after[:4], rel=1e-9, abs=1e-9)
        assert impulse[1] == pytest.approx(after[5], rel=1e-9, abs=1e-12)


def test_published_gait_of_the_kneed_walker():
    """Step length, phases and multipliers of Chen's walker without slip, computed elsewhere to these digits."""
    gait = named("kneed-passive")
    assert gait.measures["step_length"] == pytest.approx(0.4726, abs=5e-5)
    assert [duration for _, duration in gait.phases] == pytest.approx([0.3488, 0.2158], abs=5e-5)
    assert sorted(abs(gait.multipliers)) == pytest.approx([0.144, 0.655, 0.655], abs=5e-4)
    assert gait.measures["required_friction"] == pytest.approx(0.258, abs=5e-4)
    assert gait.measures["impulse_ratio"] == pytest.approx(0.229, abs=5e-4)
    assert verification("kneed-passive").passed


def test_the_knee_needs_the_friction_at_which_its_strike_begins_to_slip():
    gait = named("kneed-passive")
    before = gait.steps[0].arcs[0].states[-1]
    f_t, f_n = np.asarray(foot_impact(gait.system, LOCKED)(before, gait.p)[1]).ravel()
    assert abs(f_t / f_n) == pytest.approx(0.282108744, abs=1e-8)
    for factor, contact in ((1 + 1e-9, "stick"), (1 - 1e-9, "slip_forward")):
        p = gait.p.copy()
        p[-1] = factor * abs(f_t / f_n)
        step = Simulator(Dynamics(gait.system, p)).step(gait.state).step
        after = next(arc.mode for arc in step.arcs if arc.mode.locked)
        assert after.contact == contact


@pytest.mark.slow
def test_a_gait_whose_knee_strike_slides_is_verified():
    """The simulator, from the gait with more friction, changes the modes by itself; both methods agree on its gait."""
    phases = [
        "slip_forward, knee free", "stick, knee free", "slip_forward, knee locked", "stick, knee locked",
        "slip_backward, knee locked",
    ]  # fmt: skip
    changes = {"friction": 0.24, "gait.phases": [Mode(text).data for text in phases]}
    gait = go.solve(go.load_problem("kneed-passive").replace(changes))
    assert gait.converged, gait.message
    checked = go.verify(gait)
    assert checked.passed, checked
    pytest.importorskip("heyoka")
    assert go.verify(gait, engine="heyoka").passed


def test_a_sequence_knows_where_a_stop_locks():
    cycle = Cycle((ModeSequence((FREE, LOCKED, LOCKED.with_contact(Mode.SLIP_BACKWARD)), Mode.STICK),))
    assert cycle.resets == ((0, LOCKED), (2, Mode.STICK))
    assert [cycle.impact_before(k) for k in range(3)] == [Mode.STICK, LOCKED, None]


def test_families_change_modes_at_the_strike():
    branch = go.continuation(named("kneed-passive"), "friction", 0.275)
    change = branch.special("mode_change")[0] if branch.special("mode_change") else None
    assert change is not None
    assert change.value == pytest.approx(0.282108744, abs=1e-8)
