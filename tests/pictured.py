"""Gaits that the tests of figures and pages draw; each is solved once."""

from functools import cache
from pathlib import Path

from named import named, verification
from oracles import example

from gaitopt import Gait, load_problem, solve, verify

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
