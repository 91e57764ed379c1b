"""Proof of a gait or of a family: boxes are found by search in long precision, and each is checked like any other."""

import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from importlib.metadata import version
from math import floor, log10
from typing import Any

from gaitopt.errors import ProblemError, StorageError, UnknownNameError
from gaitopt.gait import Gait
from gaitopt.proof.certificate import SCHEMA, read_certificate, reference_record
from gaitopt.proof.check import EXISTENCE, STATEMENT, silent, theorem
from gaitopt.proof.claims import Claim
from gaitopt.proof.cover import cover
from gaitopt.proof.graph import NotProved
from gaitopt.proof.orbit import Arc
from gaitopt.proof.outward import precision
from gaitopt.proof.parameters import INTERVAL, exact_texts
from gaitopt.proof.search import arcs_of
from gaitopt.proof.statement import refuse_what_is_not_modelled, restore_statement
from gaitopt.proof.taylor import PRECISION
from gaitopt.proof.theorem import Proof

ORDER, ORDER_OF_FAMILY = 20, 16
"""Of the integration of a narrow box, and of a long one."""
WIDTHS = (1e-8, 1e-7, 1e-6, 1e-5)
"""Of brackets of special points, tried in this order."""


def prove(gait: Gait, intervals: Mapping[str, str] | None = None, *, progress: Callable[[str], None] = silent) -> Proof:
    """Prove that a gait exists, is locally unique, has its mode sequence, and is stable or unstable.

    What ``gaitopt.prove`` does, which documents the arguments; ``progress`` called with words on how far the search is.
    """
    texts = _texts(gait, intervals or {})
    proof = _prove(gait, texts, progress)
    if intervals and len(intervals) == 1 and not proof.claims[0].proved:
        proof = _prove(gait, texts, progress, varied=next(iter(intervals)))
    return proof


def prove_special(
    gait: Gait, parameter: str, kind: str, width: float | None = None, *, progress: Callable[[str], None] = silent
) -> Proof:
    """Prove that a family of gaits has a special point next to one of them.

    Parameters
    ----------
    gait : converged, at the special point as well as that is known.
    parameter : dotted key of what varies.
    kind : one of ``BRACKETED``: a bifurcation, or a change of the mode sequence or of the impact.
    width : of the bracket in the parameter; None for the narrowest whose ends can be distinguished.
    """
    value = gait.dynamics.parameter(parameter)
    for interval in brackets(value, WIDTHS if width is None else (width,)):
        proof = _prove(gait, _texts(gait, {parameter: interval}), progress, varied=parameter, special=kind)
        if proof.proved:
            break
    return proof


def brackets(value: float, widths: Sequence[float]) -> Iterator[str]:
    """Intervals of given widths around a value, their ends in few digits."""
    for width in widths:
        places = 1 - floor(log10(width))
        lower, upper = (f"{end:.{places}f}" for end in (value - width / 2, value + width / 2))
        if float(lower) == float(upper):
            raise UnknownNameError(f"a bracket of width {width:g} around {value!r} has no length; use a wider one")
        yield f"{lower}{INTERVAL}{upper}"


def _prove(
    gait: Gait,
    texts: Mapping[str, str],
    progress: Callable[[str], None],
    *,
    varied: str | None = None,
    special: str | None = None,
) -> Proof:
    """The proof with the boxes that a search has found, or without any."""
    header = _header(gait, texts, varied, special)
    try:
        refuse_what_is_not_modelled(gait.problem, gait.system)
    except NotProved as failure:
        return Proof(gait.problem.name, (Claim(STATEMENT, proved=False, words=str(failure)),), header)
    with precision(PRECISION):
        try:
            statement = restore_statement(read_certificate({**header, "arcs": _arcs(arcs_of(gait))}))
        except (ValueError, StorageError) as error:  # of an interval, as everything else is the gait's
            raise ProblemError(f"{gait.problem.name}: {error}") from error
        try:
            arcs, boxes = cover(statement, gait, progress)
        except NotProved as failure:
            claim = Claim(EXISTENCE, proved=False, words=f"no boxes can be verified: {failure}")
            return Proof(gait.problem.name, (claim,), header, statement.words)
        records, pieces = zip(*boxes, strict=True)
        certificate = {**header, "arcs": _arcs(arcs), "boxes": [record.model_dump() for record in records]}
        return theorem(replace(statement, arcs=arcs), pieces, certificate)


def _arcs(arcs: Sequence[Arc]) -> list[dict[str, Any]]:
    return [{**asdict(arc), "mode": str(arc.mode), "fractions": list(arc.fractions)} for arc in arcs]


def _texts(gait: Gait, intervals: Mapping[str, str]) -> dict[str, str]:
    texts = exact_texts(gait.problem, gait.dynamics.parameters)
    for key, interval in intervals.items():
        if key not in texts:
            raise UnknownNameError(f"no parameter is called {key!r}; there are {', '.join(texts)}")
        texts[key] = INTERVAL.join(end.strip() for end in interval.split(INTERVAL))
    return texts


def _header(gait: Gait, texts: Mapping[str, str], varied: str | None, special: str | None) -> dict[str, Any]:
    """Everything that a proof is checked from, except its boxes."""
    return {
        "schema": SCHEMA,
        "problem": gait.problem.name,
        "resolved": replace(gait.problem, origin=None).resolved(),
        "parameters": texts,
        "reference": reference_record(gait.system.control),
        "varied": varied,
        "special": special,
        "order": ORDER if varied is None or special is not None else ORDER_OF_FAMILY,
        "arcs": [],
        "boxes": [],
        "versions": {name: version(name) for name in ("gaitopt", "casadi", "python-flint")}
        | {"python": platform.python_version()},
    }
