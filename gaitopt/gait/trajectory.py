"""Motion as data: arcs of one mode, steps that end with an impact, and trajectories of many steps."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from casadi import Function
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array, ReadOnlyArrays
from gaitopt.display import Tabulated, counted
from gaitopt.errors import ProblemError
from gaitopt.gait import curves
from gaitopt.gait.frames import data_frame, sample_set
from gaitopt.model.buffered import buffered, buffered_map
from gaitopt.model.cycle import ModeSequence
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.section import TOUCHDOWN
from gaitopt.model.transitions import Ending
from gaitopt.problem.scalars import state_unit

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import Dataset

SHORTEST_SAMPLED_ARC = 1e-6
"""Duration, in units of sqrt(l / g), below which the line between the two ends of an arc is its motion."""
SAME_TIME = 1e-12
"""Largest relative difference of two equal times that rounding can cause."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Arc(ReadOnlyArrays):
    """A smooth piece of motion: one mode on one segment of the control.

    Attributes
    ----------
    dynamics : the hybrid system at the parameters of this step.
    mode : contact mode of the stance foot.
    segment : index of the control's segment.
    times : ndarray, shape (m,) - times since the last impact [s]: Chebyshev points, or only the start and the end.
    states : ndarray, shape (m, n_z) - states at these times.
    struck : the mode just after the impact of a named contact, if the arc begins with one; None otherwise.
    """

    dynamics: Dynamics
    mode: Mode
    segment: int
    times: Array
    states: Array
    struck: Mode | None = None

    def __repr__(self) -> str:
        return f"<Arc {self.mode.brief}, {self.start:.6g} s to {self.end:.6g} s, {counted(len(self.times), 'point')}>"

    @property
    def start(self) -> float:
        """Time since impact at which the arc starts [s]."""
        return float(self.times[0])

    @property
    def end(self) -> float:
        """Time since impact at which the arc ends [s]."""
        return float(self.times[-1])

    @property
    def duration(self) -> float:
        """Duration of the arc [s]."""
        return self.end - self.start


def along(arc: Arc, function: Function) -> tuple[Array, ...]:
    """The outputs of a function (t, z, p, r), or (z, p), at the points of an arc; for their shapes see ``BufferedMap``.

    They are valid until the next call.
    """
    inputs: tuple[Any, ...] = (arc.states, arc.dynamics.p)
    if function.n_in() > len(inputs):
        inputs = (arc.times[:, None], *inputs, arc.dynamics.system.data(arc.segment))
    return buffered_map(function, arc.times.size)(*inputs)


def _interpolated(arc: Arc, time: float) -> Array:
    """The state of an arc at a time since the impact, shape (n_z,), by the polynomial through its points."""
    if arc.times.size == 2 and arc.duration > SHORTEST_SAMPLED_ARC * arc.dynamics.scales.time:
        raise ProblemError("the motion was stored without samples; simulate it with dense=True")
    (sample,) = np.nonzero(arc.times == time)
    if sample.size:
        return arc.states[sample[0]]
    fraction = np.clip(2 * (time - arc.start) / arc.duration - 1, -1, 1)
    return np.asarray(chebyshev.chebval(fraction, curves.coefficients(arc.states)), dtype=float)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpactRecord(ReadOnlyArrays):
    """One impact.

    Attributes
    ----------
    mode : mode of the colliding foot just after the impact; named contacts have swapped roles by then. If the step
        ends without a landing, the mode just before its end.
    state : ndarray, shape (n_z,) - state just after the impact; x is zero, because it counts from the new stance foot.
    step_length : distance of the new stance foot from where the old one stood after its own impact [m].
    impulse : ndarray, shape (2 n,) - (F_t, F_n) of the n contacts, with their names before the impact [N s].
    stick_impulse : ndarray, shape (2,) - impulse of a sticking impact, eq. (9) [N s]. For named contacts it is the sum
        over those that land, if all touching contacts stick.
    push_work : work of the push-off of the other foot just before the impact [J].
    """

    mode: Mode
    state: Array
    step_length: float
    impulse: Array
    stick_impulse: Array
    push_work: float = 0.0

    @property
    def impulse_ratio(self) -> float | None:
        """|F_t| / F_n of a sticking impact; None for a foot that lands without an impulse."""
        tangential, normal = self.stick_impulse.tolist()
        return abs(tangential) / normal if normal else None


