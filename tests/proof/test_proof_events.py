"""Proofs of gaits with several contacts, stops, switches, flight, a push-off, or phases of given duration."""

import json
from dataclasses import replace
from functools import cache
from io import StringIO
from types import SimpleNamespace
from typing import Annotated

import numpy as np
import pytest
from casadi import sin
from certificates import (
    BALLS,
    certificate_of,
    failed,
    gait,
    proof,
    refusals,
    restored,
    reworded,
    through_json,
    without_boxes,
)
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
from gaitopt.proof import claims
from gaitopt.proof.arithmetic import PRECISION, NotProved, ball
from gaitopt.proof.certificate import read_certificate
from gaitopt.proof.check import check
from gaitopt.proof.prove import RADIUS, arc_records, divide_into_steps, newton_step
from gaitopt.proof.statement import restore_statement
from gaitopt.show.tables import print_proof

"""All problems that are proved here, and whether they are stable."""


def test_the_damped_oscillations_of_the_crawler_lie_in_its_enclosures():
    result = proof("crawler")
    with ctx.workprec(PRECISION):
        known = crawl(ball("0.4"), ball("0.6"), ball("0.1"), ball, BALLS)
        assert result.state["gap"].overlaps(known.smallest)
        assert all(result.state[name].is_zero() or result.state[name].contains(0) for name in ("rise", "y", "dgap"))
        assert result.durations[0].overlaps(known.times[0])
        assert result.durations[2].overlaps(known.times[1])
        assert result.measures["step_length"].overlaps(known.largest - known.smallest)
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


def test_a_phase_whose_end_is_forged_is_refused():
    """The second phase of the crawler ends at the breakpoint, and the first one where the front stops.

    Nothing would make the velocity of a slip zero at a breakpoint, or that of two contacts at one instant.
    """
    assert [arc["phase"] for arc in certificate_of("crawler")["arcs"] if arc.get("timed")] == [1]
    for timed in ((), (0, 1), (1, 3)):
        data = certificate_of("crawler")
        for arc in data["arcs"]:
            arc["timed"] = arc["phase"] in timed
        refusals(data)
    data["arcs"][0]["timed"], data["arcs"][1]["timed"], data["arcs"][3]["timed"] = True, False, False
    assert "cannot end at a breakpoint" in refusals(data)["statement"]
    both = reworded(
        certificate_of("crawler"), ("{rear: stick, front: slip_forward}", "{rear: slip_backward, front: slip_forward}")
    )
    assert refusals(both)["statement"].startswith("rear and front stop at one instant")


@pytest.mark.parametrize(
    ("name", "change", "refused"),
    [
        ("crawler", ("front: 0.4", "front: 0.41"), "existence and uniqueness"),
        ("crawler", ("slope: 0.1", "slope: 0.101"), "existence and uniqueness"),
        ("crawler", ("rear: 0.6, front: 0.4", "rear: {static: 0.59, kinetic: 0.6}, front: 0.4"), "statement"),
        ("crawler", ("{rear: stick, front: slip_forward}", "{rear: stick, front: slip_backward}"), ""),
        ("hopper", ("thrust: 200", "thrust: 201"), "existence and uniqueness"),
        ("hopper", ("{mode: flight, leg: locked", "{mode: flight, leg: free"), ""),
    ],
)
def test_a_walker_with_events_whose_text_is_forged_is_refused(name, change, refused):
    assert any(claim.startswith(refused) for claim in refusals(reworded(certificate_of(name), change)))


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
    certificate = without_boxes(parse_problem(json.dumps(data), walkers=[DrivenHopper], controls=[Idle]), timed=(1,))
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
    result = check(through_json(certificate), walkers=[DrivenHopper], controls=[Idle])
    assert failed(result).keys() == {"arc 3, flight, leg free, thrust on: mode at rest", "touchdown"}, failed(result)


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
    claim = {c.name: c.finding for c in proof("kneed-passive").claims}["arc 1, stick, knee free: apparent mass"]
    assert "a slip would pull the ground" in claim


TWO = "rear: {static: 0.63, kinetic: 0.6}, front: {static: 0.42, kinetic: 0.4}"


@cache
def crawler():
    """The proof of the crawler with two coefficients for each of its contacts."""
    text = gait("crawler").problem.text.replace("rear: 0.6, front: 0.4", TWO)
    return prove(solve(parse_problem(text), progress=False), progress=False)


def test_the_crawler_slides_with_kinetic_friction_and_starts_where_static_friction_ends():
    """Its contacts slide with the kinetic coefficients, so that its closed form holds; see ``walkers.crawler``."""
    result = crawler()
    assert result.proved, failed(result)
    assert [claim.name for claim in result.claims if "mode at rest" in claim.name] == [
        "arc 1, rear: stick, front: slip_forward: mode at rest",
        "arc 3, rear: slip_forward, front: stick: mode at rest",
    ]
    assert abs(float(result.measures["step_length"].mid()) - gait("crawler").measures["step_length"]) < 1e-12
    with ctx.workprec(PRECISION):
        known = crawl(ball("0.4"), ball("0.6"), ball("0.1"), ball, BALLS)
        assert result.durations[0].overlaps(known.times[0])


