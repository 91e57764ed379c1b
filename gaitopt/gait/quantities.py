"""Names and units of the scalars and states of a result; the one table behind printed tables and data frames."""

from gaitopt.mechanics import registered_walkers

QUANTITIES = {
    "friction": ("friction coefficient", ""),
    "period": ("period", "s"),
    "step_length": ("step length", "m"),
    "speed": ("speed", "m/s"),
    "work": ("motor work", "J"),
    "damping_loss": ("energy that the dampers take", "J"),
    "cost_of_transport": ("cost of transport", ""),
    "absolute_cost_of_transport": ("absolute cost of transport", ""),
    "torque_squared": ("torque squared, integral", "N^2 m^2 s"),
    "peak_torque": ("peak torque", "N m"),
    "slip_distance": ("slip distance", "m"),
    "foot_clearance": ("foot clearance", "m"),
    "required_friction": ("required friction in stick", ""),
    "impulse_ratio": ("impulse ratio for a sticking impact", ""),
    "min_normal_force": ("smallest normal force", "N"),
    "spectral_radius": ("largest multiplier, modulus", ""),
}
"""Label and unit of every scalar of a result by its key in the JSON."""
CONTACT_FORCES = ("f_t", "f_n")


def state_unit(name: str) -> str:
    """Unit of a state: the foot's coordinates and what walkers declare as lengths in metres, all else are angles."""
    rate = name.startswith("d")
    lengths = {"x", "y"}.union(*(walker.lengths for walker in registered_walkers().values()))
    return ("m" if name.removeprefix("d" if rate else "") in lengths else "rad") + ("/s" if rate else "")


def column_unit(name: str, actuators: tuple[str, ...] = ()) -> str:
    """Unit of a column of a table of results: a scalar, ``state.NAME``, a time, a force or a torque; else none."""
    if name in QUANTITIES:
        return QUANTITIES[name][1]
    if name.startswith("state."):
        return state_unit(name.removeprefix("state."))
    units = {"t": "s", **dict.fromkeys(CONTACT_FORCES, "N"), **dict.fromkeys(actuators, "N m")}
    return units.get(name, "")
