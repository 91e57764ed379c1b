"""Proofs of gaits with several contacts, stops, switches, flight, a push-off, or phases of given duration."""

import json
from copy import deepcopy
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace
from typing import Annotated

import numpy as np
import pytest
from casadi import sin
from certificates import certificate_of, failed, negated, proof, refusals, reworded
from driven_walkers import DrivenHopper
from flint import acb, arb, ctx
from jumping import PUSH, SLIPPING, STATE, Staircase
from named import named
from oracles import crawl
from rich.console import Console

from gaitopt import Fixed, Walker, load_problem, parse_problem, prove, solve
from gaitopt.model.control import Control
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.problem.statement import problem_data
from gaitopt.problem.writing import write_problem
from gaitopt.proof import claims, orbit
from gaitopt.proof.arithmetic import PRECISION, NotProved, ball
from gaitopt.proof.certificate import SCHEMA, ProblemRecord, read_certificate
from gaitopt.proof.check import check
from gaitopt.proof.prove import RADIUS, arc_records, divide_into_steps, newton_step
from gaitopt.proof.statement import restore_statement
from gaitopt.proof.taylor import VectorField
from gaitopt.show.tables import print_proof

QUICK = ("crawler", "hopper")
STABLE = {
    "crawler": True,
    "hopper": True,
    "slip-run": True,
    "compass-push-off": True,
    "kneed-passive": True,
    "telescopic-passive": True,
    "heel-toe": True,
    "heel-toe-slip": True,
    "heel-toe-impact-slip": False,
    "inchworm": True,
}
"""All problems that are proved here, and whether they are stable."""
STATE_TOLERANCE, MULTIPLIER_TOLERANCE = 3e-12, 1e-7


@pytest.mark.parametrize("name", [n if n in QUICK else pytest.param(n, marks=pytest.mark.slow) for n in STABLE])
def test_a_gait_with_events_within_its_step_is_proved_where_the_solver_finds_it(name):
    result, gait = proof(name), named(name)
    assert result.stable is STABLE[name]
    for value, bounds in zip(gait.state, result.state.values(), strict=True):
        assert abs(float(bounds.mid()) - value) < STATE_TOLERANCE
    for (_, duration), bounds in zip(gait.phases, result.durations, strict=True):
        assert abs(float(bounds.mid()) - duration) < STATE_TOLERANCE
    for key in ("period", "step_length", "work", "required_friction"):
        if result.measures[key] is not None:
            assert abs(float(result.measures[key].mid()) - gait.measures[key]) < 1e-9, key
    for multiplier in gait.multipliers:
        assert min(abs(complex(m.mid()) - multiplier) for m in result.multipliers) < MULTIPLIER_TOLERANCE
    again = check(certificate_of(name))
    assert again.proved
    assert {claim.name for claim in again.claims} == {claim.name for claim in result.claims}


class BALLS:
    """Functions of balls, by the names of NumPy's."""

    sin, cos, sqrt, exp = arb.sin, arb.cos, arb.sqrt, arb.exp
    pi = arb.pi()


def test_the_damped_oscillations_of_the_crawler_lie_in_its_enclosures():
    result = proof("crawler")
    with ctx.workprec(PRECISION):
        known = crawl(ball("0.4"), ball("0.6"), ball("0.1"), ball, BALLS)
        assert result.state["gap"].overlaps(known.least)
        assert all(result.state[name].is_zero() or result.state[name].contains(0) for name in ("rise", "y", "dgap"))
        assert result.durations[0].overlaps(known.times[0])
        assert result.durations[2].overlaps(known.times[1])
        assert result.measures["step_length"].overlaps(known.largest - known.least)
        assert result.multipliers[0].real.overlaps(known.factors[0] * known.factors[1])
        assert float(result.state["gap"].rad()) < 1e-11
    assert result.minimal_period
    assert result.statement["cycle_end"] == "clock"