def impact_record(
    dynamics: Dynamics, mode: Mode, z_minus: Array, before: Mode, *, lands: bool | None = None
) -> ImpactRecord:
    """The record of the end of a step.

    Parameters
    ----------
    mode : mode of the foot just after it.
    z_minus : ndarray, shape (n_z,) - state just before it.
    before : mode just before it.
    lands : whether the step ends with a landing, after which the feet swap roles; None to follow the section of the
        system.
    """
    system, walker, p, x = dynamics.system, dynamics.system.walker, dynamics.p, dynamics.system.n_shape
    lands = system.cycle_end == TOUCHDOWN if lands is None else lands
    impulse, stick_impulse, state = np.zeros(2 * len(walker.contact_names())), np.zeros(2), z_minus.copy()
    if lands:
        struck = walker.swapped(mode)
        landing = [name for name in struck.touching if name not in before.touching]
        all_stick = struck.with_states(dict.fromkeys(struck.touching, "stick"))
        state, impulse = (value.copy() for value in buffered(system.impact(struck, before))(z_minus, p))
        sticking = buffered(system.impact(all_stick, before))(z_minus, p)[1].reshape(-1, 2)
        indices = [walker.struck_contacts(struck).index(name) for name in landing]
        stick_impulse = sticking[indices].sum(axis=0)
    length, state[x] = float(state[x]), 0.0
    return ImpactRecord(
        mode=mode,
        state=state,
        step_length=length,
        impulse=impulse,
        stick_impulse=stick_impulse,
        push_work=push_work(dynamics, before, z_minus) if lands else 0.0,
    )


def push_work(dynamics: Dynamics, before: Mode, z_minus: Array) -> float:
    """Work of the push-off of the contacts on the ground, from the mode and state just before another one lands [J]."""
    system = dynamics.system
    return float(system.push(before)(z=z_minus, p=dynamics.p)["work"]) if system.walker.pushes else 0.0


