"""Proof of a gait: a certificate is made by search in long precision, and then checked like any other."""

import platform
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

from flint import arb, ctx

from gaitopt.errors import SolveError, UnknownNameError
from gaitopt.gait import Gait
from gaitopt.proof.check import EXISTENCE, SCHEMA, check
from gaitopt.proof.claims import Claim
from gaitopt.proof.control import control_record
from gaitopt.proof.graph import NotProved
from gaitopt.proof.orbit import Arc, Orbit
from gaitopt.proof.parameters import ball, exact_texts
from gaitopt.proof.search import plan, refine
from gaitopt.proof.taylor import LOW_ORDER, LOW_PRECISION, ORDER, PRECISION
from gaitopt.proof.theorem import Proof

RADII = ("1e-10", "1e-12", "1e-14")
"""Half widths of the box in which the orbit is shown to be unique, tried in this order."""
CENTRE_DIGITS = 30


def prove(gait: Gait, intervals: Mapping[str, str] | None = None) -> Proof:
    """Prove that a gait exists, is locally unique, has its mode sequence, and is stable or unstable.

    Parameters
    ----------
    gait : converged; nothing of it is trusted.
    intervals : parameters by dotted key for all of whose values this is to be proved, as ``0.18..0.25``.

    Raises
    ------
    UnknownNameError
        If a key is no parameter of the gait.
    ValueError
        If an interval is not of that form.
    """
    try:
        certificate = make_certificate(gait, intervals)
    except NotProved as failure:
        claim = Claim(EXISTENCE, proved=False, words=f"no steps can be verified: {failure}")
        return Proof(problem=gait.problem.name, claims=(claim,), certificate={})
    for radius in RADII:
        proof = check({**certificate, "radius": radius})
        if proof.claims[0].proved or proof.claims[0].name != EXISTENCE:
            break
    return proof


def make_certificate(gait: Gait, intervals: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Everything that a proof is checked from, except the radius of its box; parameters as in ``prove``."""
    system, problem = gait.system, gait.problem
    if len(gait.steps) != 1:
        raise SolveError(f"{problem.name}: a proof needs a gait of one step, this is one of {len(gait.steps)}")
    scalars = {name: float(gait.p[system.parameters.index(f"control.{name}")]) for name in system.control.parameters}
    texts = exact_texts(problem, system, dict(zip(system.parameters, map(float, gait.p), strict=True)))
    for key, interval in (intervals or {}).items():
        if key not in texts:
            raise UnknownNameError(f"no parameter is called {key!r}; there are {', '.join(texts)}")
        texts[key] = interval
    with ctx.workprec(PRECISION):
        p = [ball(texts[key]) for key in system.parameters]
        arcs = plan(gait, p)
        centre = refine(Orbit(system, p, arcs, problem.cycle.impact), gait)
        digits = [_digits(value) for value in centre]
    return {
        "schema": SCHEMA,
        "problem": problem.name,
        "text": problem.text,
        "resolved": problem.resolved(),
        "parameters": texts,
        "control": control_record(system.control, scalars),
        "arcs": [_arc_record(arc) for arc in arcs],
        "centre": digits,
        "settings": {"order": ORDER, "low_order": LOW_ORDER, "bits": PRECISION, "low_bits": LOW_PRECISION},
        "versions": {name: version(name) for name in ("gaitopt", "casadi", "python-flint")}
        | {"python": platform.python_version()},
    }


def _digits(value: arb) -> str:
    return str(value.str(CENTRE_DIGITS, radius=False, more=True))


def _arc_record(arc: Arc) -> dict[str, Any]:
    steps = [[step.h, [list(speed) for speed in step.speeds]] for step in arc.steps]
    return {"mode": str(arc.mode), "segment": arc.segment, "phase": arc.phase, "event": arc.event, "steps": steps}
