"""Forged certificates: by hand, one per line of the theorem, and by machine, field by field. None may prove a lie.

A certificate that passes has to be about what its printed statement says: the same orbit, under the same statement as
the original, but for entries that are printed and that the forgery has changed itself.
"""

import json
import re
from copy import deepcopy
from dataclasses import replace
from functools import reduce
from importlib import import_module
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from certificates import certificate_of, gait, refusals, restored, reworded, spoiled, through_json, without_boxes
from flint import arb, ctx
from named import solved

from gaitopt import Mode, load_problem, parse_problem, prove, solve
from gaitopt.errors import StorageError
from gaitopt.model.control import NoControl
from gaitopt.model.curve import BeyondEnd, Curve, continued
from gaitopt.model.cycle import Cycle
from gaitopt.model.friction import Friction
from gaitopt.model.system import HybridSystem
from gaitopt.model.tracking import ProportionalDerivative
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.model.walkers.hopper import Hopper
from gaitopt.model.walkers.kneed import KneedWalker
from gaitopt.model.walkers.rimless_wheel import RimlessWheel
from gaitopt.problem.source import parse_source
from gaitopt.proof.arithmetic import PRECISION, NotProved, Refuted
from gaitopt.proof.certificate import parse_certificate, read_certificate, sha256
from gaitopt.proof.check import BRACKETED, MARGIN_CHANGES, MOTION, check, check_box, conclude
from gaitopt.proof.claims import (
    ProofClaim,
    _mode_at_rest,
    _starts_at_rest,
    _time_window,
    mode_claim_names,
    zeros_after_impact,
)
from gaitopt.proof.law import ExactLaw
from gaitopt.proof.law_data import _steps, motion_claim
from gaitopt.proof.orbit import Orbit
from gaitopt.proof.prove import (
    DIGITS,
    RADIUS,
    arc_records,
    arcs_of,
    certificate_header,
    divide_into_steps,
    motion_record,
    newton_step,
)
from gaitopt.proof.statement import restore_statement
from gaitopt.solver.solve import solve_gait

check_module = import_module("gaitopt.proof.check")
WHEEL, TRACKED = "rimless-wheel-stick", "compass-pd-impact-slip"
REFERENCE = ("designed", "law", "reference", "order", "arcs", "boxes")
"""Fields of the proof of the gait that a law starts from."""
PAGE = Path(__file__).parents[2] / "docs" / "developer" / "proof-tests.md"


def unproved(name):
    """A certificate without boxes, whose statement is right: enough for forgeries that no box is needed to refuse."""
    solved = gait(name)
    return through_json(certificate_header(solved) | {"arcs": arc_records(arcs_of(solved))})


def bracket(lower="0.9141", upper="0.9142"):
    """The sticking wheel loses its grip in between, at 0.91412078; friction does not enter its motion."""
    certificate = certificate_of(WHEEL) | {"varied": "friction", "special": "mode_change"}
    (box,) = certificate["boxes"]
    certificate["intervals"] = {"friction": f"{lower}..{upper}"}
    certificate["boxes"] = [box | {"interval": ends} for ends in ([lower, lower], [lower, upper], [upper, upper])]
    return certificate


# the control law


def test_a_law_is_that_of_its_problem_not_of_its_certificate():
    original = unproved("compass-torque-stick")
    with pytest.raises(StorageError, match=r"control: Extra inputs"):
        check(original | {"control": {"type": "none"}})
    certificate = reworded(original, ("type: constant_torque", "type: none"))
    assert "control.ankle" in refusals(certificate)["statement"]
    words = restored(reworded(original, ("ankle: 1.65", "ankle: 1.66"))).printed
    assert words["parameters"]["control.ankle"] == "1.66"  # a right statement, but about another problem
    assert words["sha256"] != restored(original).printed["sha256"]


def test_the_rates_of_a_tracked_curve_are_its_derivatives():
    """A certificate cannot state them; the checker derives them in balls."""
    certificate = unproved(TRACKED)
    statement = restored(certificate)
    for k, data in enumerate(statement.law.data):
        expected = statement.system.control.data(k)
        np.testing.assert_allclose([float(value) for value in data], expected, rtol=1e-12, atol=1e-12)
    certificate["law"]["pieces"][0]["rates"] = certificate["law"]["pieces"][0]["angles"]
    with pytest.raises(StorageError, match="rates: Extra inputs"):
        check(certificate)
    with pytest.raises(StorageError, match="pieces"):
        check(certificate | {"law": {"pieces": []}})


