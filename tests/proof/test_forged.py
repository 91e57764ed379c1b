"""Forged certificates: by hand, one per line of the theorem, and by machine, field by field. None may prove a lie.

A certificate that passes has to be about what its printed statement says: the same orbit, under the same statement as
the original, but for entries that are printed and that the forgery has changed itself.
"""

import json
import re
from copy import deepcopy
from dataclasses import replace
from functools import cache, reduce
from importlib import import_module
from itertools import islice
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from certificates import certificate_of, gait, refusals, restored, reworded, through_json
from flint import arb, ctx

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
from gaitopt.problem.writing import write_problem
from gaitopt.proof.arithmetic import PRECISION, NotProved, Refuted
from gaitopt.proof.certificate import SCHEMA, ProblemRecord, parse_certificate, read_certificate, sha256
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
PAGE = Path(__file__).parents[2] / "docs" / "developer" / "proof-tests.md"


@cache
def proved(name):
    """The certificate of a gait, as it is read from its file."""
    return certificate_of(name)


@cache
def unproved(name):
    """A certificate without boxes, whose statement is right: enough for forgeries that no box is needed to refuse."""
    solved = gait(name)
    return through_json(certificate_header(solved) | {"arcs": arc_records(arcs_of(solved))})


@cache
def bracket(lower="0.9141", upper="0.9142"):
    """The sticking wheel loses its grip in between, at 0.91412078; friction does not enter its motion."""
    certificate = spoiled(proved("rimless-wheel-stick"))
    (box,) = certificate["boxes"]
    certificate |= {"varied": "friction", "special": "mode_change"}
    certificate["intervals"] = {"friction": f"{lower}..{upper}"}
    certificate["boxes"] = [box | {"interval": ends} for ends in ([lower, lower], [lower, upper], [upper, upper])]
    return certificate


def spoiled(certificate, **changes):
    return deepcopy(dict(certificate)) | changes


# the control law


