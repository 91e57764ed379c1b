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

flint = pytest.importorskip("flint")
from flint import arb, ctx  # noqa: E402

from gaitopt import load_problem, prove, solve  # noqa: E402
from gaitopt.errors import StorageError  # noqa: E402
from gaitopt.model.control import NoControl  # noqa: E402
from gaitopt.model.modes import Mode  # noqa: E402
from gaitopt.model.reference import BeyondEnd, Reference, continued  # noqa: E402
from gaitopt.model.system import HybridSystem  # noqa: E402
from gaitopt.model.tracking import ProportionalDerivative  # noqa: E402
from gaitopt.model.walkers.compass_biped import CompassBiped  # noqa: E402
from gaitopt.model.walkers.rimless_wheel import RimlessWheel  # noqa: E402
from gaitopt.proof.arithmetic import PRECISION, NotProved, Refuted  # noqa: E402
from gaitopt.proof.certificate import parse_certificate, read_certificate, restore_statement  # noqa: E402
from gaitopt.proof.check import BRACKETED, MARGIN_CHANGES, MOTION, check, check_box, conclude  # noqa: E402
from gaitopt.proof.claims import ProofClaim, _time_window, _vanishes_after_impact, mode_claim_names  # noqa: E402
from gaitopt.proof.orbit import Orbit  # noqa: E402
from gaitopt.proof.prove import (  # noqa: E402
    DIGITS,
    RADIUS,
    arc_records,
    arcs_of,
    certificate_header,
    divide_into_steps,
    exact_texts,
    newton_step,
    reference_record,
)
from gaitopt.solver.solve import solve_gait  # noqa: E402

check_module = import_module("gaitopt.proof.check")
PAGE = Path(__file__).parents[2] / "docs" / "proof.md"


@cache
def gait(name, **changes):
    return solve(load_problem(name).replace(changes))


@cache
def proved(name):
    """The certificate of a gait, as it is read from its file."""
    return through_json(prove(gait(name)).certificate)


@cache
def unproved(name):
    """A certificate without boxes, whose statement is right: enough for forgeries that no box is needed to refuse."""
    solved = gait(name)
    return through_json(header_of(solved) | {"arcs": arc_records(arcs_of(solved))})


def header_of(solved):
    return certificate_header(solved, exact_texts(solved.problem, solved.dynamics.parameters))


@cache
def bracket(lower="0.9141", upper="0.9142"):
    """The sticking wheel loses its grip in between, at 0.91412078; friction does not enter its motion."""
    certificate = spoiled(proved("rimless-wheel-stick"))
    (box,) = certificate["boxes"]
    certificate |= {"varied": "friction", "special": "mode_change"}
    certificate["parameters"]["friction"] = f"{lower}..{upper}"
    certificate["resolved"]["friction"] = (float(lower) + float(upper)) / 2
    certificate["boxes"] = [box | {"interval": ends} for ends in ([lower, lower], [lower, upper], [upper, upper])]
    return certificate


def through_json(certificate):
    return json.loads(json.dumps(certificate))


def spoiled(certificate, **changes):
    return deepcopy(dict(certificate)) | changes


def refusals(certificate):
    """What is not proved of a certificate, by the name of the claim."""
    result = check(certificate)
    assert not result.proved
    return {claim.name: claim.words for claim in result.claims if not claim.proved}


def words_of_statement(certificate):
    with ctx.workprec(PRECISION):
        return restore_statement(read_certificate(certificate)).printed


# the control law


@pytest.mark.slow
def test_a_right_statement_is_rebuilt_from_its_problem():
    for name in ("compass-torque-stick", "compass-pd-impact-slip", "compass-pd-designed"):
        assert words_of_statement(unproved(name))["mode_sequence"] == str(load_problem(name).cycle)
        assert "no boxes" in refusals(unproved(name))["statement"]


