"""The steps of a gait, a simulated walk or a stored record, sampled as figures and pages draw them.

The motion of a record is integrated from its state after impact. Two motions, such as those of the NLP and of the
simulation, are compared arc by arc at equal fractions of each arc.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Any

import numpy as np
from numpy.polynomial import chebyshev

from gaitopt.arrays import Array
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait
from gaitopt.gait.trajectory import Arc, Step
from gaitopt.model.declaration import actuator_units
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.section import CLOCK, TOUCHDOWN, cycle_end
from gaitopt.model.units import MOTOR_WORDS
from gaitopt.model.walker import Walker
from gaitopt.problem.floor import Floor
from gaitopt.show.style import Label
from gaitopt.simulation.simulator import Simulator
from gaitopt.store.gaits import POINTS, integrated_steps
from gaitopt.verification.walk import Walk

POINTS_SHOWN = 20
"""Largest number of markers of a gait's points; more would hide the curve."""
FEWEST_POINTS = 120
"""Smallest number of points of an arc that is drawn as a smooth line."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Consecutive steps to be drawn; the first step of a gait begins where the last one ends.

    Attributes
    ----------
    name : name in legends.
    dynamics : the hybrid system that moves, at its parameters.
    steps : steps with their arcs at Chebyshev points and the impact at their end; the last step of a walk may have no
        impact.
    periodic : whether the motion repeats itself.
    floor : the tiles of a walk; None for the nominal floor.
    """

    name: str
    dynamics: Dynamics
    steps: tuple[Step, ...]
    periodic: bool = True
    floor: Floor | None = None

    @property
    def walker(self) -> type[Walker]:
        """The class of the walker."""
        return self.dynamics.system.walker

    @property
    def modes(self) -> list[Mode]:
        """Modes of all phases in order."""
        return [mode for step in self.steps for mode, _ in step.phases]

    @property
    def period(self) -> float:
        """Duration of the whole cycle [s]."""
        return sum(step.period for step in self.steps)

    def state_index(self, name: str) -> int:
        """Column of a state in ``Arc.states``."""
        return self.dynamics.system.state_names.index(name)


def motion_of(gait: Gait, name: str = "") -> Motion:
    """The steps of a converged gait."""
    return Motion(name=name or gait.problem.name, dynamics=gait.dynamics, steps=gait.motion)


def motion_of_walk(walk: Walk) -> Motion:
    """All steps of a simulated walk; the last one may end without an impact.

    Raises
    ------
    ValueError
        If the walk ended before anything moved.
    """
    if not walk.trajectory.steps:
        raise ValueError(f"{walk.problem.name}: the walk ended before it began: {walk.trajectory.message}")
    steps = walk.trajectory.steps
    return Motion(name=walk.problem.name, dynamics=walk.dynamics, steps=steps, periodic=False, floor=walk.floor)


def motion_from_record(dynamics: Dynamics, record: Mapping[str, Any], name: str = "", points: int = POINTS) -> Motion:
    """The steps of a JSON record, integrated from the state after impact with the modes and durations.

    Parameters
    ----------
    dynamics : dynamics at the parameters of the record.
    record : a gait or a point of a branch, with the keys ``state``, ``phases`` and ``impact``, or ``steps``.
    points : number of Chebyshev points of every phase.
    """
    steps = integrated_steps(dynamics, record, points)
    return Motion(name=name or str(record["problem"]), dynamics=dynamics, steps=steps)


def resampled(arc: Arc, count: int = 0) -> Arc:
    """The same arc at ``count`` equidistant times, or at those of ``resampled_points``."""
    s = np.linspace(-1, 1, count) if count else resampled_points(arc)
    if len(arc.times) == 2:  # so short that it is straight
        states = arc.states[0] + (s[:, None] + 1) / 2 * (arc.states[-1] - arc.states[0])
    else:
        states = np.asarray(chebyshev.chebval(s, curves.coefficients(arc.states)).T)
    return replace(arc, times=arc.start + arc.duration * (s + 1) / 2, states=states)


def resampled_points(arc: Arc) -> Array:
    """Points in [-1, 1] along an arc, dense at its ends and close enough that a line through them looks smooth."""
    return np.asarray(np.sin(np.linspace(-1, 1, max(FEWEST_POINTS, 3 * len(arc.times))) * np.pi / 2))


