"""Walkers by name: ours, and those that other packages register under the entry-point group ``gaitopt.walkers``."""

import inspect
import warnings
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points

from gaitopt.errors import GaitoptWarning
from gaitopt.mechanics.walker import Walker

ENTRY_POINT_GROUP = "gaitopt.walkers"


def registered_walkers() -> Mapping[str, type[Walker]]:
    """Every walker that a problem file may name: ours, and those of the entry-point group ``gaitopt.walkers``."""
    return _plugins()[0]


def refused_walkers() -> Mapping[str, str]:
    """Why a registered name cannot be used, by name."""
    return _plugins()[1]


@lru_cache(maxsize=1)
def _plugins() -> tuple[dict[str, type[Walker]], dict[str, str]]:
    """Walkers by name, and why the others are refused; warns once of those."""
    walkers: dict[str, type[Walker]] = {}
    refused: dict[str, str] = {}
    for point in sorted(entry_points(group=ENTRY_POINT_GROUP), key=lambda point: point.name):
        try:
            walker = point.load()
        except Exception as error:  # noqa: BLE001 - importing someone's module may raise anything
            refused[point.name] = f"the plugin {point.value} cannot be imported: {type(error).__name__}: {error}"
            continue
        why = _objection(point, walker)
        if why is None:
            walkers[point.name] = walker
        else:
            refused[point.name] = f"the plugin {point.value} {why}"
    if refused:
        reasons = "; ".join(f"walker {name}: {why}" for name, why in refused.items())
        warnings.warn(f"not available: {reasons}", GaitoptWarning, stacklevel=2)
    return walkers, refused


def _objection(point: EntryPoint, walker: object) -> str | None:
    """What keeps an entry point from being a walker, if anything does."""
    if not (isinstance(walker, type) and issubclass(walker, Walker)):
        return "is no subclass of gaitopt.mechanics.Walker"
    if inspect.isabstract(walker):
        return f"lacks {', '.join(sorted(walker.__abstractmethods__))}"
    missing = [name for name in ("model", "shape", "section") if not hasattr(walker, name)]
    if missing:
        return f"does not say its {', '.join(missing)}"
    return None if walker.model == point.name else f"calls its model {walker.model!r}, unlike its entry point"
