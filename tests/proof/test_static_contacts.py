"""Proofs of walkers with several contacts whose static friction is above their kinetic one."""

import json
from functools import cache

import pytest

flint = pytest.importorskip("flint")
from flint import ctx  # noqa: E402
from named import named  # noqa: E402

from gaitopt import parse_problem, prove, solve  # noqa: E402
from gaitopt.problem.statement import problem_data  # noqa: E402
from gaitopt.problem.writing import write_problem  # noqa: E402
from gaitopt.proof import claims  # noqa: E402
from gaitopt.proof.arithmetic import PRECISION, ball  # noqa: E402
from gaitopt.proof.certificate import SCHEMA, ProblemRecord, read_certificate, sha256  # noqa: E402
from gaitopt.proof.check import check  # noqa: E402
from gaitopt.proof.statement import restore_statement  # noqa: E402

CRAWLER = {"rear": {"static": 0.63, "kinetic": 0.6}, "front": {"static": 0.42, "kinetic": 0.4}}


@cache
def gait(name, friction):
    data = problem_data(named(name).problem) | {"friction": json.loads(friction)}
    walk = solve(parse_problem(json.dumps(data)), progress=False)
    assert walk.converged, walk.message
    return walk


@cache
def proof(name, friction):
    return prove(gait(name, friction))


def failed(result):
    return {claim.name: claim.words for claim in result.claims if not claim.proved}


def test_the_crawler_slides_with_kinetic_friction_and_starts_where_static_friction_ends():
    """Its contacts slide with the kinetic coefficients, so that its closed form holds; see ``walkers.crawler``."""
    result, plain = proof("crawler", json.dumps(CRAWLER)), named("crawler")
    assert result.proved, failed(result)
    assert [claim.name for claim in result.claims if "mode at rest" in claim.name] == [
        "arc 1, rear: stick, front: slip_forward: mode at rest",
        "arc 3, rear: slip_forward, front: stick: mode at rest",
    ]
    assert abs(float(result.measures["step_length"].mid()) - plain.measures["step_length"]) < 1e-12
    with ctx.workprec(PRECISION):
        m, c, k = map(ball, ("1.5", "1.5", "20"))
        s = c / (2 * m)
        assert result.durations[0].overlaps(flint.arb.pi() / (k / m - s * s).sqrt())


@pytest.mark.parametrize(
    ("stated", "refused"),
    [
        # static friction holds the front, so that the walker would rest
        ('"static": 0.9', "arc 1, rear: stick, front: slip_forward: mode at rest"),
        ('"static": 0.39', "statement"),
    ],
)
def test_a_forged_static_coefficient_is_refused(stated, refused):
    data = json.loads(json.dumps(proof("crawler", json.dumps(CRAWLER)).certificate))
    text = data["problem"]["text"]
    front = next(text_of for text_of in ('"static": 0.42', "static: 0.42") if text_of in text)
    data["problem"]["text"] = text.replace(front, stated if front.startswith('"') else stated.replace('"', ""))
    data["problem"]["sha256"] = sha256(data["problem"]["text"])
    result = check(data)
    assert refused in failed(result), failed(result)


@pytest.mark.slow
def test_heel_and_toe_with_two_coefficients_are_proved():
    friction = json.dumps({"static": 0.264, "kinetic": 0.262})
    result, walk = proof("heel-toe-slip", friction), gait("heel-toe-slip", friction)
    assert result.proved, failed(result)
    assert result.stable
    for key in ("period", "step_length"):
        assert abs(float(result.measures[key].mid()) - walk.measures[key]) < 1e-9, key
    assert check(json.loads(json.dumps(result.certificate))).proved


@pytest.mark.slow
def test_where_a_contact_leaves_the_ground_no_other_one_slips_instead():
    """A heel leaves the ground: as many contacts would stick if it stayed and the heel of the other foot slipped."""
    walk = named("flat-foot")
    problem = parse_problem(json.dumps(problem_data(walk.problem) | {"friction": {"static": 1.2, "kinetic": 1.1}}))
    certificate = {"schema": SCHEMA, "problem": ProblemRecord.of(write_problem(problem)).model_dump(), "intervals": {}}
    certificate |= {"designed": {}, "law": None, "reference": None, "varied": None, "special": None, "order": 20}
    certificate |= {"arcs": [{"phase": k, "fractions": []} for k in range(3)], "boxes": []}
    with ctx.workprec(PRECISION):
        statement = restore_statement(read_certificate(certificate))
        names = claims.mode_claim_names(statement.system, statement.law, statement.cycle, statement.arcs)
        assert [name.partition(",")[0] for name in names if name.endswith("mode at rest")] == ["arc 2"]
        y = [flint.arb(float(value), 1e-9) for value in (*walk.arcs[1].states[0], walk.arcs[1].start)]
        words, _ = claims._mode_at_rest(statement.orbit(()), 1, y)
    assert words.endswith("swing_heel cannot")
