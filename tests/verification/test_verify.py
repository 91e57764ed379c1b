"""Verification: it confirms good gaits, and every claim is the one to fail when just what it is about is spoilt."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import islice

import numpy as np
import pytest
from named import named, solved
from numpy.typing import NDArray
from samples import sampled

import gaitopt as go
from gaitopt import Cycle, Gait, Mode
from gaitopt.errors import SolveError
from gaitopt.gait.trajectory import Arc, ImpactRecord
from gaitopt.simulation.simulator import Simulator
from gaitopt.verification.return_map import CycleOutcome, FixedPoint, ReturnMap
from gaitopt.verification.verify import (
    LINEARITY,
    MULTIPLIER_AGREEMENT,
    Outcome,
    perturbation_claim,
    record_claims,
    return_map_claims,
)

Array = NDArray[np.float64]

STICK, FORWARD, BACKWARD = Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD
SLIGHT = 1e-6


def good(name: str = "compass-passive-a") -> Gait:
    return named(name)


def test_a_good_gait_passes_every_claim_of_the_list_and_its_record_names_the_errors_of_the_command_line() -> None:
    check = go.verify(good())
    assert check.passed
    names = [claim.name for claim in check.claims]
    assert set(names) == {
        "mode sequence", "period", "switching times", "periodicity", "states inside", "state", "friction cone",
        "slip direction", "normal force", "energy balance", "multipliers", "perturbation", "measures",
        "impact",
    }  # fmt: skip
    record = check.to_record()
    assert record["passed"] is True
    assert record["mode_sequence_matches"] is True
    for name, limit in (("period", 1e-9), ("state", 1e-9), ("multiplier", 1e-7)):
        assert 0 <= record[f"{name}_error"] < limit
    assert [claim["name"] for claim in record["claims"]] == names


def failed(gait: Gait) -> set[str]:
    return {claim.name for claim in go.verify(gait).claims if not claim.passed}


def with_arcs(gait: Gait, change: Callable[[int, Arc], Arc]) -> Gait:
    """The gait with every arc changed; ``change`` is given its index."""
    arcs = tuple(change(k, arc) for k, arc in enumerate(gait.arcs))
    return replace(gait, steps=(replace(gait.steps[0], arcs=arcs),))


def with_impact(**falsify: Callable[[ImpactRecord], object]) -> Callable[[Gait], Gait]:
    """A change of what is recorded of the impact."""

    def change(gait: Gait) -> Gait:
        impact = gait.steps[-1].impact
        impact = replace(impact, **{name: function(impact) for name, function in falsify.items()})
        return replace(gait, steps=(replace(gait.steps[0], impact=impact),))

    return change


def with_sequence(gait: Gait, phases: tuple[Mode, ...], impact: Mode) -> Gait:
    return replace(gait, problem=replace(gait.problem, modes=Cycle.of_one_step(phases, impact)))


def scaled(gait: Gait, factor: float) -> Gait:
    return replace(gait, multipliers=gait.multipliers * factor)


def lengthened(gait: Gait, seconds: float) -> Gait:
    """The last phase takes longer, on the same way."""

    def stretch(k: int, arc: Arc) -> Arc:
        factor = 1 + seconds / arc.duration if k == len(gait.arcs) - 1 else 1.0
        return replace(arc, times=arc.start + factor * (arc.times - arc.start))

    return with_arcs(gait, stretch)


# negative tests: what is spoilt, and which claims must see it


def shifted(gait: Gait) -> Gait:
    """The first switch comes later."""

    def shift(k: int, arc: Arc) -> Arc:
        ends = arc.times[[0, -1]] + np.array([SLIGHT * (k == 1), SLIGHT * (k == 0)])
        return replace(arc, times=np.interp(arc.times, arc.times[[0, -1]], ends))

    return with_arcs(gait, shift)


def put(index: int, at: tuple[object, ...], value: float | Callable[[Array], Array]) -> Callable[[Gait], Gait]:
    """A change of some entries of the states of an arc to another number, or to a function of them."""

    def spoil(k: int, arc: Arc) -> Arc:
        states = arc.states.copy()
        if k == index:
            states[at] = value(states[at]) if callable(value) else value
        return replace(arc, states=states)

    return lambda gait: with_arcs(gait, spoil)


def moved(index: int, at: tuple[object, ...]) -> Callable[[Gait], Gait]:
    """A slight change of one entry of the states of an arc."""
    return put(index, at, lambda x: x + SLIGHT)


def with_measures(change: Callable[[dict[str, float | None]], dict[str, float | None]]) -> Callable[[Gait], Gait]:
    return lambda gait: replace(gait, measures=change(dict(gait.measures)))


SPOILT: dict[str, tuple[Callable[[Gait], Gait], set[str]]] = {
    "sequence": (lambda gait: with_sequence(gait, (FORWARD, STICK), STICK), {"mode sequence"}),
    "a state inside an arc": (moved(1, (10, 0)), {"states inside"}),
    # states that are wrong inside an arc do not matter: the balance is between the ends of an arc
    "energy from nowhere": (moved(1, (-1, 3)), {"energy balance", "states inside"}),
    "multipliers": (lambda gait: scaled(gait, 1 + 2 * MULTIPLIER_AGREEMENT), {"multipliers"}),
    "order of multipliers": (lambda gait: replace(gait, multipliers=np.conj(gait.multipliers)), set()),
    "speed": (with_measures(lambda known: known | {"speed": 0.999 * known["speed"]}), {"measures"}),
    "an undefined measure": (with_measures(lambda known: known | {"required_friction": None}), {"measures"}),
    "no measures": (with_measures(lambda known: {}), {"measures"}),
    "impulse": (with_impact(impulse=lambda impact: 0.999 * impact.impulse), {"impact"}),
}
"""Changes of a gait, and all claims that see them."""


@pytest.mark.parametrize("what", SPOILT)
def test_what_is_spoilt_is_seen_by_its_claim_and_by_nothing_else(what: str) -> None:
    spoil, claims = SPOILT[what]
    assert failed(spoil(good())) == claims


@pytest.mark.parametrize(
    ("spoil", "seen", "unseen"),
    [
        (lambda gait: lengthened(gait, SLIGHT), {"period", "switching times"}, set()),
        (lambda gait: lengthened(gait, 1e-10), set(), {"period"}),
        (shifted, {"switching times"}, {"period", "periodicity", "state", "multipliers"}),
        (moved(0, (0, 3)), {"periodicity", "state"}, {"mode sequence", "multipliers", "perturbation"}),
        (put(0, (-1, -1), -SLIGHT), {"slip direction"}, set()),
        (put(0, (-1, -1), -1e-10), set(), {"slip direction"}),
        (put(1, (slice(5, 15), slice(3, 5)), 8.0), {"normal force"}, set()),
    ],
)
def test_what_is_spoilt_is_seen_by_some_claims_and_not_by_others(spoil, seen, unseen):
    rejected = failed(spoil(good()))
    assert seen <= rejected
    assert not unseen & rejected


def test_too_little_friction_is_outside_the_cone_and_a_wrong_sequence_leaves_no_period_error() -> None:
    sticking = good("compass-passive-stick")
    slippery = replace(sticking, dynamics=sticking.dynamics.at({"friction": 0.17}))
    assert failed(slippery) == {"mode sequence", "friction cone"}
    record = go.verify(with_sequence(good(), (FORWARD, STICK), STICK)).to_record()
    assert (record["mode_sequence_matches"], record["period_error"]) == (False, None)
    claim = go.verify(put(0, (0, slice(3, 5)), 0.0)(good())).claims[0]  # a motion that ends in a fall
    assert (claim.name, claim.passed) == ("mode sequence", False)
    assert "step 1" in claim.note


@cache
def examined(name: str) -> tuple[ReturnMap, FixedPoint]:
    """The simulator's return map of a gait and its fixed point."""
    gait = good(name)
    impact = gait.problem.cycle.impact
    return_map = ReturnMap(Simulator(gait.dynamics), impact, len(gait.steps))
    return return_map, return_map.fixed_point(gait.state[gait.system.section(impact).indices])


