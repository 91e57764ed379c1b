"""The impacts of a walker that stands on one foot at a time, by the mode of the foot just after them."""

from casadi import Function

from gaitopt import Mode
from gaitopt.building import building
from gaitopt.model.system import HybridSystem


def around(system: HybridSystem, mode: Mode) -> tuple[Mode, Mode]:
    """The impact after which the foot is in a mode, as it is called before it, and the mode before it.

    A mode with locked stops is that after their impact; without stops the swing foot has landed.
    """
    if mode.locked:
        return mode, Mode.of(mode.contact, dict.fromkeys(mode.stops, "free"))
    return system.walker.swapped(mode), Mode.of(Mode.STICK, dict.fromkeys(system.walker.stops, "locked"))


@building
def foot_impact(system: HybridSystem, mode: Mode) -> Function:
    """(z, p) -> z_plus, impulse, slip velocity and lift velocity after the impact, apparent mass of the foot."""
    symbols, (struck, before) = system.expressions, around(system, mode)
    z_plus = symbols.after(struck, before, ends_step=not mode.locked)
    velocities, mass = symbols.foot_velocities(struck, before), symbols.impact(struck, before).apparent_mass
    outputs = [z_plus, symbols.impulse(struck, before), *velocities, mass]
    return Function("foot_impact", [symbols.z, symbols.p], outputs)
