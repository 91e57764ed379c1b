"""What the foot does at rest and at an impact, against an enumeration of all that could happen."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from contact_problems import sled
from contact_walkers import frame
from foot_impacts import foot_impact
from numpy.typing import NDArray
from paper_walkers import COMPASS, compass, compass_numbers, compass_system, wheel_numbers, wheel_system
from samples import sampled

from gaitopt import ImpactLaw, Mode, load_problem
from gaitopt.gait.trajectory import ImpactRecord
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import CONTACTS
from gaitopt.model.transitions import Ending
from gaitopt.simulation.clear_cases import ClearCases
from gaitopt.simulation.contact_forces import ContactForces, Mechanics, Solutions
from gaitopt.simulation.contact_resolver import ContactResolver, Termination
from gaitopt.simulation.simulator import Simulator
from gaitopt.systems import problem_dynamics

Array = NDArray[np.float64]

NO_DATA = np.zeros(0)


wheel_at = partial(wheel_numbers, slope=0.2, spokes=8)


def at_rest(p, z):
    """What the foot of the wheel does at rest."""
    return ContactResolver(Dynamics(wheel_system(), p)).mode_at_rest(CONTACTS, 0.0, z, 0)


def everything_possible(p: Array, z: Array) -> list[str]:
    """All consistent continuations of a wheel at rest, by its accelerations and by free flight."""
    friction, found = p[-1], []
    for mode in CONTACTS:
        f_t, f_n = np.asarray(wheel_system().observation(mode)(0, z, p, [])[0]).ravel()
        ddx = float(wheel_system().flow(mode)(0, z, p, [])[-1])
        holds = abs(f_t) <= friction * f_n if mode is Mode.STICK else mode.direction * ddx > 0
        if f_n > 0 and holds:
            found.append(str(mode))
    theta, _, rate, _ = z
    if rate**2 * np.cos(theta) > np.cos(p[5]):
        found.append("lift_off")
    return found


def test_the_foot_at_rest_does_the_only_thing_that_is_possible_or_sticks() -> None:
    """A foot that friction wedges in could also lift off, and slide; ``test_wedged_feet`` shows why it sticks."""
    rng = np.random.default_rng(3)
    seen, wedged = set(), 0
    for _ in range(600):
        p = wheel_at(10 ** rng.uniform(-2, 1.2), rng.uniform(0.05, 1), slope=rng.uniform(-1, 1))
        z = np.array([rng.uniform(-0.39, 0.39), 0, rng.normal(), 0])
        decision = at_rest(p, z)
        outcome = str(decision.ending if isinstance(decision, Termination) else decision)
        possible = everything_possible(p, z)
        if "stick" in possible and len(possible) > 1:
            assert "lift_off" in possible
            possible, wedged = ["stick"], wedged + 1
        assert [outcome] == possible, (p, z)
        seen.add(outcome)
    assert seen == {*CONTACTS, "lift_off"}
    assert wedged


def test_at_the_edge_of_the_cone_the_rate_of_the_margin_decides() -> None:
    """The wheel rolls towards less friction at -theta and towards more at +theta."""
    for theta, mode in ((-0.3, Mode.STICK), (0.3, Mode.SLIP_FORWARD)):
        z = np.array([theta, 0, 0.5, 0])
        f_t, f_n = np.asarray(wheel_system().observation(Mode.STICK)(0, z, wheel_at(1), [])[0]).ravel()
        p = wheel_at(abs(f_t) / f_n)
        _, rates = wheel_system().events(Mode.STICK)(0, z, p, [])
        falling = float(rates[3 if f_t < 0 else 4]) < 0
        assert at_rest(p, z) is (Mode.slip(-f_t) if falling else Mode.STICK)
        assert falling == (mode is not Mode.STICK)


@pytest.mark.parametrize(("time", "force", "rear"), [(0.5 - 2e-7, 8.0, "stick"), (1.5, 4.0, "slip_backward")])
def test_at_an_extreme_of_the_force_on_the_edge_of_the_cone_the_curvature_decides(time: float, force: float, rear: str):
    """A motor pushes the rear of a crawler with 6 N + 2 N sin(pi t); up to 0.5 s it still grows by 4e-13 N."""
    control = {"type": "oscillating", "cycle": 2.0, "kp": 4.0, "kd": 0.0, "mean": {"drive": 2.0}}
    control["amplitude"] = {"drive": 0.5}
    friction = {"rear": {"static": force / 9.81, "kinetic": 0.9 * force / 9.81}, "front": 0.6}
    problem = load_problem("crawler").replace({"walker.slope": 0.0, "control": control, "friction": friction})
    resolver = ContactResolver(problem_dynamics(problem))
    z = np.array([0.5 * (name == "gap") for name in resolver.system.state_names])
    start, _ = resolver.start(z, anywhere=True)
    mode = resolver.mode_at_rest(resolver.system.transitions.at_rest(start), time, z, 0)
    assert mode is start.with_states({"rear": rear})


def test_a_contact_that_comes_to_rest_stops_exactly_and_stays_on_the_ground() -> None:
    case = frame(0.3, 0.5)
    q, dq = np.array([0.2, 0.0, 0.0]), np.array([0.7, 0.0, 0.0])
    dq[1:] = [4e-12, 0.0] - case.points["right"].velocity(q, dq)
    resting = Mode.of_contacts({"left": "off", "right": "stick"})
    rates = ContactResolver(case.dynamics(0.5)).settled(case.state(q, dq), stopped=resting)[3:]
    assert case.points["right"].velocity(q, rates[[0, 2, 1]]) == pytest.approx([0, 0], abs=1e-15)


def test_forces_that_are_not_finite_are_a_numerical_ending() -> None:
    termination = at_rest(wheel_at(1), np.array([0, 0, 1e200, 0]))
    assert isinstance(termination, Termination)
    assert termination.ending is Ending.NUMERICAL


# impacts


def landed(dynamics: Dynamics, z: Array) -> ImpactRecord | Termination:
    """The impact of the swing foot in state ``z`` of a stance in which the foot sticks."""
    row = dynamics.system.transitions.of(Mode.STICK)["touchdown"]
    return ContactResolver(dynamics).impact(Mode.STICK, row, z)


def touchdown(theta: float, dtheta1: float, dtheta2: float, dx: float = 0.0) -> Array:
    return np.array([theta, theta, 0.1, dtheta1, dtheta2, dx])


def test_of_all_impacts_exactly_one_is_consistent_and_obeys_coulomb() -> None:
    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(400):
        p = compass_numbers(10 ** rng.uniform(-2, 1))
        z = touchdown(rng.uniform(0.05, 0.6), rng.uniform(0.3, 2), rng.uniform(-2, 0.3), rng.choice([0, rng.normal()]))
        record = landed(Dynamics(compass_system(), p), z)
        if isinstance(record, Termination):
            assert record.ending is Ending.DOUBLE_SUPPORT
            continue
        f_t, f_n = record.impulse
        slip = record.state[-1]
        assert f_n > 0
        assert record.state[2] == 0
        assert record.step_length == pytest.approx(0.1 + 2 * 1.6 * np.sin(z[0]), rel=1e-13)
        if record.mode is Mode.STICK:
            assert slip == 0
            assert abs(f_t) <= p[-1] * f_n
        else:
            assert np.sign(slip) == record.mode.direction
            assert f_t == pytest.approx(-p[-1] * np.sign(slip) * f_n, rel=1e-12)
        seen.add(record.mode)
    assert seen == set(CONTACTS)


@pytest.mark.parametrize("law", list(ImpactLaw))
def test_the_impact_sticks_down_to_the_friction_that_it_needs(law: ImpactLaw) -> None:
    z = touchdown(0.15, 0.9, -0.3)
    sticking = landed(compass(1, law), z)
    assert isinstance(sticking, ImpactRecord)
    for factor, slips in ((1 + 1e-9, False), (1.0, False), (1 - 1e-9, True), (0.5, True)):
        record = landed(compass(sticking.impulse_ratio * factor, law), z)
        assert isinstance(record, ImpactRecord)
        assert (record.mode is not Mode.STICK) == slips
        if slips and law is ImpactLaw.FRICTIONLESS:
            assert record.impulse[0] == 0


def test_a_foot_pushes_off_without_a_slip_down_to_the_friction_of_the_angle_of_its_leg() -> None:
    for factor, slips in ((1 + 1e-9, False), (1.0, False), (1 - 1e-9, True)):
        problem = load_problem("compass-push-off").replace({"friction": float(np.tan(0.15)) * factor})
        outcome = landed(problem_dynamics(problem), touchdown(0.15, 0.9, -0.3))
        assert (isinstance(outcome, Termination) and outcome.ending is Ending.PUSH_SLIPS) == slips


@pytest.mark.parametrize("friction", [0.05, 0.5, 4.099, 50.0])
@pytest.mark.parametrize("law", list(ImpactLaw))
def test_a_foot_that_comes_from_below_the_ground_has_no_impact(law: ImpactLaw, friction: float) -> None:
    """For theta < 0 the legs also pass each other, but there the foot rises."""
    for z in (touchdown(-0.15, 0.9, -0.3), touchdown(0.15, -0.9, 0.3), touchdown(-0.15, 0.9, -0.3, dx=0.4)):
        termination = landed(compass(friction, law), z)
        assert isinstance(termination, Termination)
        assert termination.ending is Ending.IMPACT_INCONSISTENT
        assert "the swing foot does not come down: its normal velocity is" in termination.reason
        assert "from below" in termination.reason


def test_no_impact_slips_in_the_paradox_of_painleve() -> None:
    """F_n (C_tt + mu s C_nt) = -det(C) v_n: the sign of the impulse says which slips have a solution."""
    rng, seen = np.random.default_rng(11), set()
    for _ in range(150):
        p = wheel_at(10 ** rng.uniform(-1, 1.5), rng.uniform(0.01, 0.3))
        z = np.array([np.pi / 8, 0, rng.uniform(0.1, 2), rng.normal()])
        record = landed(Dynamics(wheel_system(), p), z)
        for mode in (Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD):
            _, impulse, slip, _, painleve = (
                np.asarray(output).ravel() for output in foot_impact(wheel_system(), mode)(z, p)
            )
            assert np.sign(impulse[1]) == np.sign(painleve[0])
            if isinstance(record, ImpactRecord) and record.mode is mode:
                assert painleve[0] > 0
            elif painleve[0] < 0 and mode.direction * slip[0] > 0:
                seen.add(mode)
    assert seen


def test_an_impact_at_the_very_edge_of_the_cone_sticks() -> None:
    """A slip that starts with rounding for a velocity is the same impact; it is not a second one."""
    rng = np.random.default_rng(12)
    for _ in range(50):
        z = touchdown(rng.uniform(0.05, 0.3), rng.uniform(0.3, 1.5), rng.uniform(-1, 0.2), rng.normal() * 0.1)
        _, (f_t, f_n), *_ = (
            np.asarray(output).ravel() for output in foot_impact(compass_system(), Mode.STICK)(z, [*COMPASS, 1])
        )
        for rounding in (-2e-16, 0.0, 2e-16):
            record = landed(compass(abs(f_t / f_n) * (1 + rounding)), z)
            if isinstance(record, Termination):
                assert record.ending is Ending.DOUBLE_SUPPORT
            else:
                assert record.mode is Mode.STICK


def test_two_consistent_impacts_are_a_named_ending(monkeypatch: pytest.MonkeyPatch) -> None:
    """With spoiled mechanics the foot may as well stick as slip forward."""

    def spoiled(forces: ContactForces, mechanics: Mechanics, modes: Sequence[Mode], kinetic: Array) -> Solutions:
        found, slip = solved(forces, mechanics, modes, kinetic), forces.of(modes).slip
        contact = np.where(slip[:, :, None] == 0, found.contact, [0.3, 0.0])
        return replace(found, normal=np.ones_like(found.normal), tangential=0.1 * np.abs(slip), contact=contact)

    solved = ContactForces.impacts
    monkeypatch.setattr(ContactForces, "impacts", spoiled)
    monkeypatch.setattr(ClearCases, "impact", lambda *_: ([True], False))
    termination = landed(compass(0.5), touchdown(0.1, 1, 0))
    assert isinstance(termination, Termination)
    assert termination.ending is Ending.IMPACT_AMBIGUOUS
    assert "swing_foot stick and swing_foot slip_forward" in termination.reason
    fast = [SimpleNamespace(motion=np.array([50.0, aside])) for aside in (0.0, 1e-12, 1.0)]
    assert len(ContactResolver(compass(0.5))._different(fast)) == 2  # two of them move the walker alike


def test_clear_cases_are_those_that_all_candidates_give(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(5)

    def decisions() -> list[object]:
        found: list[object] = []
        for p, z, land in cases:
            resolver = ContactResolver(Dynamics(compass_system(), p))
            decided = resolver.impact(Mode.STICK, row, z) if land else resolver.mode_at_rest(CONTACTS, 0.0, z, 0)
            found.append(decided.ending if isinstance(decided, Termination) else decided)
        return [decision.mode if isinstance(decision, ImpactRecord) else decision for decision in found]

    row, cases = compass_system().transitions.of(Mode.STICK)["touchdown"], list[tuple[Array, Array, bool]]()
    for land in (True, False) * 75:
        z = touchdown(rng.uniform(0.05, 0.6), rng.uniform(0.3, 2), rng.uniform(-2, 0.3))
        z[0] = z[0] if land else rng.uniform(-0.6, 0.6)
        cases.append((compass_numbers(10 ** rng.uniform(-2, 1)), z, land))
    quick = decisions()
    for name in ("impact", "at_rest"):
        monkeypatch.setattr(ClearCases, name, lambda *_: ([True], False))
    slow = decisions()
    assert quick == slow
    assert {*CONTACTS, Ending.DOUBLE_SUPPORT} <= {*quick}


@pytest.mark.parametrize(
    ("middle", "force", "friction"),
    sampled([(1.0, 4.5, None), (2.0, 4.5, None), (1.0, 6.0, None), (2.0, 6.0, None), (1.0, 3.0, 0.15)], every=4),
)
def test_contacts_that_come_to_rest_at_nearly_one_instant_are_not_ambiguous(middle, force, friction):
    """The outer masses of a symmetric sled mirror each other, and rounding parts the instants at which they stop.

    In the last case the one still moves with 1e-11 m/s, so slowly stopped that this lasts for longer than an instant.
    """
    forces = f"first: {{pull: {force}, push: -{force}}}, second: {{pull: -{force}, push: {force}}}"
    problem = sled((1.0, middle, 1.0), 20, f"{{type: alternating, cycle: 2, {forces}}}")
    problem = problem if friction is None else problem.replace({"friction": friction})
    dynamics = problem_dynamics(problem)
    state = np.array([problem.guess.state[name] for name in dynamics.system.state_names])
    walk = Simulator(dynamics).run(state, 40)
    assert walk.ending is Ending.COMPLETED, walk.message