@pytest.mark.parametrize("beyond_end", ["hold", "linear", "off"])
def test_a_reference_ends_as_the_problem_says(beyond_end):
    """Beyond the stated pieces the checker continues it; only a motion that flows on is stated there."""
    certificate = reworded(unproved(TRACKED), ("beyond_end: flow", f"beyond_end: {beyond_end}"))
    tracked = gait(TRACKED).system.control.reference.motion()
    pieces = tracked.pieces
    last_of_gait = 2  # slip and stick; what follows is the motion that flows on
    motion = continued(tracked.names, pieces[:last_of_gait], pieces[last_of_gait].start, BeyondEnd(beyond_end))
    certificate["law"] = through_json(motion_record(motion))
    assert len(certificate["law"]["pieces"]) == last_of_gait
    statement = restored(certificate)
    *_, after = statement.law.data
    assert statement.law.horizon is None
    assert float(after[2]) == float(beyond_end != "off")
    np.testing.assert_allclose([float(value) for value in after], statement.system.control.data(2), atol=1e-12)


def test_a_tracked_curve_is_part_of_the_printed_statement():
    """Without the proof of the gait that the problem names, nothing shows that the curve is its motion."""
    certificate = unproved(TRACKED)
    words = restored(certificate).printed
    assert any("compass-passive-b" in silent for silent in words["not_proved"])
    other = reworded(certificate, ("friction: 0.14", "friction: 0.15"), within=["compass-passive-b"])
    assert restored(other).printed["texts"] != words["texts"]
    for piece in certificate["law"]["pieces"]:
        piece["angles"][0][0] += 1e-9
    assert restored(certificate).printed["law"]["curve_sha256"] != words["law"]["curve_sha256"]


@pytest.mark.parametrize("piece", [0, 1])
@pytest.mark.parametrize("change", [(1e-8, 0.0), (-1e-8, 1e-8)], ids=["angle", "rate alone"])
def test_a_tracked_curve_does_not_jump(piece, change):
    certificate = unproved(TRACKED)
    row = certificate["law"]["pieces"][piece]["angles"][1]
    row[0], row[2] = row[0] + change[0], row[2] + change[1]
    assert "the reference of theta2 jumps where its piece 2 starts, at 0.0863441" in refusals(certificate)["statement"]


@pytest.mark.slow
def test_designed_values_are_part_of_the_printed_statement():
    certificate = unproved("compass-pd-designed")
    assert "control.reference.theta1.0" in restored(certificate).printed["designed"]
    certificate["designed"]["control.reference.theta1.1"] = "-0.3"
    changed = restored(certificate).printed
    assert changed["parameters"]["control.reference.theta1.1"] == "-0.3"
    certificate["law"]["duration"] *= 1.1
    assert restored(certificate).printed["law"]["duration"] != changed["law"]["duration"]


DESIGNED = ("compass-pd-designed", "control.reference.theta1.1")


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [
        pytest.param(
            "compass-pd-designed", "control.reference.theta1.1", "0.6" + 18 * "0" + "2", marks=pytest.mark.slow
        ),
        ("compass-torque-efficient", "control.ankle", "5.1"),
    ],
)
def test_a_designed_value_outside_of_its_bounds_is_refused(name, key, value):
    certificate = unproved(name)
    assert "no boxes" in refusals(certificate)["statement"]
    certificate["designed"][key] = value
    assert "outside of its bounds" in refusals(certificate)["statement"]
    del certificate["designed"][key]
    assert key in refusals(certificate)["statement"]


def changed(*path):
    """A change of a certificate in which a function of the last entry's value takes its place."""
    *holder, last, function = path

    def change(certificate):
        place = at(certificate, holder)
        place[last] = function(place[last])
        return certificate

    return change


def with_two_coefficients(certificate):
    """A certificate with intervals of static and kinetic friction that overlap."""
    certificate["problem"]["set"] = {"friction": {"static": 1.0, "kinetic": 0.95}}
    return certificate | {"intervals": {"friction.static": "0.97..1.0", "friction.kinetic": "0.95..1.0"}}


