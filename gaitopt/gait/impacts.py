"""The impacts of a motion with the impulses at all contacts: at the ends of its steps and within them.

M (dq_plus - dq_minus) = sum W_i' F_i
"""

from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import numpy as np

from gaitopt.arrays import Array
from gaitopt.gait.shares import undetermined_in
from gaitopt.gait.trajectory import Trajectory
from gaitopt.model.buffered import buffered
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import FOOT, OFF, Mode
from gaitopt.model.section import TOUCHDOWN

SAME_STATE = 1e-9
"""Largest difference of two equal states that rounding can cause, in SI."""
IMPULSES = ("F_t", "F_n")


def impact_records(motion: Trajectory) -> Iterator[dict[str, Any]]:
    """All impacts of a motion in order, as JSON objects: those that end its steps, and those within steps.

    ``time`` [s] and ``step`` say when the impact happens. ``of`` names what strikes: the ``swing_foot``, contacts or
    stops. ``impact`` is the mode just after it, with the names before the feet swap roles. ``impulse`` has (F_t, F_n)
    [N s] of every contact that touches then, or of the foot; an impulse is None if the equations of the impact do not
    determine it.
    """
    began, z = 0.0, motion.start
    for number, step in enumerate(motion.steps, start=1):
        for before, arc in pairwise((None, *step.arcs)):
            z = z if before is None else before.states[-1]
            assert arc is not None
            locked = [name for name in arc.mode.locked if before is not None and name not in before.mode.locked]
            struck = arc.struck or (arc.mode if locked else None)
            if struck is not None:
                struck = arc.dynamics.system.transitions.struck_within(struck)
                mode_before = None if before is None else before.mode
                of = locked or _landing(arc.dynamics, struck, mode_before, z)
                impulse = _impulse(arc.dynamics, struck, mode_before or _without(struck, of), z, arc.states[0])
                yield _impact_entry(arc.dynamics, began + arc.start, number, of, struck, impulse)
        last = step.arcs[-1]
        if step.impact is not None and last.dynamics.system.cycle_end == TOUCHDOWN:
            walker, after = last.dynamics.system.walker, step.impact.mode
            of = [name for name in walker.swapped(after).touching if name not in last.mode.touching]
            yield _impact_entry(last.dynamics, began + last.end, number, of, walker.swapped(after), step.impact.impulse)
        began, z = began + step.period, z if step.impact is None else step.impact.state


def _landing(dynamics: Dynamics, struck: Mode, before: Mode | None, z: Array) -> list[str]:
    """The contacts that land in an impact; at the start of a motion, those that come down onto the ground."""
    if before is not None:
        return [name for name in struck.touching if name not in before.touching]
    names = dynamics.system.walker.contact_names()
    _, velocities, *_ = buffered(dynamics.system.contact_points)(z, dynamics.p)
    rates = dict(zip(names, velocities.reshape(-1, 2)[:, 1].tolist(), strict=True))
    return [name for name in struck.touching if rates[name] < 0]


def _without(struck: Mode, of: list[str]) -> Mode:
    """The mode before an impact at the start of a motion, in which the contacts ``of`` do not touch yet."""
    off = struck.contact.with_states({name: OFF for name in of if name in struck.contacts})
    return Mode.of(off, {name: "locked" for name in struck.locked if name not in of})


def _impulse(dynamics: Dynamics, struck: Mode, before: Mode, z: Array, z_plus: Array) -> Array | None:
    """Impulses of an impact within a step from the state before it; None if they do not lead to the state after it."""
    function = dynamics.system.impact(struck, before, ends_step=False)
    after, impulse = (value.copy() for value in buffered(function)(z, dynamics.p))
    return impulse if np.allclose(after, z_plus, rtol=SAME_STATE, atol=SAME_STATE) else None


def _impact_entry(
    dynamics: Dynamics, time: float, step: int, of: list[str], mode: Mode, impulse: Array | None
) -> dict[str, Any]:
    """The record of one impact; impulses that the equations of the impact do not determine are None."""
    walker, of_contacts = dynamics.system.walker, dict[str, dict[str, float | None]]()
    open_shares = undetermined_in(walker, mode)
    pairs = [] if impulse is None else impulse.reshape(-1, 2).tolist()
    for name, pair in zip(walker.contact_names(), pairs, strict=False):
        shares = zip((f"f_t.{name}", f"f_n.{name}"), pair, strict=True)
        known = (None if share in open_shares else value for share, value in shares)
        of_contacts[name] = dict(zip(IMPULSES, known, strict=True))
    impulses: Any = None
    if impulse is not None and walker.labels():
        impulses = {name: pair for name, pair in of_contacts.items() if name in mode.touching}
    elif impulse is not None:
        impulses = of_contacts[FOOT]
    written = dynamics.system.transitions.written_impact(mode)
    return {"time": time, "step": step, "of": of, "impact": written.words, "impulse": impulses}