def test_the_speed_and_the_multiplier_of_the_hopper_lie_in_their_enclosures():
    """v^2 = m (1 + 2 A g) / (k A^2), multiplier rho^2 + (1 - rho^2) / (2 (1 + A g)); see ``walkers.hopper``."""
    result = proof("hopper")
    with ctx.workprec(PRECISION):
        body, foot, stiffness, thrust, g = map(ball, ("8", "2", "4000", "200", "9.81"))
        rho = body / (body + foot)
        depth = (1 / rho**2 - 1) * body / (2 * thrust)
        assert result.state["dshortening"].overlaps((body * (1 + 2 * depth * g) / (stiffness * depth**2)).sqrt())
        assert result.multipliers[0].real.overlaps(rho**2 + (1 - rho**2) / (2 * (1 + depth * g)))
    assert result.measures["cost_of_transport"] is None


@pytest.mark.parametrize("entry", [0, 2])
def test_a_forged_gap_or_height_of_the_crawler_is_refused(entry):
    data = certificate_of("crawler")
    centre = data["boxes"][0]["centre"]
    centre[entry] = repr(float(centre[entry]) + 1e-6)
    assert refusals(data).keys() == {"existence and uniqueness"}


def test_a_phase_whose_end_is_forged_is_refused():
    """The second phase of the crawler ends at the breakpoint, and the first one where the front stops."""
    data = certificate_of("crawler")
    timed = [arc for arc in data["arcs"] if arc.get("timed")]
    assert [arc["phase"] for arc in timed] == [1]
    untimed = deepcopy(data)
    untimed["arcs"][1]["timed"] = False
    refusals(untimed)
    for phase in (0, 3):
        wrong = deepcopy(data)
        wrong["arcs"][phase]["timed"] = True
        refusals(wrong)


def test_a_slip_cannot_stop_at_a_breakpoint_nor_together_with_another_one():
    """Nothing would make the velocity zero, and a contact that sticks would go on with it for the rest of the cycle."""
    data = certificate_of("crawler")
    data["arcs"][0]["timed"], data["arcs"][1]["timed"] = True, False
    assert "cannot end at a breakpoint" in refusals(data)["statement"]
    both = reworded(
        certificate_of("crawler"), ("{rear: stick, front: slip_forward}", "{rear: slip_backward, front: slip_forward}")
    )
    assert refusals(both)["statement"].startswith("rear and front stop at one instant")


@pytest.mark.parametrize(
    ("changes", "refused"),
    [
        ((("front: 0.4", "front: 0.41"),), "existence"),
        ((("slope: 0.1", "slope: 0.101"),), "existence"),
        ((("rear: 0.6, front: 0.4", "rear: {static: 0.59, kinetic: 0.6}, front: 0.4"),), "statement"),
        ((("{rear: stick, front: slip_forward}", "{rear: stick, front: slip_backward}"),), ""),
    ],
)
def test_a_crawler_whose_text_is_forged_is_refused(changes, refused):
    assert any(name.startswith(refused) for name in refusals(reworded(certificate_of("crawler"), *changes)))


def test_a_hopper_with_another_thrust_or_sequence_is_refused():
    assert "existence and uniqueness" in refusals(reworded(certificate_of("hopper"), ("thrust: 200", "thrust: 201")))
    refusals(reworded(certificate_of("hopper"), ("{mode: flight, leg: locked", "{mode: flight, leg: free")))


class Idle(Control):
    """A motor at rest, and a breakpoint at which nothing happens."""

    type = "idle"
    time: Annotated[float, Fixed]

    @property
    def breakpoints(self):
        return (self.time,)

    def torques(self, now):
        return {"leg_motor": 0 * now.r[0]}

    def data(self, segment):
        return np.array([float(segment)])