BRACKET = "bracket"
WRONG_INTERVALS = ("-0.1..0.9142", "0.9142..0.9141", "0.9142..0.9142")
CONTRADICTIONS = [
    (WHEEL, changed("problem", "text", lambda text: f"{text}\n"), "SHA-256"),
    (WHEEL, changed("boxes", 0, "tilt", lambda tilt: [*tilt[:-5], "1", *tilt[-4:]]), "is tilted"),
    (WHEEL, lambda c: reworded(c, ("spokes: 10\n", "spokes: 10.000000000000001\n")), "spokes"),
    (WHEEL, with_two_coefficients, "contradict each other: friction.static, friction.kinetic"),
    # law data, and a reference, that no law needs
    (WHEEL, lambda c: c | {"law": {"duration": 0.7}}, "needs none"),
    (WHEEL, lambda c: c | {"reference": {name: c[name] for name in REFERENCE}}, "from which its law takes nothing"),
    # those that do not fit the law
    (TRACKED, lambda c: c | {"law": None}, "which it does not contain"),
    (TRACKED, lambda c: c | {"law": {"duration": 0.7}}, "which it does not contain"),
    (TRACKED, changed("law", "pieces", lambda pieces: pieces[::-1]), "do not follow each other"),
    (TRACKED, changed("law", "pieces", 0, "angles", lambda angles: angles[:-1]), "motion of 2 joints"),
    (TRACKED, changed("arcs", lambda arcs: arcs + arcs[-1:] * 9), "ends with a breakpoint, but the control has "),
    # special points
    (WHEEL, lambda c: c | {"special": "mode_change"}, "no parameter that varies"),
    (WHEEL, lambda c: c | {"varied": "friction"}, "has no interval"),
    (WHEEL, lambda c: c | {"boxes": 2 * c["boxes"]}, "2 boxes"),
    (BRACKET, lambda c: c | {"varied": "frictoin"}, "frictoin varies, but it has no interval"),
    (BRACKET, lambda c: c | {"intervals": {"frictoin": "0.9141..0.9142"}}, "no parameter is called 'frictoin'"),
    *((BRACKET, changed("intervals", "friction", lambda _, i=i: i), "friction cannot be") for i in WRONG_INTERVALS),
]
"""Certificates, what is spoiled in them, and the words of the refusal."""


@pytest.mark.parametrize(("name", "change", "words"), CONTRADICTIONS, ids=[words for *_, words in CONTRADICTIONS])
def test_a_statement_that_contradicts_itself_is_refused(name, change, words):
    certificate = {WHEEL: certificate_of, TRACKED: unproved, BRACKET: lambda _: bracket()}[name](name)
    assert words in refusals(change(certificate))["statement"]


def test_a_problem_names_nothing_but_the_texts_of_its_certificate():
    for name in ("/dev/zero", "compass-passive-stick", "./b.yaml"):
        certificate = reworded(unproved(TRACKED), ("gait: compass-passive-b", f"gait: {name}"))
        assert "does not name 'compass-passive-b'" in refusals(certificate)["statement"]
        certificate["problem"]["problems"] = {}
        assert "is missing" in refusals(certificate)["statement"]
        elsewhere = unproved(TRACKED)
        elsewhere["problem"]["set"] = {"control.reference.gait": name}
        assert "its changes name another file" in refusals(elsewhere)["statement"]
    surplus = certificate_of(WHEEL)
    surplus["problem"]["files"] = {"x.csv": {"text": "t", "sha256": sha256("t")}}
    assert "does not name 'x.csv'" in refusals(surplus)["statement"]


@pytest.mark.slow
def test_a_curve_takes_as_long_as_the_problem_says():
    duration = ("within: 0.6}", "within: 0.6, duration: 0.7}")
    certificate = reworded(unproved("compass-pd-designed"), duration)
    assert "needs none" in refusals(certificate)["statement"]
    assert restored(certificate | {"law": None}).law.breakpoints[0].overlaps(arb(7) / 10)


@pytest.mark.slow
def test_a_default_duration_is_the_period_of_a_proved_gait():
    """A curve of 0.8 s is another law than one that takes as long as a step of the gait that it starts from."""
    certificate = certificate_of("compass-pd-designed")
    assert {"law data"} <= {claim.name for claim in check(certificate).claims}
    certificate["reference"] = None
    assert refusals(certificate).keys() == {"law data"}
    moved = certificate_of("compass-pd-designed")
    moved["law"]["duration"] += 3e-12  # the orbit stays in its box
    assert "differs by at most" in refusals(moved)["law data"]
    other = reworded(
        certificate_of("compass-pd-designed"), ("friction: 0.14", "friction: 0.13"), within=["compass-passive-b"]
    )
    assert "compass-passive-b is not proved" in refusals(other)["law data"]


@pytest.mark.slow
def test_a_tracked_curve_is_the_motion_of_a_proved_gait_or_the_statement_says_that_this_is_open():
    original = certificate_of(TRACKED)
    statement = check(original).statement
    assert len(statement["not_proved"]) == 1
    assert statement["reference"]["parameters"]["walker.slope"] == "1 deg"
    alone = check(original | {"reference": None})
    assert alone.proved
    assert "tracked curve is the motion of compass-passive-b" in alone.statement["not_proved"][1]
    for old, new in (("friction: 0.14", "friction: 0.141"), ("slope: 1 deg", "slope: 1.001 deg")):
        other = reworded(original, (old, new), within=["compass-passive-b"])
        assert "compass-passive-b is not proved" in refusals(other)["law data"]
    elsewhere = certificate_of(TRACKED)
    elsewhere["problem"]["problems"]["compass-passive-b"]["set"] = {"friction": 0.15}
    assert restored(elsewhere).printed["changed"] == {"compass-passive-b: friction": 0.15}
    for piece in original["law"]["pieces"]:
        piece["angles"][1][0] += 2e-9
    assert refusals(original).keys() & {"law data", "existence and uniqueness"}