@pytest.mark.parametrize("error", sampled([1.001, 0.999, 1 + 1e-5, 1 - 1e-5], 3))
@pytest.mark.parametrize("name", ["compass-passive-a", "compass-passive-b", "rimless-wheel-slip", "slip-run-foot"])
def test_wrong_derivative_is_seen_by_walks_that_are_perturbed(name: str, error: float) -> None:
    return_map, point = examined(name)
    right = perturbation_claim(return_map, point)
    wrong = perturbation_claim(return_map, replace(point, jacobian=error * point.jacobian))
    assert right.passed
    assert right.figure < LINEARITY / 100
    assert not wrong.passed
    assert wrong.outcome is Outcome.FAILS


@pytest.mark.parametrize(("friction", "slope"), [(0.1, "1 deg"), (0.12, "1.5 deg"), (0.0628507, 0.0376889)])
def test_gait_whose_return_map_bends_strongly_passes(friction: float, slope: str | float) -> None:
    """Radii 1.10, 1.07 and 358: deviations of 1e-4 are far from linear."""
    changes = {"friction": friction, "walker.slope": slope}
    gait = go.solve(go.load_problem("compass-passive-a").replace(changes))
    assert gait.spectral_radius > 1
    assert failed(gait) == set()
    assert failed(scaled(gait, 1 + 1e-5)) == {"multipliers"}


