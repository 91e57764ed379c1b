"""Certificates of proofs, what their checker refuses, and copies with another text."""

import json
from copy import deepcopy
from functools import cache, reduce

from flint import arb, ctx
from named import named

from gaitopt import prove, solve
from gaitopt.problem.writing import write_problem
from gaitopt.proof.arithmetic import PRECISION
from gaitopt.proof.certificate import SCHEMA, ProblemRecord, read_certificate, sha256
from gaitopt.proof.check import check
from gaitopt.proof.statement import restore_statement


class BALLS:
    """Functions of balls, by the names of NumPy's."""

    sin, cos, sqrt, exp = arb.sin, arb.cos, arb.sqrt, arb.exp
    pi = arb.pi()


@cache
def gait(name, **changes):
    """The gait of a named problem with some changes."""
    return solve(named(name).problem.replace(changes), progress=False) if changes else named(name)


@cache
def proof(name, **changes):
    return prove(gait(name, **changes), progress=False)


def through_json(record):
    return json.loads(json.dumps(record))


def certificate_of(name):
    """A copy of the certificate of a proved gait, as it is read from its file; it may be changed."""
    assert proof(name).proved, failed(proof(name))
    return through_json(proof(name).certificate)


def failed(result):
    """What is not proved, by the name of the claim."""
    return {claim.name: claim.finding for claim in result.claims if not claim.proved}


def failures(certificate, **options):
    return failed(check(certificate, **options))


def refusals(certificate):
    """What is not proved of a certificate that must be refused."""
    result = check(certificate)
    assert not result.proved
    return failed(result)


def spoiled(certificate, **changes):
    return deepcopy(dict(certificate)) | changes


def reworded(certificate, *changes, within=()):
    """A certificate whose text says something else, with the SHA-256 of that.

    Parameters
    ----------
    changes : pairs of old and new text.
    within : names of problems that the text names, from the outside inwards, if the text of the last one changes.
    """
    certificate = spoiled(certificate)
    problem = reduce(lambda outer, name: outer["problems"][name], within, certificate["problem"])
    for old, new in changes:
        assert old in problem["text"], old
        problem["text"] = problem["text"].replace(old, new)
    problem["sha256"] = sha256(problem["text"])
    return certificate


def restored(certificate):
    """The statement that a certificate is about."""
    with ctx.workprec(PRECISION):
        return restore_statement(read_certificate(certificate))


def negated(graph):
    """A property that is a graph all of whose outputs have the other sign."""
    return property(lambda self: lambda y: [[-value for value in values] for values in graph(self)(y)])


def without_boxes(problem, timed=()):
    """A certificate of a problem's statement, before any arc is divided; some phases end at breakpoints."""
    arcs = [{"phase": k, "fractions": [], "timed": k in timed} for k in range(len(problem.cycle.phases))]
    certificate = {"schema": SCHEMA, "problem": ProblemRecord.of(write_problem(problem)).model_dump(), "intervals": {}}
    certificate |= {"designed": {}, "law": None, "reference": None, "varied": None, "special": None, "order": 20}
    return certificate | {"arcs": arcs, "boxes": []}
