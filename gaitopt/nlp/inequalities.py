"""The inequalities of a transcription: margins at every node, at the onset of slip, at take-off, and of the impacts."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from casadi import MX, vec

from gaitopt.mechanics import Mode, ending_margin, margin, margin_names
from gaitopt.nlp.units import Label

if TYPE_CHECKING:
    from gaitopt.nlp.multiple_shooting import MultipleShooting

GROUND_FORCES = ("normal_force", "cone_forward", "cone_backward")
"""Margins that are zero where the spring of a massless leg has its full length: at landing and take-off."""


def inequalities(t: "MultipleShooting") -> Iterator[tuple[MX, list[Label]]]:
    """Blocks of margins that must not be negative, and what every row says."""
    yield from _node_margins(t)
    for row, label in (*_unloaded_margins(t), *_onset_margins(t), *impact_margins(t)):
        yield row, [label]


def _node_margins(t: "MultipleShooting") -> Iterator[tuple[MX, list[Label]]]:
    """Inequality factors of every arc at its nodes, without those that an event makes zero."""

    def columns(i: int) -> list[MX]:
        arc, Z, start, h = t.arc(i)
        times = start + h * MX(np.arange(arc.intervals + 1)).T
        return [times, Z, *t.constants(arc, arc.intervals + 1)]

    for i, margins in enumerate(t.map_arcs(t.system.margins, columns)):
        arc, first, names = t.layout.arcs[i], t.layout.first_nodes[i], margin_names(t.layout.arcs[i].mode)
        places = [
            (row, k, name)
            for row, name in enumerate(names)
            for k in range(arc.intervals + 1)
            if name != "upright" and not margin(name).rises and not is_zero_by_event(t, i, k, name)
        ]
        rows = vec(margins)[[row + k * len(names) for row, k, _ in places]]
        yield rows, [Label(name=name, phase=arc.phase, node=first + k) for _, k, name in places]


def _unloaded_margins(t: "MultipleShooting") -> Iterator[tuple[MX, Label]]:
    """Rates of the ground's forces where a massless leg lands and takes off; the forces are zero there."""
    for i, (arc, first) in enumerate(zip(t.layout.arcs, t.layout.first_nodes, strict=True)):
        for k, sign in ((0, 1), (arc.intervals, -1)):
            if not _unloaded(t, i, k):
                continue
            _, Z, start, h = t.arc(i)
            data = t.system.data(arc.segment)
            _, rates = t.system.events(arc.mode)(start + k * h, Z[:, k], t.p, data)
            for name in GROUND_FORCES:
                rate = rates[margin_names(arc.mode).index(name)]
                yield sign * rate, Label(name=name, phase=arc.phase, node=first + k)


def _unloaded(t: "MultipleShooting", index: int, k: int) -> bool:
    """Whether node ``k`` of an arc is the landing or the take-off of a massless leg."""
    arc, cycle = t.layout.arcs[index], t.layout.cycle
    if not t.system.walker.massless_feet or arc.mode.flies:
        return False
    after = cycle.after(arc.phase)
    lands = k == 0 and arc.start is None and arc.phase in cycle.first_phases
    return lands or (k == arc.intervals and arc.end is None and after is not None and after.flies)


def is_zero_by_event(t: "MultipleShooting", index: int, k: int, name: str) -> bool:
    """Whether an event makes a margin zero at node ``k`` of an arc."""
    arc, cycle = t.layout.arcs[index], t.layout.cycle
    if k == 0 and arc.start is None and name == "slip_velocity":
        return cycle.onset_order(arc.phase) > 0
    if name in GROUND_FORCES and _unloaded(t, index, k):
        return True
    after = cycle.after(arc.phase)
    return k == arc.intervals and arc.end is None and after is not None and name == ending_margin(arc.mode, after)


def _onset_margins(t: "MultipleShooting") -> Iterator[tuple[MX, Label]]:
    """Force beyond the static cone where a slip starts from rest; one coefficient leaves no doubt about it."""
    if not t.system.friction.two_coefficients:
        return
    for i, (arc, first) in enumerate(zip(t.layout.arcs, t.layout.first_nodes, strict=True)):
        if arc.start is None and t.layout.cycle.starts_from_rest(arc.phase):
            _, Z, start, _ = t.arc(i)
            data = t.system.data(arc.segment)
            margins = t.system.margins(Mode.STICK)(start, Z[:, 0], t.standing(arc.phase), data)
            cone = margins[margin_names(Mode.STICK).index(ending_margin(Mode.STICK, arc.mode))]
            yield -cone, Label(name="onset", phase=arc.phase, node=first)


def impact_margins(t: "MultipleShooting") -> Iterator[tuple[MX, Label]]:
    """Margins of the impacts."""
    for (phase, mode), node in zip(t.layout.cycle.resets, t.layout.reset_nodes, strict=True):
        values = t.system.impact_margins(mode)(t.Z[:, node], t.standing(phase))
        place = {"phase": phase, "node": node} if mode.locked else {"step": t.layout.cycle.step_of(phase)}
        for row, name in enumerate(t.system.impact_margin_names(mode)):
            yield values[row], Label(name=name, **place)
