"""Overrides of a problem: values by dotted key, set in its data; and the keys in which two problems differ.

Dotted keys are friction, walker.slope, gait.guess.state.theta1, constraints.speed.min, and so on.
"""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

from gaitopt.model.modes import Mode
from gaitopt.problem.faults import Fault, Key, OverridePlace, dotted, shown
from gaitopt.problem.schema import OPEN

DURATIONS = ("gait", "guess", "durations")
SLIP_VELOCITY = ("gait", "guess", "state", "dx")


def apply_overrides(
    data: Mapping[str, Any], overrides: Mapping[str, object], faults: list[Fault], label: str = ""
) -> tuple[dict[str, Any], OverridePlace]:
    """A copy of ``data`` with ``overrides``, and the place by which faults name them.

    An override of the sequence removes the parts of the first guess that no longer apply, unless they are overridden
    too: durations when the number of phases changes, the slip velocity when the impact sticks, and impact and
    durations when the sequence is opened.
    """
    changed = deepcopy(dict(data))
    place = OverridePlace({key: _path(key) for key in overrides}, label)
    for key, value in overrides.items():
        _set(changed, place.keys[key], value, faults)
    if not faults:
        _drop_stale(data, changed, tuple(place.keys.values()))
    return changed, place


def _path(key: str) -> Key:
    """Keys of mappings; a name after ``constraints`` or ``objective`` may itself hold dots (state.dx, walker.slope)."""
    first, *rest = key.split(".")
    if first not in ("constraints", "objective") or not rest:
        return (first, *rest)
    end = rest[-1:] if first == "constraints" and rest[-1] in ("min", "max") and len(rest) > 1 else []
    return (first, ".".join(rest[: len(rest) - len(end)]), *end)


def _set(data: dict[str, Any], path: Key, value: object, faults: list[Fault]) -> None:
    section: Any = data
    if path[0] == "friction":
        value = _match_friction(data, path, value, faults)
    for depth, key in enumerate(path[:-1], start=1):
        created: dict[str, Any] = {}
        section = section.setdefault(key, created)
        if not isinstance(section, dict):
            faults.append(Fault(path, f"{dotted(path[:depth])} is {shown(section)} and has no keys: set it as a whole"))
            return
    section[path[-1]] = deepcopy(value)


def _match_friction(data: dict[str, Any], path: Key, value: object, faults: list[Fault]) -> object:
    """A single coefficient sets two equal ones; one of two coefficients splits a single one."""
    friction = data["friction"]
    if len(path) > 1 and isinstance(friction, int | float):
        data["friction"] = {"static": friction, "kinetic": friction}
    elif (
        len(path) == 1
        and isinstance(value, int | float)
        and "static" in (friction if isinstance(friction, dict) else ())
    ):
        if friction["static"] == friction["kinetic"]:
            return {**friction, "static": value, "kinetic": value}
        faults.append(
            Fault(path, f"there are two coefficients, {shown(friction)}: set friction.static or friction.kinetic")
        )
    return value


_REPLACED = (("steps", ("phases", "impact")), ("phases", ("steps",)))
_OPENED = (("phases", ("impact", "steps")),)
"""Keys of a gait that are removed when another one is set: by one step or several, and by an open sequence."""


def _drop_stale(before: Mapping[str, Any], after: Mapping[str, Any], overridden: tuple[Key, ...]) -> None:
    def is_set(path: Key) -> bool:
        return any(path[: len(key)] == key for key in overridden)

    gait = after["gait"]
    if not isinstance(gait, dict) or not isinstance(gait.get("guess"), dict):
        return
    guess, opened = gait["guess"], gait.get("phases") == OPEN
    if opened and before["gait"].get("phases") != OPEN:
        guess.pop("durations", None)
    stale = _OPENED if opened and before["gait"].get("phases") != OPEN else () if opened else _REPLACED
    for key, others in stale:
        if is_set(("gait", key)):
            for other in others:
                if not is_set(("gait", other)):
                    gait.pop(other, None)
    if _phase_counts(gait) not in (None, _phase_counts(before["gait"])) and not is_set(DURATIONS):
        guess.pop("durations", None)
    last = next(iter(_steps(gait)[-1:]), None)
    sticks = isinstance(last, Mapping) and last.get("impact") == Mode.STICK
    if sticks and not is_set(SLIP_VELOCITY) and isinstance(guess.get("state"), dict):
        guess["state"].pop("dx", None)


def _steps(gait: Mapping[str, Any]) -> list[Any]:
    """The steps in the data of a gait, valid or not."""
    steps = gait.get("steps", [gait])
    return list(steps) if isinstance(steps, list | tuple) else []


def _phase_counts(gait: Mapping[str, Any]) -> list[int] | None:
    """Number of phases of every step; None where the data are not steps."""
    phases = [step.get("phases") if isinstance(step, Mapping) else None for step in _steps(gait)]
    counts = [len(p) for p in phases if isinstance(p, list | tuple)]
    return counts if len(counts) == len(phases) else None


def changed_values(before: Mapping[str, Any], after: Mapping[str, Any], above: str = "") -> list[str]:
    """Dotted keys whose values differ in the data of two problems; ``name`` and ``about`` do not count."""
    changed = []
    for key in dict.fromkeys([*before, *after]):
        one, other = before.get(key), after.get(key)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            changed += changed_values(one, other, f"{above}{key}.")
        elif one != other and (above or key not in ("name", "about")):
            changed.append(f"{above}{key}")
    return changed
