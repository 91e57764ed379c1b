"""The forward hybrid simulator: from a state after impact to any number of steps, without knowing the mode sequence.

On every arc one mode holds and dz/dt = flow_mode(t, z, p, r) is integrated to its first event; at the event the next
mode follows from the forces, and at touchdown the impact from the impulses. Gamus & Or (2013), section II.
"""

from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import NamedTuple

import numpy as np

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.gait.trajectory import Arc, ImpactRecord, Step, Trajectory
from gaitopt.model.dynamics import Dynamics
from gaitopt.model.modes import Mode
from gaitopt.model.transitions import CANNOT_SLIP, Ending, Transition
from gaitopt.simulation.contact_resolver import ContactResolver, Termination
from gaitopt.simulation.events import AT_REST
from gaitopt.simulation.natural import units
from gaitopt.simulation.scipy_stepper import ATOL, RTOL, ScipyStepper
from gaitopt.simulation.stepper import Arrival, Stepper, sample

MAX_STEP_TIME = 50.0
"""A walker that has not touched down by then, in units of sqrt(l / g), no longer walks: 20 s for legs of 1.6 m."""
MAX_SWITCHES = 50
"""Mode switches within a step after which it is called chattering; walking takes a handful."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StepOutcome:
    """One simulated step.

    Attributes
    ----------
    step : the arcs and the impact; None when the motion ended before any time had passed.
    ending : ``completed`` when the step ended with an impact, else why the motion ended.
    message : the same in words, with time and state.
    """

    step: Step | None
    ending: Ending
    message: str


class _Moment(NamedTuple):
    """How far a step has come."""

    time: float
    state: Array
    segment: int
    switches: int


class Simulator:
    """Simulates one walker under one control law at fixed parameters.

    Parameters
    ----------
    dynamics : the walker under its control law, at its parameters.
    rtol, atol : tolerances of the default stepper, ``atol`` in natural units.
    max_step_time : longest time from impact to impact [s]; ``MAX_STEP_TIME`` natural units unless given.
    max_switches : largest number of mode switches within a step.
    stepper : what integrates the arcs; scipy's DOP853 unless given.

    Attributes
    ----------
    dynamics, system : as given.

    Raises
    ------
    ValueError
        If the parameters do not have one finite value per parameter of the system.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        *,
        rtol: float = RTOL,
        atol: float = ATOL,
        max_step_time: float | None = None,
        max_switches: int = MAX_SWITCHES,
        stepper: Stepper | None = None,
    ) -> None:
        _finite_vector("parameters", dynamics.p, dynamics.system.parameters)
        self.dynamics = dynamics
        self.system = system = dynamics.system
        self._max_switches, self._max_step_time = max_switches, max_step_time
        self.stepper = ScipyStepper(dynamics, rtol=rtol, atol=atol) if stepper is None else stepper
        self._table = system.transitions
        self._resolver = ContactResolver(dynamics)
        self._units = units(dynamics)
        longest = MAX_STEP_TIME * self._units.time if max_step_time is None else max_step_time
        self._limit = min(longest, system.control.horizon)
        self._ends = (*(t for t in system.control.breakpoints if t < self._limit), self._limit)

    @cached_property
    def per_step(self) -> tuple["Simulator", ...]:
        """The simulators of the steps in turn, one for each of ``dynamics.steps``: itself first."""
        longest, switches = self._max_step_time, self._max_switches
        others = (
            Simulator(dynamics, max_step_time=longest, max_switches=switches, stepper=self.stepper.at(dynamics))
            for dynamics in self.dynamics.steps[1:]
        )
        return (self, *others)

    def run(
        self,
        state: Array,
        steps: int = 1,
        *,
        dense: bool = False,
        should_stop: Stop = None,
    ) -> Trajectory:
        """Simulate up to ``steps`` steps from a state just after an impact.

        Parameters
        ----------
        state : ndarray, shape (n_z,) - (shape [rad], x [m], rates [rad/s], dx [m/s]); x is counted from zero.
        steps : number of steps.
        dense : sample every arc at Chebyshev points instead of its two ends.
        should_stop : called before every step; True ends the trajectory with the steps completed so far.

        Raises
        ------
        ValueError
            If ``state`` does not have one finite value per state of the system, or ``steps`` is less than one.
        """
        if steps < 1:
            raise ValueError(f"steps = {steps}: at least one step is needed")
        start = z = self._after_impact(state)
        completed: list[Step] = []
        ending = Ending.COMPLETED
        while len(completed) < steps:
            if should_stop is not None and should_stop():
                message = f"{len(completed)} of {steps} steps, then stopped on request"
                break
            simulator = self.per_step[len(completed) % len(self.per_step)]
            outcome = simulator.step(z, dense=dense, number=len(completed) + 1)
            if outcome.step is not None:
                completed.append(outcome.step)
            if outcome.step is None or outcome.step.impact is None:
                ending, message = outcome.ending, outcome.message
                break
            z = outcome.step.impact.state
        else:
            message = f"{steps} of {steps} steps"
        return Trajectory(
            names=self.system.state_names, start=start, steps=tuple(completed), ending=ending, message=message
        )

    def step(self, state: Array, *, dense: bool = False, number: int = 1) -> StepOutcome:
        """Simulate one step from a state just after an impact; ``number`` is its number in the message."""
        moment = _Moment(0.0, self._after_impact(state), 0, 0)
        mode: Mode | None = None
        following: Mode | ImpactRecord | Termination = self._first_mode(moment)
        arcs: list[Arc] = []
        while isinstance(following, Mode):
            mode = following
            arrival = self._advance(mode, moment)
            if arrival.time > moment.time:
                arcs.append(self._arc(mode, moment, arrival, dense))
            following, moment = self._follow(mode, moment, arrival)
        if isinstance(following, ImpactRecord):
            step = Step(arcs=tuple(arcs), impact=following)
            return StepOutcome(step=step, ending=Ending.COMPLETED, message=f"step {number} completed")
        incomplete = Step(arcs=tuple(arcs), impact=None) if arcs else None
        return StepOutcome(
            step=incomplete, ending=following.ending, message=self._describe(following, number, mode, moment)
        )

    def _after_impact(self, state: Array) -> Array:
        z = _finite_vector("state", state, self.system.state_names)
        z[self.system.n_shape] = 0.0
        return _at_rest(z) if abs(z[-1]) <= AT_REST * self._units.speed else z

    def _first_mode(self, moment: _Moment) -> Mode | Termination:
        slip_velocity = moment.state.item(-1)
        if slip_velocity == 0:
            return self._mode_at_rest(self._table.at_rest(self._table.landed[0]), moment)
        slips = [mode for mode in self._table.landed if mode.direction * slip_velocity > 0]
        return slips[0] if slips else Termination(Ending.PAINLEVE, CANNOT_SLIP)

    def _mode_at_rest(self, candidates: tuple[Mode, ...], moment: _Moment) -> Mode | Termination:
        data = self.system.data(moment.segment)
        return self._resolver.mode_at_rest(candidates, moment.time, moment.state, data)

    def _touchdown(self, mode: Mode, moment: _Moment) -> Transition | None:
        """The end of the step where it falls on a breakpoint of the control; the arc that follows could not see it."""
        return self._resolver.touchdown(mode, moment.time, moment.state, self.system.data(moment.segment))

    def _advance(self, mode: Mode, moment: _Moment) -> Arrival:
        """The arc from here to its first event, the control's next breakpoint or the time limit."""
        end, data = self._ends[moment.segment], self.system.data(moment.segment)
        arrival = self.stepper.advance(mode, data, moment.time, moment.state, end)
        stops = arrival.event is not None and self._table.of(mode)[arrival.event].at_rest
        return arrival._replace(state=_at_rest(arrival.state)) if stops else arrival

    def _arc(self, mode: Mode, moment: _Moment, arrival: Arrival, dense: bool) -> Arc:
        times, states = np.array([moment.time, arrival.time]), np.array([moment.state, arrival.state])
        if dense:
            data = self.system.data(moment.segment)
            times, states = sample(self.stepper, self._units, mode, data, moment.time, arrival.time, moment.state)
            states[-1] = arrival.state
        return Arc(dynamics=self.dynamics, mode=mode, segment=moment.segment, times=times, states=states)

    def _follow(
        self, mode: Mode, moment: _Moment, arrival: Arrival
    ) -> tuple[Mode | ImpactRecord | Termination, _Moment]:
        """What comes after an arc: a mode, the impact, or the end of the motion; and the moment it begins."""
        here = _Moment(arrival.time, arrival.state, moment.segment, moment.switches)
        if arrival.failure:
            return Termination(Ending.NUMERICAL, arrival.failure), here
        transition = self._touchdown(mode, here) if arrival.event is None else self._table.of(mode)[arrival.event]
        if transition is None:
            return self._pass_breakpoint(mode, here)
        if transition.ending is not None:
            return Termination(transition.ending, transition.reason), here
        if transition.ends_step:
            return self._resolver.impact(here.state), here
        here = here._replace(switches=moment.switches + 1)
        if here.switches > self._max_switches:
            return Termination(Ending.CHATTERING, f"more than {self._max_switches} mode switches in one step"), here
        if transition.reset is not None:
            return self._strike(transition, here)
        if transition.at_rest:
            return self._mode_at_rest(transition.candidates, here), here
        return transition.candidates[0], here

    def _strike(self, transition: Transition, moment: _Moment) -> tuple[Mode | Termination, _Moment]:
        """What follows the impact of a stop, and the moment after it."""
        struck = self._resolver.strike(transition, moment.state)
        if isinstance(struck, Termination):
            return struck, moment
        mode, state = struck
        return self._decided_again(mode, moment._replace(state=state))

    def _decided_again(self, mode: Mode, moment: _Moment) -> tuple[Mode | Termination, _Moment]:
        """The mode of a foot at rest follows from the forces; any other mode goes on."""
        return (self._mode_at_rest(self._table.at_rest(mode), moment) if mode.sticks else mode), moment

    def _pass_breakpoint(self, mode: Mode, moment: _Moment) -> tuple[Mode | Termination, _Moment]:
        """The next segment of the control; its torques may jump, and the mode of a foot at rest is decided again."""
        if moment.segment == len(self._ends) - 1:
            where = ", where the control law ends" if self._limit == self.system.control.horizon else ""
            return Termination(Ending.NO_TOUCHDOWN, f"no touchdown within {self._limit:g} s{where}"), moment
        moment = moment._replace(segment=moment.segment + 1)
        return self._decided_again(mode, moment)

    def _describe(self, termination: Termination, number: int, mode: Mode | None, moment: _Moment) -> str:
        values = ", ".join(
            f"{name} = {value:.6g}" for name, value in zip(self.system.state_names, moment.state, strict=True)
        )
        where = "in mode " + mode if mode is not None else "at the choice of the first mode"
        return f"{termination.reason}: step {number}, {moment.time:.6g} s after the impact, {where}, at {values}"


def _at_rest(state: Array) -> Array:
    """The state with the slip velocity exactly zero; what was left of it is rounding."""
    state = state.copy()
    state[-1] = 0.0
    return state


def _finite_vector(what: str, values: Array, names: tuple[str, ...]) -> Array:
    """A copy of ``values`` as a vector with one finite entry per name."""
    vector = np.array(values, dtype=float)
    if vector.shape != (len(names),):
        raise ValueError(f"{what} of shape {vector.shape}: one value is needed for each of {', '.join(names)}")
    if not all(map(isfinite, vector.tolist())):
        wrong = (f"{name} = {value}" for name, value in zip(names, vector, strict=True) if not isfinite(value))
        raise ValueError(f"{what} must be finite, not {', '.join(wrong)}")
    return vector
