"""A step as data for a page that moves: the walker's drawing, forces, states and torques at some tens of times."""

from typing import Any

import numpy as np

from gaitopt.figures.motion import Motion, resampled
from gaitopt.figures.packing import pack
from gaitopt.figures.skeleton import Skeleton, skeleton, slope
from gaitopt.gait import Arc

FRAMES = 72
"""Frames of a step; a page draws straight lines between them."""
FEWEST = 5
"""Frames of a phase, however short."""


def film(motion: Motion, frames: int = FRAMES) -> dict[str, Any]:
    """The step of ``motion`` as a JSON-able object, in SI units; ``walker.js`` and the report read it.

    Frames are equidistant within each phase. Point 0 is the stance foot, so that its x is the slip.
    """
    arcs = [resampled(arc, max(FEWEST, round(frames * arc.duration / motion.step.period))) for arc in motion.step.arcs]
    drawing = skeleton(motion, np.vstack([arc.states for arc in arcs]))
    impact = motion.step.impact
    ratio = None if impact is None else float(impact.stick_impulse[0] / impact.stick_impulse[1])
    return {
        "name": motion.name,
        "slope": slope(motion),
        "friction": motion.friction,
        "weight": float(motion.system.weight(motion.p)),
        "period": motion.step.period,
        "step_length": 0.0 if impact is None else impact.step_length,
        "impulse_ratio": ratio,
        "shape": list(motion.system.walker.shape),
        "actuators": list(motion.system.walker.actuators),
        "phases": _phases(arcs),
        "legs": drawing.legs,
        "ties": drawing.ties,
        "discs": drawing.discs,
        "frames": pack(_columns(motion, arcs, drawing)),
    }


def _phases(arcs: list[Arc]) -> list[dict[str, Any]]:
    """Mode, times and first and last frame of every arc."""
    ends = np.cumsum([len(arc.times) for arc in arcs])
    return [
        {
            "mode": str(arc.mode),
            "start": arc.start,
            "end": arc.end,
            "first": int(end - len(arc.times)),
            "last": int(end - 1),
        }
        for arc, end in zip(arcs, ends, strict=True)
    ]


def _columns(motion: Motion, arcs: list[Arc], drawing: Skeleton) -> dict[str, Any]:
    observed = [motion.observe(arc) for arc in arcs]
    force = np.vstack([o.force for o in observed])
    torque = np.vstack([o.torque for o in observed])
    states = np.vstack([arc.states for arc in arcs])
    columns = {"f_t": force[:, 0], "f_n": force[:, 1]}
    for name in motion.system.walker.shape:
        columns |= {key: states[:, motion.state_index(key)] for key in (name, f"d{name}")}
    columns |= {f"torque {name}": torque[:, k] for k, name in enumerate(motion.system.walker.actuators)}
    for k in range(drawing.points.shape[1]):
        columns |= {f"x{k}": drawing.points[:, k, 0], f"y{k}": drawing.points[:, k, 1]}
    return columns