def test_a_law_is_that_of_its_problem_not_of_its_certificate():
    certificate = spoiled(unproved("compass-torque-stick"))
    with pytest.raises(StorageError, match=r"control: Extra inputs"):
        check(certificate | {"control": {"type": "none"}})
    certificate["resolved"]["control"] = {"type": "none"}
    assert "parameters are not those of its problem: control.ankle" in refusals(certificate)["statement"]
    certificate["parameters"] = {k: v for k, v in certificate["parameters"].items() if not k.startswith("control")}
    words = words_of_statement(certificate)  # a right statement, but about another problem
    assert words["control"] == "none"
    assert words["sha256"] != words_of_statement(unproved("compass-torque-stick"))["sha256"]


@pytest.mark.parametrize("beyond_end", ["hold", "linear", "off"])
def test_a_reference_ends_as_the_problem_says(beyond_end):
    certificate = spoiled(unproved("compass-pd-impact-slip"))
    certificate["resolved"]["control"]["reference"]["beyond_end"] = beyond_end
    assert f"beyond_end: {beyond_end}" in refusals(certificate)["statement"]
    pieces = gait("compass-pd-impact-slip").system.control.reference.pieces
    last_of_gait = 2  # slip and stick; what follows is the motion that flows on
    for other in ("hold", "linear", "off"):
        motion = continued(pieces[:last_of_gait], pieces[last_of_gait].start, BeyondEnd(other))
        certificate["reference"] = record_of(motion)
        if other == beyond_end:
            assert beyond_end in words_of_statement(certificate)["control"]
        else:
            assert f"beyond_end: {beyond_end}" in refusals(certificate)["statement"]


def record_of(motion):
    return through_json(reference_record(ProportionalDerivative(kp=1.0, kd=1.0, reference=motion)))


def test_a_tracked_curve_is_part_of_the_printed_statement():
    """Nothing shows that it is the motion of the gait that the problem names: the statement says so."""
    original = unproved("compass-pd-impact-slip")
    words = words_of_statement(original)
    assert any("compass-passive-b" in silent for silent in words["not_proved"])
    certificate = spoiled(original)
    certificate["reference"]["pieces"][0]["angles"][0][0] += 1e-9
    assert words_of_statement(certificate)["curve_sha256"] != words["curve_sha256"]
    certificate = spoiled(original)
    certificate["resolved"]["control"]["reference"]["gait"]["friction"] = 0.15
    assert words_of_statement(certificate)["sha256"] != words["sha256"]


@pytest.mark.slow
def test_designed_values_are_part_of_the_printed_statement():
    original = unproved("compass-pd-designed")
    words = words_of_statement(original)
    assert "control.reference.theta1.0" in words["designed"]
    certificate = spoiled(original)
    certificate["parameters"]["control.reference.theta1.1"] = "-0.3"
    changed = words_of_statement(certificate)
    assert changed["parameters"]["control.reference.theta1.1"] == "-0.3"
    assert changed["curve_sha256"] != words["curve_sha256"]
    certificate["reference"]["duration"] *= 1.1
    assert words_of_statement(certificate)["curve_sha256"] != changed["curve_sha256"]


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        (None, "which it does not contain"),
        ({"duration": 0.7}, "which it does not contain"),
        ({"pieces": [], "horizon": None}, ""),
        ("reversed", "do not follow each other"),
        ("one joint", "motion of 2 joints"),
        ("no horizon", "beyond_end: flow"),
    ],
)
def test_a_reference_that_does_not_fit_is_refused(reference, words):
    certificate = spoiled(unproved("compass-pd-impact-slip"))
    if reference == "reversed":
        certificate["reference"]["pieces"].reverse()
    elif reference == "one joint":
        certificate["reference"]["pieces"][0]["angles"].pop()
    elif reference == "no horizon":
        certificate["reference"]["horizon"] = None
    else:
        certificate["reference"] = reference
    if not words:
        with pytest.raises(StorageError, match="pieces"):
            check(certificate)
    else:
        assert words in refusals(certificate)["statement"]


