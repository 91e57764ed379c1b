"""A page from its content: templates, scripts and style sheets are put into one file that needs nothing else."""

import base64
import gzip
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from gaitopt.figures.labels import label, symbol
from gaitopt.problem import Problem
from gaitopt.problem.scalars import relevant_scalars, scalar_values, state_unit
from gaitopt.store.manifest import new_manifest

Record = Mapping[str, Any]


def render(template: str, **content: Any) -> str:
    """The page of a template; texts are escaped, and data stand in the page as compressed JSON."""
    loaders = [PackageLoader("gaitopt.pages", "web"), PackageLoader("gaitopt.figures", "web")]
    templates = Environment(
        loader=ChoiceLoader(loaders), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    templates.filters |= {"figure": figure, "packed": packed}
    return templates.get_template(template).render(content)


def packed(data: Mapping[str, Any]) -> str:
    """Data as compressed JSON in letters, for ``frame.html``."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode()


def figure(value: float | None, digits: int = 6) -> str:
    """A number for the eye."""
    return "–" if value is None else f"{value:.{digits}g}".replace("-", "−")


def words(films: Sequence[Record], records: Sequence[Record]) -> dict[str, Any]:
    """Labels that the scripts need: of the scalars that occur, and of the walker's states."""
    names = {name for film in films for name in film["shape"]}
    states = [key for name in (*sorted(names), "y", "x") for key in (name, f"d{name}")]
    freed = {key for record in records for key in record.get("parameters", ())}
    return {
        "scalars": {key: asdict(label(key)) for key in relevant_scalars(records)},
        "symbols": {name: symbol(name) for name in states},
        "units": {name: state_unit(name) for name in states},
        "parameters": {key: asdict(label(key)) for key in sorted(freed)},
    }


def numbers(record: Record) -> dict[str, Any]:
    """What the page shows of a gait besides its motion."""
    return {
        "scalars": {
            key: value if value is None else float(f"{value:.9g}") for key, value in scalar_values(record).items()
        },
        "multipliers": [[float(f"{m['re']:.7g}"), float(f"{m['im']:.7g}")] for m in record["multipliers"]],
        "state": {name: float(f"{value:.9g}") for name, value in record["state"].items()},
        "parameters": record["parameters"],
        "passed": None if record["verification"] is None else record["verification"]["passed"],
    }


def provenance(problem: Problem, solver: Mapping[str, float]) -> dict[str, Any]:
    """What the foot of a page says: the problem verbatim, its hash, and the versions of everything that solved it."""
    known = new_manifest(problem.name, problem.digest)
    return {
        "name": problem.name,
        "text": problem.text,
        "hash": known.hash,
        "versions": known.versions,
        "platform": known.platform,
        "solver": dict(solver),
    }