@pytest.mark.slow
def test_a_right_statement_is_rebuilt_from_its_problem():
    for name in ("compass-torque-stick", "compass-pd-impact-slip", "compass-pd-designed"):
        assert restored(unproved(name)).printed["mode_sequence"] == str(load_problem(name).cycle)
        assert "no boxes" in refusals(unproved(name))["statement"]


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
    certificate = spoiled(unproved("compass-pd-impact-slip"))
    certificate["law"]["pieces"][0]["rates"] = certificate["law"]["pieces"][0]["angles"]
    with pytest.raises(StorageError, match="rates: Extra inputs"):
        check(certificate)
    statement = restored(unproved("compass-pd-impact-slip"))
    control = statement.system.control
    for k, data in enumerate(statement.law.data):
        np.testing.assert_allclose([float(value) for value in data], control.data(k), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("beyond_end", ["hold", "linear", "off"])
def test_a_reference_ends_as_the_problem_says(beyond_end):
    """Beyond the stated pieces the checker continues it; only a motion that flows on is stated there."""
    original = unproved("compass-pd-impact-slip")
    certificate = reworded(original, ("beyond_end: flow", f"beyond_end: {beyond_end}"))
    tracked = gait("compass-pd-impact-slip").system.control.reference.motion()
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
    original = unproved("compass-pd-impact-slip")
    words = restored(original).printed
    assert any("compass-passive-b" in silent for silent in words["not_proved"])
    certificate = spoiled(original)
    for piece in certificate["law"]["pieces"]:
        piece["angles"][0][0] += 1e-9
    assert restored(certificate).printed["law"]["curve_sha256"] != words["law"]["curve_sha256"]
    certificate = reworded(original, ("friction: 0.14", "friction: 0.15"), within=["compass-passive-b"])
    assert restored(certificate).printed["texts"] != words["texts"]


@pytest.mark.parametrize("piece", [0, 1])
def test_a_tracked_curve_does_not_jump(piece):
    certificate = spoiled(unproved("compass-pd-impact-slip"))
    certificate["law"]["pieces"][piece]["angles"][1][0] += 1e-8
    assert "the reference of theta2 jumps where its piece 2 starts, at 0.0863441" in refusals(certificate)["statement"]
    certificate = spoiled(unproved("compass-pd-impact-slip"))
    row = certificate["law"]["pieces"][piece]["angles"][1]
    row[2], row[0] = row[2] + 1e-8, row[0] - 1e-8  # the same angle at both ends, another rate
    assert "jumps" in refusals(certificate)["statement"]


@pytest.mark.slow
def test_designed_values_are_part_of_the_printed_statement():
    original = unproved("compass-pd-designed")
    words = restored(original).printed
    assert "control.reference.theta1.0" in words["designed"]
    certificate = spoiled(original)
    certificate["designed"]["control.reference.theta1.1"] = "-0.3"
    changed = restored(certificate).printed
    assert changed["parameters"]["control.reference.theta1.1"] == "-0.3"
    certificate["law"]["duration"] *= 1.1
    assert restored(certificate).printed["law"]["duration"] != changed["law"]["duration"]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        pytest.param("control.reference.theta1.1", "0.60000000000000000002", marks=pytest.mark.slow),
        ("control.ankle", "5.1"),
    ],
)
def test_a_designed_value_outside_of_its_bounds_is_refused(key, value):
    certificate = spoiled(unproved("compass-pd-designed" if "theta" in key else "compass-torque-efficient"))
    assert "no boxes" in refusals(certificate)["statement"]
    certificate["designed"][key] = value
    assert "outside of its bounds" in refusals(certificate)["statement"]
    del certificate["designed"][key]
    assert key in refusals(certificate)["statement"]


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (None, "which it does not contain"),
        ({"duration": 0.7}, "which it does not contain"),
        ({"pieces": []}, ""),
        ("reversed", "do not follow each other"),
        ("one joint", "motion of 2 joints"),
    ],
)
def test_a_reference_that_does_not_fit_is_refused(law, words):
    certificate = spoiled(unproved("compass-pd-impact-slip"))
    if law == "reversed":
        certificate["law"]["pieces"].reverse()
    elif law == "one joint":
        certificate["law"]["pieces"][0]["angles"].pop()
    else:
        certificate["law"] = law
    if not words:
        with pytest.raises(StorageError, match="pieces"):
            check(certificate)
    else:
        assert words in refusals(certificate)["statement"]


def test_law_data_that_no_law_needs_are_refused():
    certificate = spoiled(proved("rimless-wheel-stick"))
    assert "needs none" in refusals(certificate | {"law": {"duration": 0.7}})["statement"]
    reference = {name: certificate[name] for name in ("designed", "law", "reference", "order", "arcs", "boxes")}
    words = refusals(certificate | {"reference": reference})["statement"]
    assert "from which its law takes nothing" in words


def test_a_problem_names_nothing_but_the_texts_of_its_certificate():
    original = unproved("compass-pd-impact-slip")
    for name in ("/dev/zero", "compass-passive-stick", "./b.yaml"):
        certificate = reworded(original, ("gait: compass-passive-b", f"gait: {name}"))
        assert "does not name 'compass-passive-b'" in refusals(certificate)["statement"]
        certificate["problem"]["problems"] = {}
        assert "is missing" in refusals(certificate)["statement"]
        changed = spoiled(original)
        changed["problem"]["set"] = {"control.reference.gait": name}
        assert "its changes name another file" in refusals(changed)["statement"]
    surplus = spoiled(proved("rimless-wheel-stick"))
    surplus["problem"]["files"] = {"x.csv": {"text": "t", "sha256": sha256("t")}}
    assert "does not name 'x.csv'" in refusals(surplus)["statement"]


def test_a_text_has_its_digest():
    certificate = spoiled(proved("rimless-wheel-stick"))
    certificate["problem"]["text"] += "\n"
    assert "SHA-256" in refusals(certificate)["statement"]


