"""Orbit files: of any gait, what the program of the set finds wrong in one, and spoiled copies."""

import json
import runpy
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gaitopt import Gait
from gaitopt.problem.writing import ExactValues, write_problem
from gaitopt.show.orbits import orbit_record

SET = Path(__file__).resolve().parents[1] / "results" / "reference-orbits"
PROGRAM = runpy.run_path(str(SET / "recompute.py"))


def written(gait: Gait) -> dict[str, Any]:
    """The orbit file of a gait; a test that needs one is skipped without the extra ``proof``."""
    pytest.importorskip("flint")
    from gaitopt.proof.prove import stated_problem

    decimals = ExactValues(write_problem(stated_problem(gait)))
    exact = {key: decimals(key, value) for key, value in gait.dynamics.parameters.items()}
    record = {"version": "0.0.0", **orbit_record(gait, exact), "tree": None}
    return json.loads(json.dumps(record, allow_nan=False))


def differing(data: dict[str, Any]) -> list[str]:
    """Groups of numbers in which an orbit differs from what its equations give."""
    return [group for group, error in PROGRAM["judge"](data).items() if not error <= PROGRAM["LIMITS"][group]]


def changed(data: dict[str, Any], key_path: str, change: Callable[[Any], Any]) -> dict[str, Any]:
    """The orbit with another entry at a path of keys, which slashes separate."""
    *path, last = (int(key) if key.isdigit() else key for key in key_path.split("/"))
    entry: Any = data
    for key in path:
        entry = entry[key]
    entry[last] = change(entry[last])
    return data