def test_an_error_of_1e_5_is_seen_however_unstable_the_cycle_is() -> None:
    """Two steps of a gait magnify errors by 8e4; a tolerance in proportion to this would be 8e-5."""
    gait = solved(go.load_problem("compass-passive-a").replace({"friction": 0.065, "walker.slope": 0.0376889}))
    two_steps = ReturnMap(Simulator(gait.dynamics), gait.problem.cycle.impact, 2)
    for error in (0, 1e-5, -1e-5):
        twice = replace(gait, multipliers=gait.multipliers**2 * (1 + error))
        assert twice.spectral_radius > 7e4
        _, claim = islice(return_map_claims(twice, two_steps), 2)
        assert (claim.name, claim.passed) == ("multipliers", error == 0)


class Bent:
    """A return map in closed form: a linear one whose deviations bend beyond ``radius``, with the error of rounding."""

    def __init__(self, wheel: ReturnMap, point: FixedPoint, radius: float, noise: float) -> None:
        self._point, self._radius, self._noise = point, radius, noise
        self.unit, self.scaled, self._random = wheel.unit, wheel.scaled, np.random.default_rng(1)

    def __call__(self, xi: Array) -> CycleOutcome:
        deviation = (xi - self._point.xi) / self.unit
        returned = self.scaled(self._point.jacobian) @ (
            self._radius * np.tan(np.clip(deviation / self._radius, -1.5, 1.5))
        )
        noisy = returned + self._noise * self._random.standard_normal(returned.size)
        return replace(self._point.cycle, xi=self._point.xi + noisy * self.unit)


@pytest.mark.parametrize(
    ("radius", "noise", "outcome"),
    [
        (1e-2, 1e-13, Outcome.HOLDS),
        (1e-4, 1e-13, Outcome.HOLDS),
        (1e-6, 1e-14, Outcome.HOLDS),
        (1e-9, 1e-13, Outcome.NO_LINEAR_RANGE),
        (1e-3, 1e-8, Outcome.NO_LINEAR_RANGE),
    ],
)
def test_linear_range_between_rounding_and_curvature_is_found_or_its_absence_named(radius, noise, outcome):
    return_map, point = examined("rimless-wheel-slip")
    claim = perturbation_claim(Bent(return_map, point, radius, noise), point)
    assert claim.outcome is outcome
    assert claim.passed is (outcome is Outcome.HOLDS)


@pytest.mark.parametrize("factor", sampled([1 - 1e-6, 1.001, 1 + 1e-6], 2))
@pytest.mark.parametrize(
    "name",
    [
        "compass-passive-a", "compass-passive-b", "compass-torque-impact-slip", "rimless-wheel-slip", "kneed-passive",
        "compass-passive-two-step", "compass-push-off", "hopper", "slip-run-foot", "compass-torque-efficient",
    ],
)  # fmt: skip
def test_every_measure_is_recomputed(name: str, factor: float) -> None:
    gait = good(name)
    walked = Simulator(gait.dynamics).run(gait.state, steps=len(gait.steps), dense=True).steps
    for key, value in gait.measures.items():
        if value is not None and abs(value) > 1e-20:
            falsified = replace(gait, measures={**gait.measures, key: factor * value})
            measures, impact = record_claims(falsified, walked)
            assert (measures.passed, measures.note) == (False, f"worst: {key}")
            assert impact.passed


