"""A problem stated in other units of length, time and mass."""

import numpy as np

import gaitopt as go
from gaitopt import Gait
from gaitopt.gait.measures import measure_scales

DIMENSIONS = {
    "leg_length": (1, 0, 0), "leg_com": (1, 0, 0), "radius": (1, 0, 0), "leg_mass": (0, 0, 1), "hip_mass": (0, 0, 1),
    "mass": (0, 0, 1), "gravity": (1, -2, 0), "ankle": (2, -2, 1), "hip": (2, -2, 1), "kp": (2, -2, 1),
    "kd": (2, -1, 1), "body_mass": (0, 0, 1), "slider_mass": (0, 0, 1), "leg_stiffness": (0, -2, 1),
    "slider_stiffness": (0, -2, 1), "thrust": (1, -2, 1),
}  # fmt: skip
"""Exponents of length, time and mass; angles, ratios and counts have none."""


def factor(name: str, units: tuple[float, float, float]) -> float:
    """The factor by which a parameter is multiplied."""
    return float(np.prod(np.power(np.array(units, dtype=float), DIMENSIONS.get(name, (0, 0, 0)))))


def rescaled(problem: go.Problem, units: tuple[float, float, float]) -> go.Problem:
    """The same walk with lengths, times and masses multiplied by ``units``."""
    changed = {
        key: value * factor(key.rsplit(".", 1)[-1], units)
        for key, value in problem.parameters.items()
        if key.rsplit(".", 1)[-1] in DIMENSIONS
    }
    length, time, _ = units
    state = {}
    for name, value in problem.guess.state.items():
        rate = name.startswith("d")
        state[name] = value * (length if name in ("x", "dx") else 1.0) / (time if rate else 1.0)
    sliding = problem.cycle.impact.direction != 0
    names = type(problem.walker).section_names(slipping=sliding)
    guess = {f"gait.guess.state.{name}": state[name] for name in names}
    durations = problem.guess.durations
    guess |= {} if durations is None else {"gait.guess.durations": [time * duration for duration in durations]}
    return problem.replace({**changed, **guess})


def dimensionless(gait: Gait) -> np.ndarray:
    """State after impact, durations and scalars in natural units, and multipliers."""
    scales = gait.dynamics.scales
    units = measure_scales(scales)
    return np.concatenate(
        [
            gait.state / gait.dynamics.state_units,
            np.array([duration for _, duration in gait.phases]) / scales.time,
            [(np.nan if value is None else value) / units[name] for name, value in gait.measures.items()],
            gait.multipliers.real,
            gait.multipliers.imag,
        ]
    )