def test_a_problem_that_names_a_file_is_refused():
    certificate = spoiled(unproved("compass-pd-impact-slip"))
    certificate["resolved"]["control"]["reference"]["gait"] = "/dev/zero"
    assert "refers to another problem" in refusals(certificate)["statement"]


def test_a_curve_takes_as_long_as_the_problem_says():
    certificate = spoiled(unproved("compass-pd-designed"))
    certificate["resolved"]["control"]["reference"]["curve"]["duration"] = 0.7
    assert "that of its problem 0.7 s" in refusals(certificate)["statement"]


def test_an_arc_does_not_end_at_a_breakpoint_that_is_not_there():
    certificate = spoiled(unproved("compass-pd-designed"))
    certificate["arcs"][-1]["event"] = "breakpoint"
    certificate["arcs"].append(certificate["arcs"][-1] | {"segment": 2, "event": "touchdown"})
    assert "ends with a breakpoint, but the control has 1" in refusals(certificate)["statement"]


def test_a_single_orbit_has_no_tilt():
    certificate = spoiled(proved("rimless-wheel-stick"))
    certificate["boxes"][0]["tilt"][-5] = "1"
    assert "is tilted" in refusals(certificate)["statement"]


def test_the_name_is_that_of_the_problem():
    assert "is about 'other'" in refusals(spoiled(proved("rimless-wheel-stick"), problem="other"))["statement"]


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

    monkeypatch.setattr(check_module, "return_map", fails)
    for certificate in (bracket(), bracket("0.95", "0.96")):
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
    assert "no parameter is called" in refusals(spoiled(bracket(), varied="frictoin"))["statement"]


@pytest.mark.parametrize("interval", ["-0.1..0.9142", "0.9142..0.9141", "0.9142..0.9142"])
def test_an_interval_holds_values_that_the_parameter_can_have(interval):
    certificate = bracket()
    certificate = spoiled(certificate, parameters=certificate["parameters"] | {"friction": interval})
    assert "friction cannot be" in refusals(certificate)["statement"]


# every line of the theorem


@pytest.mark.parametrize("name", ["rimless-wheel-stick", "rimless-wheel-slip"])
def test_the_claims_of_a_theorem_are_complete(name):
    result = check(proved(name))
    with ctx.workprec(PRECISION):
        statement = restore_statement(read_certificate(proved(name)))
    modes = mode_claim_names(statement.system, statement.cycle, statement.arcs)
    assert {claim.name for claim in result.claims} == {"existence and uniqueness", *modes, "stability"}
    assert any("apparent mass" in claim for claim in modes)


@pytest.mark.parametrize("lost", [0, 7, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 7))])
def test_a_claim_that_is_not_made_leaves_the_theorem_unproved(monkeypatch, lost):
    """Every claim of the mode sequence is required, also where nothing fails."""
    every = check_module.mode_sequence_claims

    def without(*arguments):
        return [claim for k, claim in enumerate(every(*arguments)) if k != lost]

    monkeypatch.setattr(check_module, "mode_sequence_claims", without)
    for certificate in (proved("rimless-wheel-stick"), bracket()):
        assert refusals(certificate).keys() == {"completeness"}


def window(time, *, segment=0, breakpoints=(0.5, 0.7), horizon=float("inf"), event="touchdown", data=(1, 2, 3)):
    """The claim that an arc ends within its segment, of a control law with these breakpoints."""
    control = SimpleNamespace(breakpoints=breakpoints, horizon=horizon)
    law = SimpleNamespace(control=control, n_z=0, data=lambda k: np.array([data[k]]))
    return _time_window(
        SimpleNamespace(system=law, arcs=[SimpleNamespace(segment=segment, event=event)]), 0, [arb(time)]
    )


def test_an_arc_ends_before_the_law_of_its_segment():
    words, margin = window("0.4")
    assert "before its segment" in words
    assert float(margin) == pytest.approx(0.1)
    window("0.6", segment=1)
    window("0.9", segment=2)
    window("0.5", event="breakpoint")
    with pytest.raises(Refuted):
        window("0.6")  # the breakpoint is left out
    with pytest.raises(Refuted):
        window("0.71", segment=1)
    with pytest.raises(Refuted):
        window("1.1", segment=2, horizon=1.0)
    with pytest.raises(NotProved):
        window("0.5 +/- 1e-20")
    words, _ = window("0.5 +/- 1e-20", data=(1, 1, 3))
    assert "is the same" in words