@pytest.mark.slow
def test_a_curve_takes_as_long_as_the_problem_says():
    duration = ("within: 0.6}", "within: 0.6, duration: 0.7}")
    certificate = reworded(unproved("compass-pd-designed"), duration)
    assert "needs none" in refusals(certificate)["statement"]
    certificate["law"] = None
    statement = restored(certificate)
    assert statement.law.breakpoints[0].overlaps(arb(7) / 10)


@pytest.mark.slow
def test_a_default_duration_is_the_period_of_a_proved_gait():
    """A curve of 0.8 s is another law than one that takes as long as a step of the gait that it starts from."""
    certificate = spoiled(proved("compass-pd-designed"))
    assert {"law data"} <= {claim.name for claim in check(certificate).claims}
    certificate["reference"] = None
    assert refusals(certificate).keys() == {"law data"}
    moved = spoiled(proved("compass-pd-designed"))
    moved["law"]["duration"] += 3e-12  # the orbit stays in its box
    assert "differs by at most" in refusals(moved)["law data"]
    other = reworded(proved("compass-pd-designed"), ("friction: 0.14", "friction: 0.13"), within=["compass-passive-b"])
    assert "compass-passive-b is not proved" in refusals(other)["law data"]


@pytest.mark.slow
def test_a_tracked_curve_is_the_motion_of_a_proved_gait_or_the_statement_says_that_this_is_open():
    original = proved("compass-pd-impact-slip")
    assert len(check(original).statement["not_proved"]) == 1
    alone = check(spoiled(original) | {"reference": None})
    assert alone.proved
    assert "tracked curve is the motion of compass-passive-b" in alone.statement["not_proved"][1]
    for old, new in (("friction: 0.14", "friction: 0.141"), ("slope: 1 deg", "slope: 1.001 deg")):
        other = reworded(original, (old, new), within=["compass-passive-b"])
        assert "compass-passive-b is not proved" in refusals(other)["law data"]
    assert check(original).statement["reference"]["parameters"]["walker.slope"] == "1 deg"
    changed = spoiled(original)
    changed["problem"]["problems"]["compass-passive-b"]["set"] = {"friction": 0.15}
    assert restored(changed).printed["changed"] == {"compass-passive-b: friction": 0.15}
    moved = spoiled(original)
    for piece in moved["law"]["pieces"]:
        piece["angles"][1][0] += 2e-9
    assert "law data" in refusals(moved) or "existence and uniqueness" in refusals(moved)


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
    solved = solve(parse_problem(text), progress=False)
    assert solved.converged, solved.message
    certificate = through_json(prove(solved, progress=False).certificate)
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


def test_a_number_of_spokes_is_whole():
    certificate = reworded(proved("rimless-wheel-stick"), ("spokes: 10\n", "spokes: 10.000000000000001\n"))
    assert "spokes" in refusals(certificate)["statement"]


def test_an_arc_does_not_end_at_a_breakpoint_that_is_not_there():
    certificate = spoiled(unproved("compass-pd-impact-slip"))
    breakpoints = len(certificate["law"]["pieces"]) - 1
    certificate["arcs"] += [certificate["arcs"][-1]] * (breakpoints + 1)
    assert f"ends with a breakpoint, but the control has {breakpoints}" in refusals(certificate)["statement"]


def test_a_single_orbit_has_no_tilt():
    certificate = spoiled(proved("rimless-wheel-stick"))
    certificate["boxes"][0]["tilt"][-5] = "1"
    assert "is tilted" in refusals(certificate)["statement"]


@pytest.mark.slow
def test_a_tracked_curve_that_is_held_ends_with_the_step():
    """A curve that is cut off before is held from there on: another law."""
    problem = load_problem("compass-pd-impact-slip").replace({"control.reference.beyond_end": "hold"})
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
    assert "does not end with a step" in claim.words


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


