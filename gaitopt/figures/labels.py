"""Names and units of everything that can stand on an axis or in a table; the one place that spells them."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """How a quantity is written."""

    words: str
    unit: str = ""

    def __str__(self) -> str:
        return f"{self.words} [{self.unit}]" if self.unit else self.words


QUANTITIES = {
    "spectral_radius": Label(words="largest multiplier modulus |λ|"),
    "period": Label(words="period", unit="s"),
    "step_length": Label(words="step length", unit="m"),
    "speed": Label(words="speed", unit="m/s"),
    "work": Label(words="motor work per step", unit="J"),
    "damping_loss": Label(words="energy that the dampers take", unit="J"),
    "cost_of_transport": Label(words="cost of transport"),
    "absolute_cost_of_transport": Label(words="absolute cost of transport"),
    "torque_squared": Label(words="squared torque per step", unit="N²m²s"),
    "peak_torque": Label(words="peak torque", unit="N m"),
    "slip_distance": Label(words="slip distance per step", unit="m"),
    "foot_clearance": Label(words="foot clearance", unit="m"),
    "required_friction": Label(words="friction required while sticking"),
    "impulse_ratio": Label(words="impulse ratio required to stick"),
    "min_normal_force": Label(words="smallest normal force", unit="N"),
    "friction": Label(words="coefficient of friction μ"),
    "time": Label(words="time since impact", unit="s"),
    "force_ratio": Label(words="force ratio σ = f_t / f_n"),
}
"""Scalars of a gait by their key in the JSON record, and what is drawn over time."""

UNITS = {
    "leg_length": "m",
    "leg_com": "m",
    "radius": "m",
    "leg_mass": "kg",
    "hip_mass": "kg",
    "mass": "kg",
    "gravity": "m/s²",
    "slope": "rad",
    "ankle": "N m",
    "hip": "N m",
    "kp": "N m/rad",
    "kd": "N m s/rad",
    "x": "m",
    "dx": "m/s",
}
"""Units of parameters by the last part of their dotted key, and of the foot's coordinate."""

_SUBSCRIPTS = str.maketrans("0123456789", "₀₁₂₃₄₅₆₇₈₉")


def symbol(state: str) -> str:
    """A state's name as it is written: ``dtheta1`` becomes θ̇₁."""
    rate = state.startswith("d") and len(state) > 1
    name = state[1:] if rate else state
    stem = name.rstrip("0123456789")
    greek = {"theta": "θ", "phi": "φ", "psi": "ψ", "alpha": "α"}.get(stem, stem)
    written = greek + name[len(stem) :].translate(_SUBSCRIPTS)
    return (written[0] + "\u0307" + written[1:]) if rate and len(greek) == 1 else ("d" + written if rate else written)


def label(key: str) -> Label:
    """Label of a scalar, a state or a parameter by its key; what is unknown keeps its key."""
    if key in QUANTITIES:
        return QUANTITIES[key]
    last = key.rpartition(".")[2]
    words = last.replace("_", " ")
    return Label(words=f"{words} torque" if UNITS.get(last) == "N m" else words, unit=UNITS.get(last, ""))