@pytest.mark.slow
def test_torques_that_are_found_last_as_long_as_the_step():
    """Without their duration the first interval would never end; with another one they are other torques."""
    text = load_problem("compass-passive-a").text
    text = text.replace("compass-passive-a", "open").replace("friction: 0.14", "friction: 0.3")
    text = text.replace("phases: [slip_forward, stick, slip_backward]", "phases: [stick]")
    text = text.replace("    durations: [0.09, 0.63, 0.03]\n", "")
    text += (
        "control: {type: open_loop, intervals: 2, order: constant, bounds: {ankle: [-3, 3]}}\n"  # none for the hip
        "objective: torque_squared\nconstraints: {speed: 0.5}\n"
    )
    walk = solved(parse_problem(text))
    certificate = through_json(prove(walk, progress=False).certificate)
    assert check(certificate).proved, refusals(certificate)
    words = check(certificate).statement
    assert words["law"]["duration"].startswith(repr(certificate["law"]["duration"]))
    assert words["parameters"]["control.hip.1"] == certificate["designed"]["control.hip.1"]
    assert "no duration" in refusals(certificate | {"law": None})["statement"]
    longer = certificate["law"]["duration"] * 1.5
    assert refusals(certificate | {"law": {"duration": longer}})
    missing = spoiled(certificate)
    del missing["designed"]["control.hip.1"]
    assert "control.hip.1" in refusals(missing)["statement"]


@pytest.mark.slow
def test_a_tracked_curve_that_is_held_ends_with_the_step():
    """A curve that is cut off before is held from there on: another law."""
    problem = load_problem(TRACKED).replace({"control.reference.beyond_end": "hold"})
    certificate = through_json(prove(solve(problem), progress=False).certificate)
    assert check(certificate).proved, refusals(certificate)
    statement = restored(certificate)
    (reference,) = statement.system.control.targets.values()
    motion = reference.motion()
    earlier = replace(motion.pieces[-1], start=motion.pieces[-1].start - 1e-3)
    cut = replace(motion, pieces=(*motion.pieces[:-1], earlier))
    system = SimpleNamespace(control=SimpleNamespace(targets={"reference": reference.with_curve(cut)}))
    with ctx.workprec(PRECISION):
        claim = motion_claim(
            SimpleNamespace(system=system, problem=problem), None, None, arb("0.6358148887151"), arb(1)
        )
    assert not claim.proved
    assert "does not end with a step" in claim.finding


def test_steps_of_a_tracked_gait_cannot_be_made_endless():
    """Tiny last steps of its integration would take for ever beyond its end."""
    field = SimpleNamespace()
    last = SimpleNamespace(h=arb(1e-15), end=[arb(0), arb(0)])
    cycle = SimpleNamespace(steps=[[last]], ends=[[arb(0), arb(0)]])
    orbit = SimpleNamespace(
        arcs=[SimpleNamespace(mode=None)], system=SimpleNamespace(n_z=1), order=2, field=lambda mode, j: field
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gaitopt.proof.law_data.expand", lambda *_: last)
        with pytest.raises(NotProved, match="more than 500 steps"):
            list(_steps(orbit, cycle, arb(1)))


@pytest.mark.parametrize(("heel", "refused"), [("0.2650", False), ("0.26500000000000000000001", True)])
def test_contacts_that_swap_roles_have_the_same_friction_in_all_digits(heel, refused):
    """With different numbers a gait would not repeat after one step; their doubles are the same."""
    each = f"friction: {{heel: 0.265, toe: 0.265, swing_heel: {heel}, swing_toe: 0.265}}"
    text = load_problem("heel-toe-slip").text
    assert "friction: 0.265\n" in text
    problem = parse_problem(text.replace("friction: 0.265", each))
    words = refusals(without_boxes(problem))["statement"]
    assert ("contacts that swap roles have different friction" in words) is refused
    assert ("no boxes" in words) is not refused


def test_decimals_may_be_long():
    """A number with more digits than a double is not rounded."""
    friction = "1.00000000000000000001" + 60 * "0"
    certificate = reworded(certificate_of(WHEEL), ("friction: 1.0", f"friction: {friction}"))
    assert check(certificate).statement["parameters"]["friction"] == friction
    certificate = reworded(certificate_of(WHEEL), ("slope: 13 deg", "slope: 13deg"))
    assert check(certificate).statement["parameters"]["walker.slope"] == "13 deg"


# special points


def test_a_bracket_of_a_change_of_modes_is_proved():
    result = check(bracket())
    assert result.proved, [claim for claim in result.claims if not claim.proved]
    words = {claim.name: claim.finding for claim in result.claims}
    assert "cone_forward is [-" in words["sign change"]
    assert "arc 1, stick: cone_forward" in words  # at the end where it is a gait


@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=() if k == "painleve" else pytest.mark.slow) for k in BRACKETED if k != "mode_change"],
)
def test_another_type_of_special_point_is_refused(kind):
    assert refusals(bracket() | {"special": kind}).keys() >= {
        "sign change" if kind in MARGIN_CHANGES else "arc 1, stick: cone_forward"
    }


