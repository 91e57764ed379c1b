"""Where a result comes from: the problem verbatim, its hash, and the versions of everything that made it."""

from collections.abc import Mapping
from typing import Any

from gaitopt.problem import Problem
from gaitopt.store.manifest import Manifest, new_manifest


def provenance(problem: Problem, solver: Mapping[str, float], manifest: Manifest | None = None) -> dict[str, Any]:
    """What the foot of a page says; without a manifest the versions are those at hand."""
    known = manifest or new_manifest(problem.name, problem.digest)
    return {
        "name": problem.name,
        "text": problem.text,
        "hash": known.hash,
        "versions": known.versions,
        "platform": known.platform,
        "solver": dict(solver),
    }
