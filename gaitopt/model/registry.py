"""Walkers by name, from this package and from plugins: the entry-point group ``gaitopt.walkers``."""

import warnings
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from itertools import groupby

from gaitopt.errors import GaitoptWarning, ProblemError
from gaitopt.model.declaration import check_class, raised
from gaitopt.model.walker import Walker

ENTRY_POINT_GROUP = "gaitopt.walkers"
OWN_PACKAGE = "gaitopt.model.walkers."


def registered_walkers() -> Mapping[str, type[Walker]]:
    """The walkers that a problem file may name, by name."""
    return _plugins()[0]


def refused_walkers() -> Mapping[str, str]:
    """Messages about registered walkers that cannot be used, by name."""
    return _plugins()[1]


@lru_cache(maxsize=1)
def _plugins() -> tuple[dict[str, type[Walker]], dict[str, str]]:
    """Walkers by name, and messages about those that cannot be used; the first call warns of these."""
    walkers: dict[str, type[Walker]] = {}
    refused: dict[str, str] = {}
    points = sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: (point.name, point.value))
    for name, alike in groupby(points, key=lambda point: point.name):
        values = {point.value: point for point in alike}
        ours = [point for value, point in values.items() if value.startswith(OWN_PACKAGE)]
        if len(values) > 1 and not ours:
            refused[name] = f"several plugins have this name, {' and '.join(values)}: uninstall all but one"
            continue
        point = (ours or [*values.values()])[0]
        try:
            walkers[name] = _load(point)
        except ProblemError as error:
            refused[name] = str(error)
        for other in values.keys() - {point.value}:
            refused[f"{name} of {other}"] = "gaitopt has a walker of this name: choose another one"
    if refused:
        reasons = "; ".join(f"walker {name}: {why}" for name, why in refused.items())
        warnings.warn(f"not available: {reasons}", GaitoptWarning, stacklevel=2)
    return walkers, refused


def _load(point: EntryPoint) -> type[Walker]:
    """The class of an entry point.

    Raises
    ------
    ProblemError
        If it cannot be imported, is no well-formed class of a walker, or has another name.
    """
    try:
        walker = point.load()
    except (Exception, SystemExit) as error:  # the import of another package's module may raise anything
        raise ProblemError(f"the plugin {point.value} cannot be imported: {raised(error)}") from error
    try:
        check_class(walker)
    except ProblemError as error:
        raise ProblemError(f"the plugin {point.value}: {error}") from error
    if walker.model != point.name:
        raise ProblemError(f"the plugin {point.value} calls its model {walker.model!r}, unlike its entry point")
    return walker