def swap_indices(arcs: Iterable[Arc]) -> list[int]:
    """Indices of the arcs, except the first one, that begin with a landing after which the feet swap roles."""
    return [k for k, arc in enumerate(arcs) if k and arc.struck is not None and arc.struck.swaps]


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """The arcs between two impacts, and the impact at their end; None if the motion ended before the impact."""

    arcs: tuple[Arc, ...]
    impact: ImpactRecord | None

    def __repr__(self) -> str:
        phases = ", ".join(mode.brief for mode, _ in self.phases)
        return f"<Step {phases}; {'no impact' if self.impact is None else self.impact.mode.brief}, {self.period:.6g} s>"

    @property
    def phases(self) -> tuple[tuple[Mode, float], ...]:
        """Modes and durations [s]; arcs of one mode without an impact between them are one phase."""
        merged: list[tuple[Mode, float]] = []
        for arc in self.arcs:
            if merged and merged[-1][0] is arc.mode and arc.struck is None:
                merged[-1] = (arc.mode, merged[-1][1] + arc.duration)
            else:
                merged.append((arc.mode, arc.duration))
        return tuple(merged)

    @property
    def landings(self) -> dict[int, Mode]:
        """The mode just after the landing of a contact, by the index of the phase that begins with the landing."""
        arcs = zip(self.arc_phases, self.arcs, strict=True)
        return {phase: arc.struck for phase, arc in arcs if arc.struck is not None}

    @property
    def sequence(self) -> ModeSequence:
        """Phases, landings within the step, and final impact; raises the error of ``final_impact``."""
        modes, landings = tuple(mode for mode, _ in self.phases), self.landings.items()
        return ModeSequence(modes, self.final_impact.mode, landings=tuple((k, mode) for k, mode in landings if k))

    @property
    def arc_phases(self) -> tuple[int, ...]:
        """Index of the phase of every arc; a breakpoint of the control starts a new arc in the same phase."""
        new = [first.mode is not second.mode or second.struck is not None for first, second in pairwise(self.arcs)]
        return tuple(int(k) for k in np.cumsum([0, *new]))

    @property
    def final_impact(self) -> ImpactRecord:
        """The impact that ends the step.

        Raises
        ------
        ValueError
            If the motion ended before the impact.
        """
        if self.impact is None:
            raise ValueError("the motion ended before the impact of its last step")
        return self.impact

    @property
    def period(self) -> float:
        """Time from impact to impact [s]."""
        return self.arcs[-1].end


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory(Tabulated, ReadOnlyArrays):
    """A simulated motion: its steps and its ending.

    Attributes
    ----------
    names : names of the states.
    start : ndarray, shape (n_z,) - state just after an impact, from which it started.
    steps : the steps; the last one may be incomplete.
    ending : why the motion ended.
    message : an explanation with time and state.
    """

    names: tuple[str, ...]
    start: Array
    steps: tuple[Step, ...]
    ending: Ending
    message: str

    def __repr__(self) -> str:
        return f"<Trajectory: {sum(step.impact is not None for step in self.steps)} steps, {self.ending}>"

    @property
    def section_states(self) -> Array:
        """The start, and the states just after each impact; shape (n_impacts + 1, n_z)."""
        return np.vstack([self.start, *(step.impact.state for step in self.steps if step.impact is not None)])

    @property
    def duration(self) -> float:
        """Time from the start to the end [s]."""
        return sum(step.period for step in self.steps)

    @property
    def final_state(self) -> Array:
        """State at the end, shape (n_z,): just after the last impact, or at the end of an incomplete step."""
        last = self.steps[-1] if self.steps else None
        if last is None:
            return self.start
        return last.arcs[-1].states[-1] if last.impact is None else last.impact.state

    def at(self, time: float) -> dict[str, float]:
        """The state at any time by name, in the form that ``simulate`` takes; at an impact, the state just after it.

        x is measured from where the stance foot landed, as in the table.

        Parameters
        ----------
        time : time since the start [s].

        Raises
        ------
        ProblemError
            If the time is outside of the motion, or the motion was stored without samples (``dense=False``).
        """
        end = self.duration
        if not 0 <= time <= end * (1 + SAME_TIME):
            raise ProblemError(f"time {time:g} s is outside of the motion, which lasts from 0 to {end:.9g} s")
        began, z = 0.0, self.start
        for step in self.steps:
            local = time - began
            if local < step.period or (step is self.steps[-1] and step.impact is None):
                z = _interpolated([arc for arc in step.arcs if arc.start <= local][-1], local)
                break
            began, z = began + step.period, step.impact.state if step.impact is not None else step.arcs[-1].states[-1]
        return dict(zip(self.names, z.tolist(), strict=True))

    def to_frame(self) -> "DataFrame":
        """The states as a pandas data frame with time, number of the step, mode; units are in ``attrs["units"]``.

        Forces and torques depend on the parameters and are in the data frame of a walk.
        """
        return data_frame(self._header, self._rows(), self._units, ending=str(self.ending))

    def to_xarray(self) -> "Dataset":
        """The states as an xarray dataset over ``sample``, with units as attributes."""
        return sample_set(self._header, self._rows(), self._units, ending=str(self.ending))

    @property
    def _header(self) -> tuple[str, ...]:
        return ("t", "step", "mode", *self.names)

    @property
    def _units(self) -> dict[str, str]:
        return {"t": "s"} | {name: state_unit(name) for name in self.names}

    def _rows(self) -> Iterator[tuple[float | int | str, ...]]:
        began = 0.0
        for number, step in enumerate(self.steps, start=1):
            for arc in step.arcs:
                for t, state in zip(arc.times.tolist(), arc.states.tolist(), strict=True):
                    yield (began + t, number, str(arc.mode), *state)
            began += step.period