@pytest.mark.slow
def test_a_bracket_without_a_change_or_with_a_gap_is_refused():
    assert refusals(bracket("0.95", "0.96")).keys() == {"sign change"}
    assert "sign change" in refusals(bracket("0.90", "0.91"))
    for kept in ([0, 2], [0, 1], [1, 2], [0, 0, 2]):
        boxes = bracket()["boxes"]
        assert refusals(bracket() | {"boxes": [boxes[k] for k in kept]})


def test_a_claim_that_fails_within_a_bracket_stays(monkeypatch):
    """Bounds of the return map that cannot be shown left a bracket without its sign change."""

    def fails(*_):
        raise NotProved("no bounds of the return map")

    certificates = bracket(), bracket("0.95", "0.96")  # whose proof needs the bounds
    monkeypatch.setattr(check_module, "return_map", fails)
    for certificate in certificates:
        assert "motion" in refusals(certificate)


def test_a_motion_that_fails_beyond_the_end_that_is_a_gait_is_named():
    """The claims of the mode sequence are not required there, but this one is."""
    certificate = bracket()
    with ctx.workprec(PRECISION):
        statement = restore_statement(read_certificate(certificate))
        _, inner, gait_end = (check_box(statement, record) for record in statement.record.boxes)
        motion = ProofClaim(MOTION, proved=False, finding="no bounds of the return map")
        broken = replace(inner, inner=None, claims=(inner.claims[0], motion))
        result = conclude(statement, [gait_end, broken], certificate)
    assert [claim.name for claim in result.claims if not claim.proved] == [MOTION]


# every line of the theorem


@pytest.mark.parametrize("name", [WHEEL, "rimless-wheel-slip"])
def test_the_claims_of_a_theorem_are_complete(name):
    result = check(certificate_of(name))
    statement = restored(certificate_of(name))
    modes = mode_claim_names(statement.system, statement.law, statement.cycle, statement.arcs)
    assert {claim.name for claim in result.claims} == {"existence and uniqueness", *modes, "stability"}
    assert any("apparent mass" in claim for claim in modes)


@pytest.mark.parametrize("lost", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 8))])
def test_a_claim_that_is_not_made_leaves_the_theorem_unproved(monkeypatch, lost):
    """Every claim of the mode sequence is required, also where nothing fails."""
    every = check_module.mode_sequence_claims

    def without(*arguments):
        return [claim for k, claim in enumerate(every(*arguments)) if k != lost]

    monkeypatch.setattr(check_module, "mode_sequence_claims", without)
    for certificate in (certificate_of(WHEEL), bracket()):
        assert refusals(certificate).keys() == {"completeness"}


def test_a_slip_does_not_begin_where_static_friction_holds_the_foot():
    """A switch changes the forces: only at the edge of the cone is it known that the force then leaves it."""
    system = HybridSystem(CompassBiped, NoControl())

    def field(mode, j):
        return SimpleNamespace(margins=lambda y: [[arb(1)] * len(system.transitions.margin_names(mode))])

    def begins(event):
        arcs = [SimpleNamespace(mode=Mode.STICK, event=event), SimpleNamespace(mode=Mode.SLIP_FORWARD, phase=1)]
        sequence = Cycle.of_one_step((Mode.STICK, Mode.SLIP_FORWARD), Mode.STICK)
        return _mode_at_rest(SimpleNamespace(system=system, sequence=sequence, arcs=arcs, field=field), 1, [])

    assert "on the side of this slip alone" in begins("cone_forward")[0]
    for event in ("thrust", "cone_backward"):
        with pytest.raises(Refuted, match="onset is -1"):
            begins(event)