@pytest.mark.slow
def test_a_breakpoint_that_is_left_out_is_refused():
    """Gait III without torque after its reference's end has period 0.677046; with the torque kept on, 0.669457."""
    problem = load_problem("compass-pd-impact-slip").replace({"control.reference.beyond_end": "off"})
    right = solve(problem)
    law = right.system.control
    endless = ProportionalDerivative(kp=law.kp, kd=law.kd, reference=Reference(pieces=law.reference.pieces[:-1]))
    system = HybridSystem(type(problem.walker), endless, problem.impact_law, right.system.friction)
    wrong = solve_gait(problem, system)
    assert wrong.converged
    assert len(wrong.arcs) == len(right.arcs) - 1
    forged = forged_certificate(wrong, reference_record(law))
    refused = refusals(forged)
    assert [name for name in refused if name.endswith("time window")] == list(refused)


def forged_certificate(wrong, reference):
    """A box around a wrong orbit, with the reference of the right one."""
    header = header_of(wrong)
    with ctx.workprec(PRECISION):
        statement = restore_statement(
            read_certificate(through_json(header | {"reference": reference, "arcs": arc_records(arcs_of(wrong))}))
        )
        orbit = Orbit(wrong.system, statement.p, None, (), statement.cycle, statement.arcs, statement.record.order)
        arcs, centre = divide_into_steps(orbit, wrong)
        orbit = Orbit(wrong.system, statement.p, None, (), statement.cycle, arcs, statement.record.order)
        centre, _ = newton_step(orbit, centre)
        box = {
            "interval": [],
            "centre": [str(u.str(DIGITS, radius=False, more=True)) for u in centre],
            "tilt": ["0"] * len(centre),
            "radii": [f"{RADIUS:.2e}"] * len(centre),
        }
    return through_json(header | {"reference": reference, "arcs": arc_records(arcs), "boxes": [box]})


@pytest.mark.parametrize(("walker", "expected"), [(CompassBiped, {"touchdown"}), (RimlessWheel, {"upright"})])
def test_only_margins_of_feet_on_the_ground_vanish_after_an_impact(walker, expected):
    """Their expressions simplify to zero; those of other margins do not."""
    system = HybridSystem(walker, NoControl())
    names = system.transitions.margin_names(Mode.STICK)
    assert {name for name in names if _vanishes_after_impact(system, name)} == expected


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


PRINTED = {"resolved": {"sha256"}, "parameters": {"parameters", "curve_sha256"}, "reference": {"curve_sha256"}}
"""Entries of the printed statement that differ with a field of the certificate; one in ``not_proved`` names the gait
whose motion the tracked curve may not be."""


def lie(original, forged, path):
    """What a forged certificate proves that the original does not; None if it proves nothing else."""
    try:
        result = check(forged)
    except StorageError:
        return None
    if not result.proved:
        return None
    before, after = original.to_record(), result.to_record()
    if path[0] in ("versions", "theorem"):
        return None if before == after else "a field for readers changes the theorem"
    changed = {key for key in before["statement"] if before["statement"][key] != after["statement"][key]}
    printed = PRINTED.get(path[0], set()) | ({"not_proved"} if path[-3:] == ("reference", "gait", "name") else set())
    if changed - printed:
        return f"the statement differs in {changed}"
    for key in ("problem", "proved", "stable", "parameter", "special"):
        if before.get(key) != after.get(key):
            return f"{key} is {after.get(key)}"
    if [claim["claim"] for claim in before["claims"]] != [claim["claim"] for claim in after["claims"]]:
        return "the claims differ"
    if changed & {"curve_sha256", "parameters"}:
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
    fields = ("varied", "special", "parameters", "interval", "order")
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