def smooth(steps: Sequence[Step]) -> Iterator[tuple[float, Arc]]:
    """Every arc with the start time of its step [s], at points for a smooth line."""
    for began, step in with_start_times(steps):
        yield from ((began, resampled(arc)) for arc in step.arcs)


def with_start_times(steps: Sequence[Step]) -> Iterator[tuple[float, Step]]:
    """Every step with its start time, counted from the start of the first step [s]."""
    return zip(accumulate((step.period for step in steps[:-1]), initial=0.0), steps, strict=True)


def motor_label(motions: Sequence[Motion]) -> str:
    """Label of an axis for the motors: torques, or forces of motors that act on lengths."""
    units = {unit for motion in motions for unit in actuator_units(motion.walker).values()}
    return ", ".join(f"{MOTOR_WORDS[unit]} [{unit}]" for unit in sorted(units, reverse=True))


def cycle_sentence(motion: Motion) -> str:
    """The sentence that says when the gait repeats itself."""
    system, steps = motion.dynamics.system, len(motion.steps)
    if system.cycle_end == TOUCHDOWN:
        after = f"every {cycle_end(system)}" if steps == 1 else f"{steps} steps"
        return f"The gait repeats itself after {after}."
    if system.cycle_end == CLOCK:
        return f"The gait repeats itself after {motion.period:.6g} s, a period of its control law."
    return f"A cycle ends where the margin {system.cycle_end.replace('_', ' ')} falls to zero."


def time_label(motions: Sequence[Motion]) -> str:
    """Label of the time axis, which counts from the impact or landing, or from the start of steps or of a cycle."""
    landing = all(motion.dynamics.system.cycle_end == TOUCHDOWN for motion in motions)
    single = landing and all(len(motion.steps) == 1 for motion in motions)
    ends = dict.fromkeys(cycle_end(motion.dynamics.system) for motion in motions)
    return str(Label(name=f"time since {' or '.join(ends) if single else 'the start'}", unit="s"))


def position_label(motions: Sequence[Motion]) -> str:
    """Label of an axis with positions: angles, and lengths of walkers that fly or have sliding joints."""
    lengths = any(motion.walker.lengths or "y" in positions_of(motion) for motion in motions)
    return "angle [rad], length [m]" if lengths else "angle [rad]"


def simulated(gait: Gait) -> tuple[Step, ...]:
    """The steps of a forward simulation from the gait's state, which finds the modes itself."""
    return Simulator(gait.dynamics).run(gait.state, steps=len(gait.steps), dense=True).steps


def positions_of(motion: Motion) -> tuple[str, ...]:
    """The shape coordinates, and the height of the foot of walkers that fly."""
    return tuple(name for name in motion.dynamics.system.state_names if name in (*motion.walker.shape, "y"))


def differences(ours: Sequence[Step], theirs: Sequence[Step]) -> Iterator[tuple[Array, Array]]:
    """Times since the start and differences of the states on each arc, at equal fractions of its duration."""
    pairs = zip(with_start_times(ours), theirs, strict=False)
    arcs = ((began, *pair) for (began, step), other in pairs for pair in zip(step.arcs, other.arcs, strict=False))
    for began, mine, other in arcs:
        if mine.mode is not other.mode or mine.duration <= 0:
            return
        fractions = 2 * (mine.times - mine.start) / mine.duration - 1
        states = chebyshev.chebval(fractions, curves.coefficients(other.states)).T
        yield began + mine.times, mine.states - np.asarray(states, dtype=np.float64)


def points_of(steps: Sequence[Step]) -> tuple[Array, Array]:
    """Times since the start of the first step (n,) and states (n, n_z) at all points of some steps."""
    arcs = [(began, arc) for began, step in with_start_times(steps) for arc in step.arcs]
    return np.concatenate([began + arc.times for began, arc in arcs]), np.vstack([arc.states for _, arc in arcs])


def thinned(times: Array, states: Array) -> tuple[Array, Array]:
    """At most ``POINTS_SHOWN`` of many points: the first, the last, and others evenly spaced by number."""
    shown = np.unique(np.linspace(0, len(times) - 1, min(len(times), POINTS_SHOWN)).round().astype(int))
    return times[shown], states[shown]