@pytest.mark.parametrize(
    ("before", "event", "viscous", "examined"),
    [
        (Mode.STICK, "normal_force", "c", False),
        (Mode.SLIP_FORWARD, "normal_force", None, False),
        (Mode.SLIP_FORWARD, "normal_force", "c", True),  # the drag ends
        (Mode.STICK, "breakpoint", None, True),
        (Mode.FLIGHT, "touchdown", None, True),  # a foot that lands and leaves at once
    ],
)
def test_a_flight_that_its_event_does_not_explain_is_examined(before, event, viscous, examined):
    before, flight = (Hopper.released(mode) for mode in (before, Mode.FLIGHT))
    sequence = Cycle.of_one_step((before, flight) if before.touching else (flight,), Mode.STICK)
    arcs = [
        SimpleNamespace(mode=before, event=event, phase=0),
        SimpleNamespace(mode=flight, phase=1, event="touchdown"),
    ]
    arcs = arcs if before.touching else arcs[:1]
    system = HybridSystem(Hopper, NoControl(), friction=Friction("friction", "friction", viscous))
    assert _starts_at_rest(system, sequence, arcs, len(arcs) - 1) is examined


def window(time, *, segment=0, breakpoints=(0.5, 0.7), horizon=None, event="touchdown", data=(1, 2, 3)):
    """The claim that an arc ends within its segment, of a control law with these breakpoints."""
    edges = tuple(arb(edge) for edge in breakpoints)
    law = ExactLaw(edges, None if horizon is None else arb(horizon), tuple((arb(value),) for value in data))
    arcs = [SimpleNamespace(segment=segment, event=event)]
    return _time_window(SimpleNamespace(law=law, system=SimpleNamespace(n_z=0), arcs=arcs), 0, [arb(time)])


def test_an_arc_ends_before_the_law_of_its_segment():
    words, margin = window("0.4")
    assert "before its segment" in words
    assert float(margin) == pytest.approx(0.1)
    for time, options in (("0.6", {"segment": 1}), ("0.9", {"segment": 2}), ("0.5", {"event": "breakpoint"})):
        window(time, **options)
    # without options, the breakpoint is left out
    for time, options in (("0.6", {}), ("0.71", {"segment": 1}), ("1.1", {"segment": 2, "horizon": 1.0})):
        with pytest.raises(Refuted):
            window(time, **options)
    with pytest.raises(NotProved):
        window("0.5 +/- 1e-20")
    words, _ = window("0.5 +/- 1e-20", data=(1, 1, 3))
    assert "is the same" in words


@pytest.mark.slow
def test_a_breakpoint_that_is_left_out_is_refused():
    """Gait III without torque after its reference's end has period 0.677046; with the torque kept on, 0.669457."""
    problem = load_problem(TRACKED).replace({"control.reference.beyond_end": "off"})
    right = solve(problem)
    law, motion = right.system.control, right.system.control.reference.motion()
    cut = Curve(names=motion.names, pieces=motion.pieces[:-1])
    endless = ProportionalDerivative(kp=law.kp, kd=law.kd, reference=cut)
    system = HybridSystem(type(problem.walker), endless, problem.impact_law, right.system.friction)
    wrong = solve_gait(problem, system)
    assert wrong.converged
    assert len(wrong.arcs) == len(right.arcs) - 1
    forged = forged_certificate(wrong, through_json(motion_record(motion)))
    refused = refusals(forged)
    assert [name for name in refused if name.endswith("time window")] == list(refused)


def forged_certificate(wrong, law):
    """A box around a wrong orbit, with the law of the right one."""
    header = through_json(certificate_header(wrong) | {"law": law, "arcs": arc_records(arcs_of(wrong))})
    statement = restored(header)
    with ctx.workprec(PRECISION):

        def equations(arcs):
            last = ExactLaw(statement.law.breakpoints[:-1], None, statement.law.data[:-1])
            return Orbit(wrong.system, last, statement.p, None, (), statement.cycle, arcs, statement.record.order)

        arcs, centre = divide_into_steps(equations(statement.arcs), wrong)
        centre, _ = newton_step(equations(arcs), centre)
        box = {
            "interval": [],
            "centre": [str(u.str(DIGITS, radius=False, more=True)) for u in centre],
            "tilt": ["0"] * len(centre),
            "radii": [f"{RADIUS:.2e}"] * len(centre),
        }
    return header | {"arcs": through_json(arc_records(arcs)), "boxes": [box]}