@pytest.mark.slow
def test_a_foot_on_which_the_ground_pushes_does_not_take_off():
    """An orbit on which the foot is let go at a breakpoint, sinks, and comes up again when the leg has locked.

    States and durations are those of an integration by hand; without the impact of the leg, in flight, they are no
    orbit. A certificate may state that a phase ends at a breakpoint.
    """
    starts = ((0, 0, 4.0094469533, 0), (0.19999814209, 0, 0, 0), (0.01530361951, 0, -5.0491135489, 0))
    starts = (*starts, (0, -0.000550294124, 0, 4.0107931437))
    durations = 0.0751221998302, 0.0613208001698, 0.00290496385087, 0.817557604185
    free, locked = {"leg": "free", "thrust": "on"}, {"mode": "flight", "leg": "locked", "thrust": "on"}
    phases = [{"mode": "stick", "leg": "free", "thrust": "off"}, *({"mode": m, **free} for m in ("stick", "flight"))]
    data = problem_data(load_problem("hopper"))
    data["gait"] = data["gait"] | {"phases": [*phases, locked]}
    data |= {"walker": data["walker"] | {"model": "driven_hopper"}, "control": {"type": "idle", "time": 0.136443}}
    problem = parse_problem(json.dumps(data), walkers=[DrivenHopper], controls=[Idle])
    certificate = {"schema": SCHEMA, "problem": ProblemRecord.of(write_problem(problem)).model_dump(), "intervals": {}}
    certificate |= {"designed": {}, "law": None, "reference": None, "varied": None, "special": None, "order": 20}
    certificate |= {"arcs": [{"phase": k, "fractions": [], "timed": k == 1} for k in range(4)], "boxes": []}
    with ctx.workprec(PRECISION):
        statement = restore_statement(read_certificate(certificate), [DrivenHopper], [Idle])
        times = np.cumsum((0, *durations)).tolist()
        arcs = [
            SimpleNamespace(states=[np.array([s, y, 0, ds, dy, 0])], start=start, duration=duration)
            for (s, y, ds, dy), start, duration in zip(starts, times, durations, strict=False)
        ]
        divided, centre = divide_into_steps(statement.orbit(()), SimpleNamespace(arcs=arcs))
        equations = replace(statement, arcs=divided).orbit(())
        for _ in range(3):
            centre, _ = newton_step(equations, centre)
        pulled, _ = claims._mode_at_rest(equations, 2, [arb(value) for value in (-0.1, 0, 0, 0, 0, 0, 0)])
        assert "a foot that is let go rises" in pulled  # by a spring that is extended
        radii = [f"{RADIUS * unit:.2e}" for unit in equations.unit_of_unknowns.tolist()]
        texts = [value.str(30, radius=False) for value in centre]
    certificate["arcs"] = arc_records(divided)
    certificate["boxes"] = [{"interval": [], "centre": texts, "tilt": ["0"] * len(texts), "radii": radii}]
    result = check(json.loads(json.dumps(certificate)), walkers=[DrivenHopper], controls=[Idle])
    assert failed(result).keys() == {"arc 3, flight, leg free, thrust on: mode at rest", "touchdown"}, failed(result)


def one_higher(order):
    return lambda *a: order(*a) and order(*a) + 1


def opposite(impact):
    def margins(self, struck, j):
        graph = impact(self, struck, j)
        return lambda y: [[-value for value in values] if k == 0 else values for k, values in enumerate(graph(y))]

    return margins


def refusing(self, cycle):
    raise NotProved("singular")


MUTATIONS = {
    "regularity": (VectorField, "regularities", lambda old: negated(old.func), "crawler", "unique forces"),
    "section": (orbit.Orbit, "require_section", lambda old: refusing, "crawler", "section"),
    "order of a slip": (claims, "_order_of_zero", lambda old: lambda *_: 0, "crawler", "slip_velocity.front"),
    "too high an order": (claims, "_order_of_zero", one_higher, "crawler", "motion"),
    "order of a stop": (claims, "zeros_after_impact", lambda old: lambda *_: 0, "hopper", "leg"),
    "impulse of a stop": (orbit.Orbit, "impact", opposite, "hopper", "impact"),
}


@pytest.mark.parametrize("mutation", MUTATIONS)
def test_a_mutation_of_the_claims_about_events_is_noticed(mutation, monkeypatch):
    owner, attribute, spoil, name, claim = MUTATIONS[mutation]
    data = certificate_of(name)
    monkeypatch.setattr(owner, attribute, spoil(getattr(owner, attribute)))
    assert any(claim in refused for refused in refusals(data))