@pytest.mark.parametrize(
    ("name", "falsify"),
    [
        *(
            (name, lambda impact, name=name: (1 + SLIGHT) * getattr(impact, name))
            for name in ("impulse", "stick_impulse", "step_length", "state")
        ),
        ("push_work", lambda impact: impact.push_work + SLIGHT),
        ("mode", lambda _: BACKWARD),
    ],
)
def test_everything_that_is_recorded_of_the_impact_is_recomputed(name, falsify):
    gait = good()
    walked = Simulator(gait.dynamics).run(gait.state, dense=True).steps
    measures, claim = record_claims(with_impact(**{name: falsify})(gait), walked)
    assert (claim.passed, claim.note) == (False, f"worst: {name.replace('_', ' ')}")
    assert measures.passed


def test_parameters_that_are_stated_are_those_of_the_motion() -> None:
    gait = good("compass-torque-efficient")
    for key, value in gait.freed.items():
        assert failed(replace(gait, freed={**gait.freed, key: (1 + SLIGHT) * value})) == {"measures"}
    assert failed(replace(gait, problem=gait.problem.replace({"friction": 0.12 * (1 + SLIGHT)}))) == {"measures"}


def test_failed_attempt_cannot_be_verified() -> None:
    attempt = go.solve(go.load_problem("rimless-wheel-stick").replace({"friction": 0.5}))
    with pytest.raises(SolveError, match="there is no gait to verify: the family of the file"):
        go.verify(attempt)


# gaits at the edges of their kind


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("rimless-wheel-stick", {"friction": 0.91413}),  # needs 0.914121: perturbed walks slip for a moment
        ("rimless-wheel-slip", {"friction": 0.9141}),
        ("compass-passive-a", {"friction": 0.1748, "gait.phases": ["slip_forward", "stick"]}),
        ("compass-torque-impact-slip", {"friction": 0.232}),  # ends at 0.2322: perturbed walks come to land sticking
    ],
)
def test_gait_close_to_the_end_of_its_modes_still_passes(name: str, overrides: dict[str, object]) -> None:
    gait = solved(go.load_problem(name).replace(overrides))
    assert failed(gait) == set()


@pytest.mark.parametrize("kp", [0, 1])
def test_gait_that_tracks_itself_passes_though_its_switches_lie_on_the_breakpoints(kp: float) -> None:
    """Slip, stick and touchdown coincide with the kinks of the reference, in either order up to rounding."""
    passive = good("compass-passive-b")
    guess = {name: passive.state[passive.system.state_names.index(name)] for name in ("theta1", "dtheta1", "dtheta2")}
    tracking = go.load_problem("compass-pd-impact-slip").replace(
        {
            "friction": 0.14,
            "walker.slope": "1 deg",
            "control.kp": kp,
            "control.kd": kp,
            "gait.guess.state": guess | {"dx": passive.state[-1]},
        }
    )
    gait = go.solve(tracking)
    assert failed(gait) == set()
    assert gait.period == pytest.approx(passive.period, abs=1e-9)
    assert gait.measures["peak_torque"] < 1e-9


@pytest.mark.parametrize("beyond_end", ["linear", pytest.param("off", marks=pytest.mark.slow)])
def test_step_that_outlasts_its_reference_unlike_its_guess_is_solved_with_what_comes_after(beyond_end: str) -> None:
    """The motion of the guess has no touchdown before the last breakpoint of its reference; the gait lands after it."""
    tracking = go.load_problem("compass-pd-impact-slip").replace(
        {
            "friction": 0.15,
            "walker.slope": "1 deg",
            "control.kp": 1,
            "control.kd": 1,
            "control.reference.beyond_end": beyond_end,
            "gait.guess.state": {"theta1": -0.079, "dtheta1": 0.2, "dtheta2": -0.4, "dx": 0.5},
        }
    )
    gait = go.solve(tracking)
    assert gait.period > gait.system.control.breakpoints[-1]
    assert failed(gait) == set()
