"""A gait replayed in a physics engine: its runs at different time steps, and whether they converge to the gait.

All runs of one setting share a process, which may crash; ``outcome`` describes what is measured in each run.

    order, order_before_impact   slope of log(state_error), log(error_before_impact) over log(dt) at the three smallest
                                 time steps

The engine is consistent with the gait if its differences tend to zero with the time step. Each difference v(dt) is
extrapolated to zero from two time steps a > b. The changes from one pair to the next bound the error of this limit:

    limit = (a v(b) - b v(a)) / (a - b)        doubt = last change of the limit, or a quarter of the one before
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from gaitopt.callbacks import Stop
from gaitopt.display import counted
from gaitopt.engines.outcome import COMPLETED, Outcome, Simulator
from gaitopt.engines.plant import Reference
from gaitopt.engines.process import outcomes
from gaitopt.errors import ProblemError, UnknownNameError
from gaitopt.gait import curves
from gaitopt.gait.gait import Gait
from gaitopt.gait.measures import observe
from gaitopt.gait.trajectory import Step, swap_indices
from gaitopt.model.transitions import Ending
from gaitopt.problem.faults import shown
from gaitopt.search.solve import solve_walk
from gaitopt.simulation.simulator import Simulator as WalkerSimulator
from gaitopt.systems import problem_dynamics

ENGINES: Mapping[str, str] = {"mujoco": "mujoco", "drake": "pydrake", "pybullet": "pybullet", "siconos": "siconos"}
"""Adapters, and the packages that they import."""
EXTRA = "pip install 'gaitopt[engines]'"
INSTALL = {"siconos": "on Debian: apt install python3-siconos, and a virtual environment with --system-site-packages"}
"""The commands that install engines which are not in the extra ``engines``."""
TIME_STEPS = (0.004, 0.002, 0.001, 0.0005, 0.00025)
"""Default time steps [s]."""
FITTED = 3
"""The order of convergence is fitted to this many of the smallest time steps."""
CONSISTENT_STATE, CONSISTENT_SLIP = 2e-5, 0.01
"""Largest extrapolated differences of a consistent engine: of angles and positions before the impact in natural units,
and of the slip relative to that of the gait. With correct equations, four engines stay below 1.3e-5."""
ALLOWED_DOUBTS = 2.0
"""The limit of a consistent engine may exceed these values by this multiple of its doubt."""
LARGEST_DOUBT = 2e-4
"""Largest doubt of angles and positions with which an engine can be called consistent."""
FRICTION_ERROR = 0.01
"""Relative error of the friction that would have to be noticed before an engine is called consistent."""
NOTICED = 0.8
"""The error of the friction would be noticed if this fraction of its effect exceeds the bound of a difference."""
SECOND_ORDER_RATIO = 0.25
"""Ratio of successive changes of a limit if halving the time step leaves smooth errors of second order."""
SAME_PERIOD = 1e-9
"""Two gaits are the same motion if their periods differ by less than this fraction, and one began with the other."""
PAIRS = 3
"""Number of the finest pairs of time steps whose limits are compared."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """A gait in one engine at one setting.

    Attributes
    ----------
    problem : name of the gait's problem.
    engine, version : name and version of the engine.
    setting : name of the setting.
    settings : values of the setting.
    slip : path of the gait's foot forward and backward [m].
    friction_effect : relative change of these paths if the friction is wrong by 1 %.
    outcomes : one per time step, the largest first.
    """

    problem: str
    engine: str
    version: str
    setting: str
    settings: Mapping[str, Any]
    slip: Mapping[str, float]
    friction_effect: Mapping[str, float]
    outcomes: tuple[Outcome, ...]

    @property
    def order(self) -> float | None:
        """Observed order of convergence of ``state_error``; None with fewer than two time steps."""
        return self._order("state_error")

    def _order(self, name: str) -> float | None:
        known = [(o.dt, getattr(o, name)) for o in self.outcomes if getattr(o, name)]
        if len(known) < 2:
            return None
        steps, errors = np.log(np.array(known[-FITTED:], dtype=float)).T
        return float(np.polyfit(steps, errors, 1)[0])

    @property
    def largest_dt(self) -> float | None:
        """The largest time step at which, and below which, the modes are those of the gait [s]."""
        largest = None
        for outcome in reversed(self.outcomes):
            if not outcome.sequence_matches:
                break
            largest = outcome.dt
        return largest

    @property
    def consistent(self) -> bool | None:
        """Whether the engine converges to the gait as the time step decreases; None if its runs do not decide."""
        return self._judgement[0]

    @property
    def consistent_reason(self) -> str:
        """Why the engine is consistent with the gait or not, or why its runs do not decide."""
        return self._judgement[1]

    @property
    def _judgement(self) -> tuple[bool | None, str]:
        failed = next((o for o in self.outcomes if o.ending != COMPLETED), None)
        if failed is not None:
            return None, f"the run with a time step of {failed.dt:g} s ended: {failed.ending}"
        steps = np.array([o.dt for o in self.outcomes])
        if len(steps) <= PAIRS:
            return None, f"{counted(len(steps), 'time step')}; the extrapolation needs {PAIRS + 1}"
        paths = {way: path for way, path in self.slip.items() if path > 0}
        bodies = len(self.outcomes[0].deviation) // 2 - 1
        angles = [[*o.deviation[:bodies], o.deviation[2 * bodies]] for o in self.outcomes]  # rates at a contact vibrate
        slips = [[o.slip[way] / path - 1 for way, path in paths.items()] for o in self.outcomes]
        differences = np.hstack([angles, np.reshape(slips, (len(steps), len(paths)))])
        coarse, fine = steps[:-1, None], steps[1:, None]
        limits = ((coarse * differences[1:] - fine * differences[:-1]) / (coarse - fine))[-PAIRS:]
        changes, sizes = np.abs(np.diff(limits, axis=0)), np.abs(limits[-1])
        doubts = np.max(changes * SECOND_ORDER_RATIO ** np.arange(PAIRS - 2, -1, -1.0)[:, None], axis=0)
        tolerances = np.repeat([CONSISTENT_STATE, CONSISTENT_SLIP], [bodies + 1, len(paths)])
        bounds = tolerances + ALLOWED_DOUBTS * doubts
        names = (
            *["the angle of a body"] * bodies,
            "the place of the foot",
            *(f"the {w.replace('_', ' ')}" for w in paths),
        )
        worst, vaguest = int(np.argmax(sizes / bounds)), int(np.argmax(doubts[: bodies + 1]))
        if sizes[worst] > bounds[worst]:
            error = f"{names[worst]} tends to an error of {sizes[worst]:.2g} as the time step tends to zero"
            return False, f"{error}; the errors of a consistent engine tend to less than {bounds[worst]:.2g}"
        if doubts[vaguest] > LARGEST_DOUBT:
            change = f"its extrapolated error still changes by {doubts[vaguest]:.2g} from one time step to the next"
            return None, f"{names[vaguest]} does not converge: {change}"
        slides = bool(paths) and max(self.friction_effect.values()) > CONSISTENT_SLIP
        if slides and all(NOTICED * self.friction_effect[way] < bounds[k] for k, way in enumerate(paths, bodies + 1)):
            return (
                None,
                "the errors of the slip converge too slowly: friction that is wrong by 1 % would not be noticed",
            )
        largest = f"the largest is {sizes[worst]:.2g} in {names[worst]}, with a limit of {bounds[worst]:.2g}"
        return True, f"all errors tend to zero with the time step; extrapolated, {largest}"

    def to_record(self) -> dict[str, Any]:
        """One JSON object with the keys of the command line."""
        names = ["state_error", "error_before_impact", "creep", "slip_missed", "slip_invented", "sequence_matches"]
        names += ["impact_error", "energy_error", "seconds_per_second"]
        slip = {mode: [outcome.slip.get(mode) for outcome in self.outcomes] for mode in self.slip}
        finest = next((outcome for outcome in reversed(self.outcomes) if outcome.motion), None)
        return {
            "problem": self.problem,
            "engine": self.engine,
            "version": self.version,
            "setting": self.setting,
            "settings": dict(self.settings),
            "dt": [outcome.dt for outcome in self.outcomes],
            "ending": [outcome.ending for outcome in self.outcomes],
            **{name: [getattr(outcome, name) for outcome in self.outcomes] for name in names},
            "order": self.order,
            "order_before_impact": self._order("error_before_impact"),
            "slip": {"gait": dict(self.slip), "engine": slip},
            "sequence": [[list(modes) for modes in outcome.sequence] for outcome in self.outcomes],
            "largest_dt": self.largest_dt,
            "consistent": self.consistent,
            "consistent_reason": self.consistent_reason,
            "motion": {} if finest is None else {"dt": finest.dt, **finest.motion},
        }


def adapter(engine: str | type[Simulator]) -> type[Simulator]:
    """The adapter of an engine by its name; an adapter class is returned unchanged.

    Raises
    ------
    UnknownNameError
        If there is no such engine, or if it is not installed or cannot be imported.
    """
    if not isinstance(engine, str):
        return engine
    if engine not in ENGINES:
        raise UnknownNameError(f"{shown(engine)}: no such engine; use {', '.join(ENGINES)}").concerning("engine")
    if find_spec(ENGINES[engine]) is None:
        raise UnknownNameError(f"{engine}: is not installed; {INSTALL.get(engine, EXTRA)}").concerning("engine")
    try:
        found: type[Simulator] = import_module(f"gaitopt.engines.{engine}").Simulator
    except ImportError as error:  # for example, it is compiled for another version of numpy
        first = (str(error).splitlines() or ["no reason is given"])[0]
        raise UnknownNameError(f"{engine}: cannot be imported: {first}").concerning("engine") from error
    return found


def named_settings(
    simulator: type[Simulator], settings: str | Mapping[str, Mapping[str, Any]] | None
) -> Mapping[str, Mapping[str, Any]]:
    """The settings of an engine by name: all of its adapter, one of these by its name, or the given ones.

    Raises
    ------
    UnknownNameError
        If the adapter has no setting of this name.
    """
    known = simulator.settings
    if not isinstance(settings, str):
        return known if settings is None else settings
    if settings not in known:
        message = f"{settings!r}: {simulator.name} has no setting of this name; use {', '.join(known)}"
        raise UnknownNameError(message).concerning("setting")
    return {settings: known[settings]}


def slip_paths(steps: Iterable[Step]) -> dict[str, float]:
    """Path of the stance foot, or of all contacts, forward and backward [m]."""
    arcs = [arc for step in steps for arc in step.arcs if arc.mode.slips]
    contacts = arcs[0].dynamics.system.walker.contacts if arcs else ()
    x = [arc.states[:, arc.dynamics.system.n_shape] for arc in arcs]
    paths = [float(values[-1] - values[0]) for values in x]
    if contacts:
        paths = [float(curves.integral(observe(arc).slip[:, k], arc.duration)) for arc in arcs
                 for k, name in enumerate(contacts) if arc.mode.directions[name]]  # fmt: skip
    return {"slip_forward": sum(p for p in paths if p > 0), "slip_backward": -sum(p for p in paths if p < 0)}


def friction_effect(gait: Gait) -> dict[str, float]:
    """Smallest relative change of the slip in one cycle if the friction is wrong by ``FRICTION_ERROR`` either way.

    The effect is infinite for a direction in which the gait's foot does not slip, or if the motion ends early.
    """
    parameters, slip = gait.dynamics.parameters, slip_paths(gait.steps)
    coefficients = [key for key in parameters if key.startswith("friction") and not key.endswith("viscous")]
    effects = dict.fromkeys(slip, np.inf)
    for factor in (1 - FRICTION_ERROR, 1 + FRICTION_ERROR):
        dynamics = gait.dynamics.at({key: factor * parameters[key] for key in coefficients})
        walked = WalkerSimulator(dynamics).run(gait.state, steps=len(gait.steps))
        if walked.ending is Ending.COMPLETED:
            changed = slip_paths(walked.steps)
            effects = {w: min(effects[w], abs(changed[w] / path - 1)) for w, path in slip.items() if path > 0}
    return effects


def from_landing(gait: Gait, should_stop: Stop = None) -> Gait:
    """The same motion with cycles from landing to landing, in which a replay begins, if feet swap within a step.

    Raises
    ------
    ProblemError
        If no gait from landing to landing is found that has the period of the gait.
    """
    arcs = [arc for step in gait.steps for arc in step.arcs]
    swapped = swap_indices(arcs)
    if not swapped:
        return gait
    landed = arcs[swapped[0]]
    opened = gait.problem.with_fixed(gait.dynamics.parameters).replace({"gait": {"phases": "auto"}})
    dynamics = problem_dynamics(opened, should_stop=should_stop)
    turned = solve_walk(dynamics, opened, landed.states[0], len(swapped), should_stop=should_stop)
    if turned is not None and turned.period and gait.period and abs(turned.period / gait.period - 1) < SAME_PERIOD:
        return turned
    raise ProblemError(f"{gait.problem.name}: the motion of its cycle is not found from landing to landing")


def replay(
    gait: Gait,
    simulator: type[Simulator],
    settings: Mapping[str, Mapping[str, Any]],
    time_steps: Sequence[float],
    finished: Callable[[Outcome], None],
    should_stop: Stop = None,
) -> list[Replay]:
    """Replay a gait at every named setting and time step, the largest step first; see ``gaitopt.replay``."""
    gait = from_landing(gait, should_stop)
    Reference(gait)  # raises an error here, before any process starts, if the engines cannot model the gait
    slip, effect = slip_paths(gait.steps), friction_effect(gait)
    return [
        Replay(
            problem=gait.problem.name,
            engine=simulator.name,
            version=simulator.version,
            setting=name,
            settings=dict(values),
            slip=slip,
            friction_effect=effect,
            outcomes=outcomes(gait, simulator, values, time_steps, finished, should_stop),
        )
        for name, values in settings.items()
    ]