@pytest.mark.parametrize(
    ("walker", "mode", "expected"),
    [
        (CompassBiped, "stick", {"touchdown": 1}),
        (RimlessWheel, "stick", {"upright": 1}),
        (KneedWalker, "stick, knee free", {"clearance": 1, "knee": 2}),
        (Hopper, "stick, leg free, thrust off", {"leg": 1}),
    ],
)
def test_only_margins_of_closed_contacts_and_stops_vanish_after_an_impact(walker, mode, expected):
    """They are identically zero, and so are the rates of stops that the impact holds; no other margin is."""
    system = HybridSystem(walker, NoControl())
    orders = {
        name: zeros_after_impact(system, Mode(mode), name) for name in system.transitions.margin_names(Mode(mode))
    }
    assert {name: order for name, order in orders.items() if order} == expected


def test_the_page_names_the_functions_and_tests_of_every_line_of_the_theorem():
    tests = [
        name
        for file in Path(__file__).parent.glob("test_*.py")
        for name in re.findall(r"def (test_\w+)", file.read_text())
    ]
    table = [row.split("|")[1:4] for row in PAGE.read_text().splitlines() if re.match(r"\|.*test_", row)]
    assert len(table) > 20
    for line, checker, forgeries in table:
        for name in re.findall(r"`([\w.]+)`", checker):
            module, *attributes = name.split(".")
            assert reduce(getattr, attributes, import_module(f"gaitopt.proof.{module}")), (line, name)
        for name in re.findall(r"`(test_\w+)(?:\.\.\.)?`", forgeries):
            assert [test for test in tests if test.startswith(name)], (line, name)


# by machine


def places(data, path=()):
    """The path of every field of a certificate, but for the inner ones of long lists of numbers."""
    if path:
        yield path
    if isinstance(data, dict):
        for key, value in data.items():
            yield from places(value, (*path, key))
    elif isinstance(data, list):
        for k in sorted({0, len(data) // 2, len(data) - 1} if len(data) > 3 else range(len(data))):
            yield from places(data[k], (*path, k))


def replacements(value):
    """What a forger might write in place of a value."""
    if isinstance(value, bool):
        return [not value, None]
    if isinstance(value, int):
        return [value + 1, value - 1, float(value) + 0.5, str(value)]
    if isinstance(value, float):
        return [value * 1.01 + 1e-3, -value, str(value)]
    if isinstance(value, str):
        try:
            number, _, unit = value.partition(" ")
            return [f"{float(number) * 1.01 + 1e-3!r} {unit}".strip(), f"-{value}", "0", f"{value}..{value}", 1]
        except ValueError:
            return [f"{value}x", "", "none", "slip_backward", 1]
    if isinstance(value, list):
        return [[], value[::-1], value[1:], value * 2, {}, None]
    if isinstance(value, dict):
        return [{}, [], None]
    return ["none", 1, {}]


HOSTILE = (1e308, 10**300, "1e999", "nan", "9" * 5000, [[[[]]]], {"": {}}, True, "\x1b[2J", -1, 10**4)


def forgeries(certificate, other, values=replacements):
    """Certificates in which one field is replaced, removed, or exchanged with that of another gait."""
    for path in places(certificate):
        *outer, last = path
        for action in ("remove", "exchange", *values(at(certificate, path))):
            forged = deepcopy(certificate)
            holder = at(forged, outer)
            if isinstance(action, str) and action == "remove":
                del holder[last]
            elif isinstance(action, str) and action == "exchange":
                try:
                    holder[last] = deepcopy(at(other, path))
                except (KeyError, IndexError, TypeError):
                    continue
            else:
                holder[last] = action
            if forged != certificate:
                yield path, action, forged


def at(data, path):
    for key in path:
        data = data[key]
    return data


PRINTED = {
    "problem": {"sha256", "texts", "changed", "reference"},
    "intervals": {"parameters"},
    "designed": {"parameters"},
    "law": {"law"},
    "reference": {"not_proved", "reference"},
}
"""Entries of the printed statement that may differ with a field of the certificate."""
SILENT = ("name", "about", "guess", "objective", "constraints", "free", "within", "bounds", "version")
"""Keys of a problem's text that the theorem does not depend on."""


def lie(original, forged, path):
    """What a forged certificate proves that the original does not; None if it proves nothing else."""
    try:
        result = check(forged)
    except StorageError:
        return None
    if not result.proved:
        return None
    before, after = original.to_record(), result.to_record()
    one, other = before["statement"], after["statement"]
    changed = {key for key in {*one, *other} if one.get(key) != other.get(key)}
    if changed - PRINTED.get(path[0], set()):
        return f"the statement differs in {changed}"
    for key in ("problem", "proved", "stable", "parameter", "special"):
        if before.get(key) != after.get(key):
            return f"{key} is {after.get(key)}"
    if [claim["claim"] for claim in before["claims"]] != [claim["claim"] for claim in after["claims"]]:
        return None if {"not_proved"} <= changed <= {"not_proved", "reference"} else "the claims differ"
    if changed & {"law", "parameters"}:
        return None  # another theorem, and its statement says which curve or value it is about
    bounds = [(original.state[key], result.state[key]) for key in original.state]
    bounds += [(original.measures[key], result.measures[key]) for key in ("period", "step_length", "speed", "work")]
    return None if all(a.overlaps(b) for a, b in bounds) else "it is another orbit"


def lies(certificate, other, values=replacements, every=1):
    """What is proved that is wrong, of every n-th forgery."""
    original = check(certificate)
    assert original.proved
    return [
        (path, action, wrong)
        for path, action, forged in islice(forgeries(certificate, other, values), 0, None, every)
        if (wrong := lie(original, forged, path)) is not None
    ]


@pytest.mark.parametrize("every", [8, pytest.param(1, marks=pytest.mark.slow)])
def test_no_field_can_be_forged(every):
    assert lies(certificate_of(WHEEL), certificate_of("rimless-wheel-slip"), every=every) == []


@pytest.mark.slow
def test_no_field_of_a_bracket_can_be_forged():
    assert lies(bracket(), bracket("0.95", "0.96")) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("rimless-wheel-slip", WHEEL),
        *((name, "compass-passive-b") for name in ("compass-torque-stick", TRACKED, "compass-pd-designed")),
    ],
)
def test_no_field_of_other_certificates_can_be_forged(name, other):
    assert lies(certificate_of(name), certificate_of(other)) == []


