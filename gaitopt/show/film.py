"""A moving walker on a page: drawing, forces, states and torques at some tens of times, packed as short text.

    value = low + step * code,      code = 0 ... 8191

Columns of numbers are packed with 13 bits a number as base64, a constant with none. The low bytes of a column stand
before the high ones, which differ so little that the page compresses well.
"""

import base64
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from numpy.typing import ArrayLike

from gaitopt.gait import curves
from gaitopt.gait.measures import observe
from gaitopt.gait.trajectory import Arc
from gaitopt.show.motion import Motion, running
from gaitopt.show.walker import Skeleton, skeleton, slope

FRAMES = 72
"""Most frames of a cycle; a page draws smooth curves through them."""
FRAMES_OF_WALK = 240
"""Fewest frames of a walk."""
REPEATS = 4
"""How often the page goes through a cycle before it starts again."""
FEWEST = 5
"""Frames of a phase, however short."""
VISIBLE, SMALLEST = 3e-4, 1e-6
"""Part of a state's range that can be seen on a page; and ranges [rad, m; per s] too small to matter."""


def film(motion: Motion, frames: int = FRAMES) -> dict[str, Any]:
    """A cycle or a walk as a JSON-able object, in SI units; ``walker.js`` and the report read it.

    Frames are Chebyshev points of each phase, as many as a smooth curve needs. Point 0 is the stance foot, ``contact``
    the one on which the ground acts; all x are counted from where the foot stood at the start of its step, which is
    ``origin`` in the cycle. ``path`` are times and places between which the picture follows the walker.
    """
    cycle = list(_running(motion, frames if motion.periodic else max(FRAMES_OF_WALK, frames * len(motion.steps))))
    arcs = [part.arc for part in cycle]
    drawing = skeleton(arcs)
    path = _path(motion)
    impacts = [step.impact for step in motion.steps if step.impact is not None]
    impulses = [impact.stick_impulse.tolist() for impact in impacts]
    return {
        "name": motion.name,
        "slope": slope(motion),
        "friction": motion.dynamics.static_friction,
        "weight": float(motion.dynamics.system.weight(motion.dynamics.p)),
        "period": _short(motion.period),
        "steps": len(motion.steps),
        "repeats": REPEATS if motion.periodic else 1,
        "step_length": path[-1][1],
        "path": path,
        "impacts": [str(impact.mode) for impact in impacts],
        "impulse_ratios": [tangential / normal if normal else None for tangential, normal in impulses],
        "shape": list(motion.walker.shape),
        "lengths": bool(motion.walker.lengths),
        "actuators": list(motion.walker.actuators),
        "phases": _phases(cycle),
        "legs": drawing.legs,
        "ties": drawing.ties,
        "discs": drawing.discs,
        "contact": drawing.contact,
        "frames": pack(_columns(motion, arcs, drawing)),
    }


def animation_page(motion: Motion, about: str = "") -> str:
    """HTML of the walker going through several steps of ``motion``; ``about`` stands under the title."""
    templates = Environment(
        loader=PackageLoader("gaitopt.show", "web"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    templates.policies["json.dumps_kwargs"] = {"sort_keys": False, "separators": (",", ":")}
    return templates.get_template("animation.html").render(film=film(motion), about=about)


def _path(motion: Motion) -> list[list[float]]:
    """Time [s] and place [m] of the stance foot at the start of each step, and of the walker at the end."""
    times, places = [0.0], [0.0]
    for step in motion.steps:
        pace = places[-1] / times[-1] if times[-1] else 0.0
        times.append(times[-1] + step.period)
        places.append(places[-1] + (step.impact.step_length if step.impact is not None else pace * step.period))
    return [[_short(time), _short(place)] for time, place in zip(times, places, strict=True)]


@dataclass(frozen=True, slots=True)
class _Part:
    """An arc at its frames, the index of its step, and time [s] and place [m] at which that step begins."""

    arc: Arc
    step: int
    began: float
    origin: float


def _running(motion: Motion, frames: int) -> Iterator[_Part]:
    origin = 0.0
    for index, (began, step) in enumerate(running(motion.steps)):
        for arc in step.arcs:
            most = max(FEWEST, round(frames * arc.duration / motion.period))
            yield _Part(_resolved(arc, most), index, began, origin)
        origin += 0.0 if step.impact is None else step.impact.step_length


def _resolved(arc: Arc, most: int) -> Arc:
    """The arc at as few Chebyshev points as resolve it for the eye, but no more than ``most``."""
    if len(arc.times) == 2:  # too short to be anything but straight
        return arc
    fitted = curves.coefficients(arc.states)
    scale = np.maximum(np.ptp(arc.states, axis=0), SMALLEST)
    left = (np.abs(fitted[::-1]).cumsum(axis=0)[::-1] / scale).max(axis=1)  # what is lost from each term on
    enough = int(np.argmax(np.append(left, 0.0) < VISIBLE))
    s = curves.points(min(max(enough, FEWEST), max(most, FEWEST)))
    states = np.asarray(curves.evaluate(fitted, s))
    return replace(arc, times=arc.start + arc.duration * (s + 1) / 2, states=states)


def _phases(cycle: list[_Part]) -> list[dict[str, Any]]:
    """Mode, times, step and first and last frame of every arc."""
    ends = np.cumsum([len(part.arc.times) for part in cycle])
    return [
        {
            "mode": str(part.arc.mode.contact),
            "start": _short(part.began + part.arc.start),
            "end": _short(part.began + part.arc.end),
            "step": part.step,
            "origin": _short(part.origin),
            "first": int(end - len(part.arc.times)),
            "last": int(end - 1),
        }
        for part, end in zip(cycle, ends, strict=True)
    ]


def _short(value: float) -> float:
    """As many digits as a page can show."""
    return float(f"{value:.7g}")


def _columns(motion: Motion, arcs: list[Arc], drawing: Skeleton) -> dict[str, Any]:
    observed = [observe(arc) for arc in arcs]
    force = np.vstack([o.force for o in observed])
    torque = np.vstack([o.torque for o in observed])
    states = np.vstack([arc.states for arc in arcs])
    columns = {"f_t": force[:, 0], "f_n": force[:, 1]}
    for name in motion.walker.shape:
        columns |= {key: states[:, motion.state_index(key)] for key in (name, f"d{name}")}
    columns |= {f"torque {name}": torque[:, k] for k, name in enumerate(motion.walker.actuators)}
    for k in range(drawing.points.shape[1]):
        columns |= {f"x{k}": drawing.points[:, k, 0], f"y{k}": drawing.points[:, k, 1]}
    return columns


CODES = 8191
"""A chart on a page is some 300 pixels high."""


def pack(columns: Mapping[str, ArrayLike]) -> dict[str, Any]:
    """Pack columns of equal length; ``columns.js`` unpacks them to within 7e-5 of their range."""
    packed, rows = {}, 0
    for name, values in columns.items():
        numbers = np.asarray(values, dtype=float)
        rows, low = len(numbers), float(numbers.min())
        step = float(np.ptp(numbers)) / CODES
        codes = np.round((numbers - low) / step).astype("<u2") if step > 0 else np.empty(0, "<u2")
        planes = codes.view(np.uint8).reshape(-1, 2).T.tobytes()
        packed[name] = [float(f"{low:.7g}"), float(f"{step:.5g}"), base64.b64encode(planes).decode()]
    return {"rows": rows, "columns": packed}
