"""Gaits that the tests of figures and pages draw; each is solved once."""

from functools import cache
from math import degrees
from pathlib import Path

from named import named, verification
from oracles import example

from gaitopt import Cycle, Gait, load_problem, solve, verify
from gaitopt.gait.regions import Slice, arrange
from gaitopt.runs.atlas import Atlas
from gaitopt.runs.grid import axis_of

TORSO = "docs/examples/torso-compass.yaml"
SEQUENCES = ("compass-passive-a", "compass-passive-b", "compass-pd-impact-slip", "rimless-wheel-slip")


@cache
def gait(name: str) -> Gait:
    """The verified gait of a named problem, or of the torso compass."""
    if name != TORSO:
        return named(name).verified(verification(name).to_record())
    path = Path(__file__).parents[1] / name
    torso_gait = solve(load_problem(path, walkers=[example("torso_compass", "TorsoCompass")]))
    assert torso_gait.converged
    return torso_gait.verified(verify(torso_gait).to_record())


@cache
def atlas() -> Atlas:
    """A small atlas of gait A about its Neimark-Sacker curve, with one gait of two steps on a second sheet."""
    problem, axes = (
        load_problem("compass-passive-a"),
        (axis_of("friction", 0.1, 0.13, 2), axis_of("walker.slope", "0.95 deg", "1.05 deg", 2)),
    )
    slices = []
    for slope in (axes[1].lower, axes[1].upper):
        points = []
        for friction in (0.105, 0.12):
            found = solve(problem.replace({"friction": friction, "walker.slope": slope}))
            points.append({"value": friction, **found.to_record()})
        segments, torus = [points[:1], points[1:]], 0.1103 + (degrees(slope) - 1) * 0.04
        specials = [("end", 0.1), ("neimark_sacker", torus), ("end", 0.13)]
        two = solve(
            problem.replace({"walker.slope": slope}).with_modes(Cycle(problem.cycle.steps * 2), problem.guess.state)
        )
        doubled = [
            {
                "segments": [[{"value": 0.12, **two.to_record()}]],
                "specials": [{"type": "neimark_sacker", "value": torus}, {"type": "end", "value": 0.13, "bound": True}],
                "doubled": [],
            }
        ]
        stated = [{"type": kind, "value": value, "bound": kind == "end"} for kind, value in specials]
        slices.append(Slice.from_record({"value": slope, "segments": segments, "specials": stated, "doubled": doubled}))
    flat = [*slices, *(each.doubled[0] for each in slices)]
    return Atlas(
        problem=problem, axes=axes, slices=tuple(flat), arrangement=arrange(slices, (0.1, 0.13)), gaits=({}, {}, {})
    )


@cache
def branch() -> tuple[dict, ...]:
    """Records of two short branches over the friction, with the special points of gaits A and B."""
    steps = {"compass-passive-a": (0.15, 0.145, 0.14, 0.135), "compass-passive-b": (0.16, 0.15, 0.14)}
    records = []
    for number, (name, values) in enumerate(steps.items()):
        problem = load_problem(name)
        for index, value in enumerate(values):
            point = {"record": "point", "parameter": "friction", "branch": number, "index": index, "value": value}
            records.append(point | solve(problem.replace({"friction": value})).to_record())
    special = {"record": "special", "status": "converged", "reason": "", "next": [], "gait": {}}
    records.append(special | {"branch": 0, "type": "neimark_sacker", "value": 0.135})
    records.append(special | {"branch": 1, "type": "end", "value": 0.16, "reason": "the end of the range"})
    return tuple(records)