class SineCompass(CompassBiped):
    """The compass, whose closure of the legs is stated by a function that is not linear."""

    model = "sine_compass"
    after_impact = vars(Walker)["after_impact"]

    @classmethod
    def mechanism(cls, q, p):
        """The mechanism of the compass, with another guard."""
        return replace(super().mechanism(q, p), touchdown=sin(q.theta1 - q.theta2))

    @classmethod
    def links(cls, q, p):
        return super().links(q, p)


@pytest.mark.slow
def test_a_closure_that_is_not_linear_is_proved():
    text = load_problem("compass-passive-stick").text.replace("model: compass_biped", "model: sine_compass")
    result = prove(solve(parse_problem(text, walkers=[SineCompass])))
    assert result.proved, failed(result)
    assert "section" in {claim.name for claim in result.claims}
    straight = prove(named("compass-passive-stick"))
    assert "section" not in {claim.name for claim in straight.claims}
    for name, bounds in straight.state.items():
        assert result.state[name].overlaps(bounds), name
    assert all(a.real.overlaps(b.real) for a, b in zip(result.multipliers, straight.multipliers, strict=True))
    data = json.loads(json.dumps(result.certificate))
    assert check(data, walkers=[SineCompass]).proved
    data["boxes"][0]["centre"][1] = repr(float(data["boxes"][0]["centre"][1]) + 1e-6)  # theta2, which c determines
    assert failed(check(data, walkers=[SineCompass])).keys() == {"existence and uniqueness"}


def test_a_multiplier_that_may_be_on_the_unit_circle_leaves_stability_undecided(monkeypatch):
    monkeypatch.setattr("gaitopt.proof.check.multipliers", lambda derivatives: (acb(arb(1, 1e-9)),))
    result, out = check(certificate_of("crawler")), StringIO()
    assert result.proved
    assert result.stable is None
    record = result.to_record()
    assert "whether the gait is stable: a multiplier may be on the unit circle" in record["statement"]["not_proved"]
    print_proof(Console(file=out, width=200), record)
    assert out.getvalue().startswith("crawler: proved, stability undecided\n")


@pytest.mark.slow
def test_a_toe_that_would_slip_is_refused_by_the_edge_of_its_cone():
    """Friction does not enter the motion of heel-toe, in which nothing slips; it needs 0.27484."""
    refused = refusals(reworded(certificate_of("heel-toe"), ("friction: 0.3", "friction: 0.2748")))
    assert refused.keys() == {"arc 1, heel: stick, toe: off, swing_heel: off, swing_toe: off: cone_forward.heel"}


@pytest.mark.slow
def test_a_phase_that_ends_because_the_torques_jump_is_proved():
    """One foot that sticks until a breakpoint, where the ankle begins to push."""
    law = f"control: {{type: {Staircase.type}, times: [{PUSH[0]}, {PUSH[1]}], levels: [-1.0, 12.0, -1.0]}}\n"
    phases = f"gait:\n  phases: [{', '.join(SLIPPING)}]\n  impact: stick\n  guess: {{state: {json.dumps(STATE)}}}\n"
    head = load_problem("compass-passive-stick").text.partition("gait:")[0]
    problem = parse_problem(f"{head}{law}{phases}", controls=[Staircase])
    result = prove(solve(problem.replace({"friction": 0.165})))
    assert result.proved, failed(result)
    assert [arc["phase"] for arc in result.certificate["arcs"] if arc.get("timed")] == [0]


@pytest.mark.slow
def test_where_the_apparent_mass_is_negative_the_foot_would_have_to_pull():
    """On friction 1 the kneed walker is in the paradox of Painleve in the middle of its step, but its foot sticks."""
    claim = {c.name: c.words for c in proof("kneed-passive").claims}["arc 1, stick, knee free: apparent mass"]
    assert "a slip would pull the ground" in claim