# what the texts say


def meanings(certificate, within=()):
    """Certificates whose texts say something else and are otherwise consistent: each value is replaced in turn."""
    problem = reduce(lambda outer, name: outer["problems"][name], within, certificate["problem"])
    data = parse_source(problem["text"], "problem").data
    for path in places(data):
        for value in [*replacements(at(data, path)), "another"]:
            other = deepcopy(data)
            at(other, path[:-1])[path[-1]] = value
            forged = deepcopy(certificate)
            place = reduce(lambda outer, name: outer["problems"][name], within, forged["problem"])
            place["text"] = json.dumps(other)
            place["sha256"] = sha256(place["text"])
            yield path, value, forged
            if all(isinstance(key, str) for key in path) and not within:
                changed = deepcopy(certificate)
                changed["problem"]["set"] = {".".join(path): value}
                yield path, ("set", value), changed


def hidden(original, forged, path):
    """Whether a certificate whose text differs is proved with a statement that does not say so."""
    hashes, silent = {"sha256", "texts"}, any(key in SILENT for key in path)
    try:
        words = restored(forged).printed
    except (StorageError, ValueError, NotProved):
        return False
    if silent or any(original.statement[key] != words[key] for key in words.keys() - hashes):
        return False  # another theorem, which says what it is about
    return check(forged).proved and not is_written_differently(original, forged)


def is_written_differently(original, forged):
    """Whether the changed text is read as the same problem."""
    problems = [restored(each).problem for each in (original.certificate, forged)]
    return problems[0].digest == problems[1].digest


@pytest.mark.parametrize("every", [10, pytest.param(1, marks=pytest.mark.slow)])
def test_no_meaning_of_a_text_changes_unseen(every):
    certificate, original = certificate_of(WHEEL), check(certificate_of(WHEEL))
    tried = list(islice(meanings(certificate), 0, None, every))
    assert len(tried) > 10
    assert [(path, value) for path, value, forged in tried if hidden(original, forged, path)] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["compass-torque-efficient", TRACKED, "compass-pd-designed"])
def test_no_meaning_of_a_law_changes_unseen(name):
    certificate, original = certificate_of(name), check(certificate_of(name))
    tried = list(meanings(certificate))
    if certificate["problem"]["problems"]:
        tried += meanings(certificate, ["compass-passive-b"])
    assert [(path, value) for path, value, forged in tried if hidden(original, forged, path)] == []


@pytest.mark.slow
def test_no_hostile_value_hangs_or_crashes_the_checker():
    assert lies(certificate_of(WHEEL), {}, lambda value: HOSTILE) == []


@pytest.mark.parametrize(
    "content",
    [
        b"[" * 10**6,
        b'{"a":' * 10**5,
        b'{"schema": ' + b"9" * 10**6 + b"}",
        b'{"order": NaN}',
        b'{"order": Infinity}',
        b"\xff\xfe",
        b"",
        b"null",
    ],
)
def test_what_is_no_json_object_is_refused(content):
    with pytest.raises(StorageError):
        check(parse_certificate(content))