def test_kinetic_friction_is_not_above_static_friction():
    certificate = spoiled(proved("rimless-wheel-stick"))
    certificate["problem"]["set"] = {"friction": {"static": 1.0, "kinetic": 0.95}}
    certificate["intervals"] = {"friction.static": "0.97..1.0", "friction.kinetic": "0.95..1.0"}
    words = refusals(certificate)["statement"]
    assert "contradict each other: friction.static, friction.kinetic" in words
    assert "static" in words.partition("friction: ")[2]


@pytest.mark.parametrize(("heel", "refused"), [("0.2650", False), ("0.26500000000000000000001", True)])
def test_contacts_that_swap_roles_have_the_same_friction_in_all_digits(heel, refused):
    """With different numbers a gait would not repeat after one step; their doubles are the same."""
    each = f"friction: {{heel: 0.265, toe: 0.265, swing_heel: {heel}, swing_toe: 0.265}}"
    text = load_problem("heel-toe-slip").text
    assert "friction: 0.265\n" in text
    problem = parse_problem(text.replace("friction: 0.265", each))
    certificate = {"schema": SCHEMA, "problem": ProblemRecord.of(write_problem(problem)).model_dump(), "intervals": {}}
    certificate |= {"designed": {}, "law": None, "reference": None, "varied": None, "special": None, "order": 20}
    certificate |= {"arcs": [{"phase": k, "fractions": []} for k in range(len(problem.cycle.phases))], "boxes": []}
    words = refusals(certificate)["statement"]
    assert ("contacts that swap roles have different friction" in words) is refused
    assert ("no boxes" in words) is not refused


def test_decimals_may_be_long():
    """A number with more digits than a double is not rounded."""
    friction = "1.00000000000000000001" + 60 * "0"
    certificate = reworded(proved("rimless-wheel-stick"), ("friction: 1.0", f"friction: {friction}"))
    assert check(certificate).statement["parameters"]["friction"] == friction
    certificate = reworded(proved("rimless-wheel-stick"), ("slope: 13 deg", "slope: 13deg"))
    assert check(certificate).statement["parameters"]["walker.slope"] == "13 deg"


# special points


def test_a_bracket_of_a_change_of_modes_is_proved():
    result = check(bracket())
    assert result.proved, [claim for claim in result.claims if not claim.proved]
    words = {claim.name: claim.words for claim in result.claims}
    assert "cone_forward is [-" in words["sign change"]
    assert "arc 1, stick: cone_forward" in words  # at the end where it is a gait


@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=() if k == "painleve" else pytest.mark.slow) for k in BRACKETED if k != "mode_change"],
)
def test_another_type_of_special_point_is_refused(kind):
    assert refusals(spoiled(bracket(), special=kind)).keys() >= {
        "sign change" if kind in MARGIN_CHANGES else "arc 1, stick: cone_forward"
    }


@pytest.mark.slow
def test_a_bracket_without_a_change_is_refused():
    assert refusals(bracket("0.95", "0.96")).keys() == {"sign change"}
    assert "sign change" in refusals(bracket("0.90", "0.91"))


def test_a_claim_that_fails_within_a_bracket_stays(monkeypatch):
    """Bounds of the return map that cannot be shown left a bracket without its sign change."""

    def fails(*_):
        raise NotProved("no bounds of the return map")

    certificates = bracket(), bracket("0.95", "0.96")  # whose proof needs the bounds
    monkeypatch.setattr(check_module, "return_map", fails)
    for certificate in certificates:
        assert refusals(certificate).keys() >= {"motion"}


def test_a_motion_that_fails_beyond_the_end_that_is_a_gait_is_named():
    """The claims of the mode sequence are not required there, but this one is."""
    certificate = bracket()
    with ctx.workprec(PRECISION):
        statement = restore_statement(read_certificate(certificate))
        _, inner, gait_end = (check_box(statement, record) for record in statement.record.boxes)
        motion = ProofClaim(MOTION, proved=False, words="no bounds of the return map")
        broken = replace(inner, inner=None, claims=(inner.claims[0], motion))
        result = conclude(statement, [gait_end, broken], certificate)
    assert [claim.name for claim in result.claims if not claim.proved] == [MOTION]


