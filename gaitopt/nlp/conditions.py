"""What joins the arcs of a cycle: the event that ends every phase, the resets of impacts, periodicity.

    events       v_t = 0 where a slip ends, mu f_n +- f_t = 0 where a stick ends, guard = 0 at touchdown
    resets       z_start = impact(z_end)    at every impact; of a foot, with x counted from the new stance foot

A slip that starts at rest is also at rest after no time at all; its event is divided by that zero, which leaves the
real end and keeps the equations regular where the slip comes into being. None of this depends on the intervals.
"""

from collections.abc import Iterator
from functools import lru_cache

from casadi import SX, Function, densify, jacobian, sum1, vec, vertcat

from gaitopt.mechanics import Cycle, HybridSystem, Mode, ending_margin, margin_names


@lru_cache(maxsize=64)
def conditions(system: HybridSystem, cycle: Cycle, segments: tuple[int, ...], free: tuple[str, ...]) -> Function:
    """(ends, starts, durations, freed, p) -> events of all phases, then resets; shape (n_phases + n_z n_resets,).

    Parameters
    ----------
    segments : of the control, at the end of every phase.
    free : dotted keys of the parameters that are unknowns; their values in ``p`` are ignored.

    Returns
    -------
    function : of the states at the end of every phase, shape (n_z, n_phases), and after every reset, (n_z, n_resets).
    """
    ends, starts = SX.sym("ends", system.n_z, len(cycle.phases)), SX.sym("starts", system.n_z, len(cycle.resets))
    durations, freed = SX.sym("durations", len(cycle.phases)), SX.sym("freed", len(free))
    p = SX.sym("p", len(system.parameters))
    full = vertcat(*(freed[free.index(key)] if key in free else p[k] for k, key in enumerate(system.parameters)))
    standing = [system.walker.standing(full, system.walker.side(step)) for step in range(len(cycle.steps))]
    rows = []
    for phase, (mode, name, order) in enumerate(endings(system, cycle)):
        step = cycle.step_of(phase)
        time = sum1(durations[cycle.first_phases[step] : phase + 1])
        margins = system.margins(mode)(time, ends[:, phase], standing[step], system.data(segments[phase]))
        rows.append(margins[margin_names(mode).index(name)] / durations[phase] ** order)
    for k, (phase, impact) in enumerate(cycle.resets):
        z_plus = system.impact(impact)(z=ends[:, phase], p=standing[cycle.step_of(phase)])["z_plus"]
        if not impact.locked:  # counted from the new stance foot
            z_plus[system.n_shape] = 0
        rows.append(starts[:, k] - z_plus)
    return Function("conditions", [ends, starts, durations, freed, p], [densify(vertcat(*rows))])


@lru_cache(maxsize=64)
def differentiated(system: HybridSystem, cycle: Cycle, segments: tuple[int, ...], free: tuple[str, ...]) -> Function:
    """The same with a second output: the sparse Jacobian by (ends, starts, durations, freed), in columns."""
    function = conditions(system, cycle, segments, free)
    inputs = function.sx_in()
    (values,) = function.call(inputs)
    return Function("differentiated", inputs, [values, jacobian(values, vertcat(*map(vec, inputs[:-1])))])


def endings(system: HybridSystem, cycle: Cycle) -> Iterator[tuple[Mode, str, int]]:
    """Mode of every phase, the margin that ends it, and the order of the zero that this margin starts from."""
    jump = system.friction.two_coefficients
    for phase, mode in enumerate(cycle.phases):
        name = ending_margin(mode, cycle.after(phase))
        yield mode, name, cycle.onset_order(phase, jump=jump) if name == "slip_velocity" else 0