@pytest.mark.parametrize(
    ("static", "refused"),
    [
        # static friction holds the front, so that the walker would rest
        ("0.9", "arc 1, rear: stick, front: slip_forward: mode at rest"),
        ("0.39", "statement"),
    ],
)
def test_a_forged_static_coefficient_is_refused(static, refused):
    certificate = through_json(crawler().certificate)
    assert refused in refusals(reworded(certificate, ("static: 0.42", f"static: {static}")))


@pytest.mark.slow
def test_heel_and_toe_with_two_coefficients_are_proved():
    friction = {"friction": {"static": 0.264, "kinetic": 0.262}}
    walk = solve(gait("heel-toe-slip").problem.replace(friction), progress=False)
    result = prove(walk, progress=False)
    assert result.proved, failed(result)
    assert result.stable
    for key in ("period", "step_length"):
        assert abs(float(result.measures[key].mid()) - walk.measures[key]) < 1e-9, key
    assert check(through_json(result.certificate)).proved


@pytest.mark.slow
def test_where_a_contact_leaves_the_ground_no_other_one_slips_instead():
    """A heel leaves the ground: as many contacts would stick if it stayed and the heel of the other foot slipped."""
    walk = gait("flat-foot")
    problem = parse_problem(json.dumps(problem_data(walk.problem) | {"friction": {"static": 1.2, "kinetic": 1.1}}))
    statement = restored(without_boxes(problem))
    with ctx.workprec(PRECISION):
        names = claims.mode_claim_names(statement.system, statement.law, statement.cycle, statement.arcs)
        assert [name.partition(",")[0] for name in names if name.endswith("mode at rest")] == ["arc 2"]
        y = [arb(float(value), 1e-9) for value in (*walk.arcs[1].states[0], walk.arcs[1].start)]
        words, _ = claims._mode_at_rest(statement.orbit(()), 1, y)
    assert words.endswith("swing_heel cannot")


@cache
def inchworm():
    """The gait of the inchworm with two coefficients for each of its contacts, which never slip forward together."""
    data = problem_data(gait("inchworm").problem)
    data["friction"] = {"rear": {"static": 0.55, "kinetic": 0.5}, "front": {"static": 0.44, "kinetic": 0.4}}
    data["gait"]["phases"] = [phase for k, phase in enumerate(data["gait"]["phases"]) if k not in (6, 7)]
    state = {"rear_angle": 0.5992, "front_angle": 0.5992, "y": 0.4129, "drear_angle": 0.9909, "dfront_angle": 0.9909,
             "dy": -0.2794, "dx": 0.3042}  # fmt: skip
    durations = [0.0502, 0.1928, 0.0689, 0.0084, 0.3764, 0.111, 0.0122, 0.0168, 0.1633]
    data["gait"]["guess"] = {"state": state, "durations": durations}
    walk = solve(parse_problem(json.dumps(data)), progress=False)
    assert walk.converged, walk.message
    return walk


def test_where_a_contact_of_the_inchworm_begins_to_slip_no_other_one_slips_instead():
    """The state in which the front begins to slip is none in which the rear does, although as many contacts stick."""
    walk, other = inchworm(), r"rear stick \+ front slip_forward, in which as many contacts stick, is not shown"
    statement = restored(without_boxes(walk.problem))
    with ctx.workprec(PRECISION):
        names = claims.mode_claim_names(statement.system, statement.law, statement.cycle, statement.arcs)
        starts = [int(name.split(",")[0].removeprefix("arc ")) - 1 for name in names if name.endswith("mode at rest")]
        assert starts == [3, 4, 7, 8]
        y = {j: [arb(float(value), 1e-9) for value in (*walk.arcs[j].states[0], walk.arcs[j].start)] for j in starts}
        for j in starts:
            assert claims._mode_at_rest(statement.orbit(()), j, y[j])[0].endswith("cannot")
        with pytest.raises(NotProved, match=other):
            claims._mode_at_rest(statement.orbit(()), 3, y[7])


@pytest.mark.slow
def test_the_inchworm_with_two_coefficients_is_proved():
    """Its contacts change their modes nine times per cycle."""
    walk = inchworm()
    result = prove(walk, progress=False)
    assert result.proved, failed(result)
    assert result.stable
    assert abs(float(result.measures["step_length"].mid()) - walk.measures["step_length"]) < 1e-9
    assert refusals(reworded(through_json(result.certificate), ("0.44", "0.441")))