@pytest.mark.slow
def test_a_bracket_that_leaves_a_gap_is_refused():
    for gap in ([0, 2], [0, 1], [1, 2], [0, 0, 2]):
        certificate = bracket()
        boxes = [certificate["boxes"][k] for k in gap]
        assert refusals(spoiled(certificate, boxes=boxes))


def test_a_special_point_needs_a_parameter():
    certificate = spoiled(proved("rimless-wheel-stick"), special="mode_change")
    assert "no parameter that varies" in refusals(certificate)["statement"]
    assert "frictoin varies, but it has no interval" in refusals(spoiled(bracket(), varied="frictoin"))["statement"]
    unknown = spoiled(bracket(), intervals={"frictoin": "0.9141..0.9142"})
    assert "no parameter is called 'frictoin'" in refusals(unknown)["statement"]


@pytest.mark.parametrize("interval", ["-0.1..0.9142", "0.9142..0.9141", "0.9142..0.9142"])
def test_an_interval_holds_values_that_the_parameter_can_have(interval):
    certificate = spoiled(bracket(), intervals={"friction": interval})
    assert "friction cannot be" in refusals(certificate)["statement"]


# every line of the theorem


@pytest.mark.parametrize("name", ["rimless-wheel-stick", "rimless-wheel-slip"])
def test_the_claims_of_a_theorem_are_complete(name):
    result = check(proved(name))
    statement = restored(proved(name))
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
    for certificate in (proved("rimless-wheel-stick"), bracket()):
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
    problem = load_problem("compass-pd-impact-slip").replace({"control.reference.beyond_end": "off"})
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


def lies(certificate, other, values=replacements, fields=(), every=1):
    """What is proved that is wrong, of every n-th forgery in some fields, or in all."""
    original = check(certificate)
    assert original.proved
    return [
        (path, action, wrong)
        for path, action, forged in islice(forgeries(certificate, other, values), 0, None, every)
        if (not fields or path[0] in fields or path[-1] in fields)
        and (wrong := lie(original, forged, path)) is not None
    ]


@pytest.mark.parametrize("every", [8, pytest.param(1, marks=pytest.mark.slow)])
def test_no_field_can_be_forged(every):
    assert lies(proved("rimless-wheel-stick"), proved("rimless-wheel-slip"), every=every) == []


@pytest.mark.slow
def test_no_field_of_a_bracket_can_be_forged():
    fields = ("varied", "special", "intervals", "interval", "order")
    assert lies(bracket(), spoiled(bracket("0.95", "0.96")), fields=fields) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rimless-wheel-slip", "bracket"])
def test_no_field_of_other_certificates_can_be_forged(name):
    assert lies(bracket() if name == "bracket" else proved(name), proved("rimless-wheel-stick")) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["compass-torque-stick", "compass-pd-impact-slip", "compass-pd-designed"])
def test_no_field_of_a_compass_can_be_forged(name):
    other = proved("compass-passive-b")
    assert lies(proved(name), other) == []


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
    certificate, original = proved("rimless-wheel-stick"), check(proved("rimless-wheel-stick"))
    tried = list(islice(meanings(certificate), 0, None, every))
    assert len(tried) > 10
    assert [(path, value) for path, value, forged in tried if hidden(original, forged, path)] == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["compass-torque-efficient", "compass-pd-impact-slip", "compass-pd-designed"])
def test_no_meaning_of_a_law_changes_unseen(name):
    certificate, original = proved(name), check(proved(name))
    tried = list(meanings(certificate))
    if certificate["problem"]["problems"]:
        tried += meanings(certificate, ["compass-passive-b"])
    assert [(path, value) for path, value, forged in tried if hidden(original, forged, path)] == []


@pytest.mark.slow
def test_no_hostile_value_hangs_or_crashes_the_checker():
    certificate = spoiled(proved("rimless-wheel-stick"))
    assert lies(certificate, {}, lambda value: HOSTILE) == []


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
