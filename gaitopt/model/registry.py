"""Walkers and control laws by name, from this package and from plugins.

The entry-point groups of plugins are ``gaitopt.walkers`` and ``gaitopt.controls``.
"""

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from itertools import groupby
from typing import Any, TypeVar, cast

from gaitopt.errors import GaitoptWarning, ProblemError
from gaitopt.model.contract import check_law
from gaitopt.model.control import Control
from gaitopt.model.declaration import check_class
from gaitopt.model.foreign import raised
from gaitopt.model.walker import Walker

Class = TypeVar("Class")
ENTRY_POINT_GROUP = "gaitopt.walkers"
CONTROL_GROUP = "gaitopt.controls"
OWN_PACKAGE = "gaitopt.model."
OWN_CONTROLS = {
    "none": "gaitopt.model.control:NoControl",
    "constant_torque": "gaitopt.model.control:ConstantTorque",
    "pd": "gaitopt.model.tracking:ProportionalDerivative",
    "controlled_symmetry": "gaitopt.model.controlled_symmetry:ControlledSymmetry",
    "alternating": "gaitopt.model.clocked:Alternating",
    "oscillating": "gaitopt.model.clocked:Oscillating",
    "virtual_constraints": "gaitopt.model.virtual_constraints:VirtualConstraints",
    "open_loop": "gaitopt.model.open_loop:OpenLoop",
}
"""Control laws of this package, in the order in which they are listed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Kind:
    """A kind of plugins.

    Attributes
    ----------
    group : name of the entry-point group.
    own : entry points of this package.
    title : name of the kind in messages.
    attribute : class attribute with the name of a plugin.
    check : function that raises an error if a class is ill formed.
    """

    group: str
    own: tuple[EntryPoint, ...]
    title: str
    attribute: str
    check: Callable[[object], None]


WALKERS = Kind(group=ENTRY_POINT_GROUP, own=(), title="walker", attribute="model", check=check_class)
CONTROLS = Kind(
    group=CONTROL_GROUP,
    own=tuple(EntryPoint(name, value, CONTROL_GROUP) for name, value in OWN_CONTROLS.items()),
    title="control law",
    attribute="type",
    check=check_law,
)


class Plugins(Mapping[str, Class]):
    """Classes of a kind by name; an entry point is imported when its class is first asked for."""

    def __init__(self, kind: Kind, entries: Mapping[str, Any]) -> None:
        self._kind, self._entries = kind, dict(entries)

    def __getitem__(self, name: str) -> Class:
        entry = self._entries[name]
        if not isinstance(entry, type):
            entry = self._entries[name] = _load(self._kind, entry)
        return cast(Class, entry)

    def __contains__(self, name: object) -> bool:
        return name in self._entries

    def __iter__(self) -> Iterator[str]:
        return iter(self._entries)

    def __len__(self) -> int:
        return len(self._entries)

    def __or__(self, others: Mapping[str, Class]) -> "Plugins[Class]":
        """These classes and others, which take precedence."""
        return Plugins(self._kind, {**self._entries, **others})


def registered_walkers() -> Plugins[type[Walker]]:
    """The walkers that a problem file may name, by name."""
    return _plugins(WALKERS)[0]


def registered_controls() -> Plugins[type[Control]]:
    """The control laws that a problem file may name, by name."""
    return _plugins(CONTROLS)[0]


def built_in(kind: Kind, name: str) -> Any:
    """The class with a name if this package defines it; otherwise None."""
    found = _plugins(kind)[0].get(name)
    return found if found is not None and found.__module__.startswith(OWN_PACKAGE) else None


def refused_walkers() -> Mapping[str, str]:
    """Messages about registered walkers that cannot be used, by name."""
    return _plugins(WALKERS)[1]


def refused_controls() -> Mapping[str, str]:
    """Messages about registered control laws that cannot be used, by name."""
    return _plugins(CONTROLS)[1]


@lru_cache(maxsize=2)
def _plugins(kind: Kind) -> tuple[Plugins[Any], dict[str, str]]:
    """Classes by name, and messages about those that cannot be used; the first call issues a warning about these.

    The classes of other packages are imported at once, those of this package when they are first asked for.
    """
    classes: dict[str, Any] = {}
    refused: dict[str, str] = {}
    order = {point.name: k for k, point in enumerate(kind.own)}
    found = [*kind.own, *entry_points(group=kind.group)]
    points = sorted(found, key=lambda point: (order.get(point.name, len(order)), point.name, point.value))
    for name, alike in groupby(points, key=lambda point: point.name):
        values = {point.value: point for point in alike}
        ours = [point for value, point in values.items() if value.startswith(OWN_PACKAGE)]
        if len(values) > 1 and not ours:
            refused[name] = f"several plugins have this name, {' and '.join(values)}: uninstall all but one"
            continue
        point = (ours or [*values.values()])[0]
        try:
            classes[name] = point if ours else _load(kind, point)
        except ProblemError as error:
            refused[name] = str(error)
        for other in values.keys() - {point.value}:
            refused[f"{name} of {other}"] = f"gaitopt has a {kind.title} of this name: choose another one"
    if refused:
        reasons = "; ".join(f"{kind.title} {name}: {why}" for name, why in refused.items())
        warnings.warn(f"not available: {reasons}", GaitoptWarning, stacklevel=2)
    return Plugins(kind, classes), refused


def _load(kind: Kind, point: EntryPoint) -> Any:
    """The class of an entry point.

    Raises
    ------
    ProblemError
        If it cannot be imported, is no well-formed class of its kind, or has another name.
    """
    try:
        loaded = point.load()
    except (Exception, SystemExit) as error:  # the import of another package's module may raise anything
        raise ProblemError(f"the plugin {point.value} cannot be imported: {raised(error)}") from error
    try:
        kind.check(loaded)
    except ProblemError as error:
        raise ProblemError(f"the plugin {point.value}: {error}") from error
    stated = getattr(loaded, kind.attribute)
    if stated != point.name:
        mismatch = f"has the {kind.attribute} {stated!r}, but its entry point is called {point.name!r}"
        raise ProblemError(f"the plugin {point.value} {mismatch}")
    return loaded
