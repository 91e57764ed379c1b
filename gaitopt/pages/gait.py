"""The report of one gait, or of several side by side."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from gaitopt.figures.comparison import differences, points_of, positions_of, simulated, thinned
from gaitopt.figures.film import film
from gaitopt.figures.motion import Motion, motion_of, smooth
from gaitopt.figures.packing import pack
from gaitopt.gait import Gait
from gaitopt.pages.page import numbers, provenance, render, words

FLOOR = 1e-17
"""Differences of exactly zero are drawn here, at the foot of the log axis."""


def comparison_report(gaits: Sequence[Gait]) -> str:
    """HTML of gaits side by side: numbers, figures, moving walkers, NLP against simulation, verification, provenance.

    Raises
    ------
    ValueError
        If one of them is a failed attempt.
    """
    if not all(gait.converged for gait in gaits):
        raise ValueError("only converged gaits have a report; look at their status first")
    records = [gait.to_record() for gait in gaits]
    motions = [motion_of(gait, name) for gait, name in zip(gaits, _names(gaits), strict=True)]
    shown = [
        {"film": film(motion), "comparison": _comparison(motion, gait), **numbers(record)}
        for motion, gait, record in zip(motions, gaits, records, strict=True)
    ]
    return render(
        "gaits.html",
        title=" and ".join(dict.fromkeys(gait["film"]["name"] for gait in shown)),
        about=gaits[0].problem.about if len(gaits) == 1 else "Side by side",
        data={"gaits": shown, **words([gait["film"] for gait in shown], records)},
        checks=[(gait["film"]["name"], record["verification"]) for gait, record in zip(shown, records, strict=True)],
        origins=[provenance(gait.problem, gait.solver) for gait in gaits],
    )


def _names(gaits: Sequence[Gait]) -> list[str]:
    """Names of the problems; gaits of the same name are distinguished by their hash."""
    names = [gait.problem.name for gait in gaits]
    return [n if names.count(n) == 1 else f"{n} ({g.problem.hash8})" for n, g in zip(names, gaits, strict=True)]


def _comparison(motion: Motion, gait: Gait) -> dict[str, Any]:
    """Angles along the simulated steps, points of the NLP's gait, and their difference."""
    walked = simulated(gait)
    times, states = thinned(*points_of(motion.steps))
    names = positions_of(motion)
    columns = [motion.state_index(name) for name in names]
    nodes = {"t": times} | {name: states[:, k] for name, k in zip(names, columns, strict=True)}
    arcs = [
        (arc.mode, {"t": began + arc.times} | {n: arc.states[:, k] for n, k in zip(names, columns, strict=True)})
        for began, arc in smooth(walked)
    ]
    gaps = [
        {"t": times, "difference": np.log10(np.maximum(np.abs(gap).max(axis=1), FLOOR))}
        for times, gap in differences(motion.steps, walked)
    ]
    return {
        "nodes": pack(nodes),
        "lines": [{"mode": str(mode.contact), **pack(line)} for mode, line in arcs],
        "gaps": [pack(gap) for gap in gaps],
    }
