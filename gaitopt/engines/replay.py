"""A gait replayed in a physics engine: its motion at several time steps, measured against the gait.

The engine starts from the gait's state just after an impact and walks one cycle, and ``SETTLED`` of a period more, in
which the last impact is over. There the states are compared: a point contact ends its impact within an instant, a soft
one within some time steps. All runs of one setting share a process, which may crash.

    state_error   largest difference of angles, rates and the foot's place and speed, in natural units
    order         slope of log(state_error) over log(dt) at the three smallest time steps
    error_before_impact, order_before_impact   the same ``SETTLED`` of a period before the last impact
    slip          path of the stance foot forward and backward
    creep         path of the foot while the gait's foot sticks, without a tenth of the phase at both ends
    slip_missed, slip_invented   fraction of the cycle in which only the gait slips, or only the engine
    impact_error  difference of the impulse at the landing foot up to the comparison, relative to that of the gait
    energy_error  difference of the energy at the comparison, relative to weight times length

The engine is consistent with the gait if its differences tend to zero with the time step. Each of them, v(dt), is
extrapolated from two time steps a > b, and the change from one pair to the next tells how much that is worth:

    limit = (a v(b) - b v(a)) / (a - b)        doubt = last change of the limit, or a quarter of the one before
"""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from gaitopt.arrays import Array
from gaitopt.callbacks import Stop
from gaitopt.engines.plant import Reference, Tree
from gaitopt.errors import UnknownNameError
from gaitopt.gait.gait import Gait
from gaitopt.gait.trajectory import Step
from gaitopt.model.transitions import Ending
from gaitopt.problem.faults import shown
from gaitopt.simulation.simulator import Simulator as WalkerSimulator

ENGINES: Mapping[str, str] = {"mujoco": "mujoco", "drake": "pydrake", "pybullet": "pybullet", "siconos": "siconos"}
"""Adapters, and the packages that they import."""
EXTRA = "pip install 'gaitopt[engines]'"
INSTALL = {"siconos": "on Debian: apt install python3-siconos, and a virtual environment with --system-site-packages"}
"""How to install engines that are not in the extra ``engines``."""
TIME_STEPS = (0.004, 0.002, 0.001, 0.0005, 0.00025)
"""Time steps by default [s]."""
SETTLED = 0.05
"""Time after the last impact at which states are compared, relative to the period."""
SLIPS = 2.5e-4
"""Speed, in natural units, from which a foot counts as slipping: about a millimetre per second."""
SHORTEST = 0.01
"""Fraction of the cycle below which a mode of the engine does not count."""
TRIMMED = 0.1
"""Fraction of a sticking phase at both ends that does not count as creep."""
DIVERGED = 1e3
"""Rate, in natural units, of a motion that has diverged."""
LONGEST_REASON = 120
"""Characters of an engine's error message that are kept."""
FITTED = 3
"""Number of the smallest time steps from which the order follows."""
MIDDLES = 100
"""Intervals of the midpoint rule for the gait's impulse after its impact."""
KEPT = 160
"""Maximum number of samples of a motion that are kept for pictures."""
COMPLETED = "completed"
FLOOR, SLIP_FLOOR = 2e-5, 0.01
"""Extrapolated differences below which an engine is consistent with a gait: of angles and places before its impact in
natural units, and of the slip relative to that of the gait. With right equations, four engines stay below 1.3e-5."""
DOUBTS = 2.0
"""Multiple of the doubt that a limit of a correct engine may be off besides."""
RESOLVED = 2e-4
"""Largest doubt of angles and places with which an engine can be called consistent."""
WRONG = 0.01
"""Relative error of friction that must be noticed in an engine that is called consistent, if it changes the gait."""
NOTICED = 0.8
"""Part of the effect of wrong friction that must exceed the limit of a difference."""
CONVERGING = 0.25
"""Ratio of successive changes of a limit if the time step is halved and errors are smooth: they are of second order."""
PAIRS = 3
"""Number of the finest pairs of time steps whose limits are compared."""


class Simulator(Protocol):
    """A walker in an engine, as an adapter defines it.

    Attributes
    ----------
    name, version : of the engine.
    settings : its settings by name.
    """

    name: ClassVar[str]
    version: ClassVar[str]
    settings: ClassVar[Mapping[str, Mapping[str, Any]]]

    def __init__(self, tree: Tree, friction: float, dt: float, settings: Mapping[str, Any]) -> None:
        """Build the walker on level ground; gravity is inclined."""

    def place(self, q: Array, v: Array) -> None:
        """Set coordinates and rates."""

    def step(self, force: Array, touching: tuple[bool, bool]) -> tuple[Array, Array, Array]:
        """One time step under forces on the coordinates: coordinates, rates, and (f_t, f_n) of both feet in it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """One run at one time step; numbers are None where the run did not get that far.

    Attributes
    ----------
    dt : time step [s].
    ending : ``completed``, ``no touchdown``, ``diverged``, ``failed: ERROR``, or ``crashed: SIGNAL``.
    sequence : modes that the engine's stance foot goes through, step by step.
    motion : times [s], path of the stance foot [m] and shape coordinates, thinned for pictures.
    deviation : difference of the state before the last impact, of which ``error_before_impact`` is the largest entry.
    """

    dt: float
    ending: str
    state_error: float | None = None
    error_before_impact: float | None = None
    slip: Mapping[str, float] = field(default_factory=dict)
    creep: float | None = None
    slip_missed: float | None = None
    slip_invented: float | None = None
    sequence: tuple[tuple[str, ...], ...] = ()
    sequence_matches: bool = False
    impact_error: float | None = None
    energy_error: float | None = None
    seconds_per_second: float | None = None
    motion: Mapping[str, Sequence[float]] = field(default_factory=dict)
    deviation: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Replay:
    """A gait in one engine at one setting.

    Attributes
    ----------
    problem : name of the gait's problem.
    engine, version : name and version of the engine.
    setting : name of the setting.
    settings : its values.
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
        """Whether the engine tends to the gait with the time step; None if its runs do not tell."""
        return self._judgement[0]

    @property
    def consistent_reason(self) -> str:
        """Why the engine is consistent with the gait or not, or why its runs do not tell."""
        return self._judgement[1]

    @property
    def _judgement(self) -> tuple[bool | None, str]:
        failed = next((o for o in self.outcomes if o.ending != COMPLETED), None)
        if failed is not None:
            return None, f"the run with a time step of {failed.dt:g} s ended: {failed.ending}"
        steps = np.array([o.dt for o in self.outcomes])
        if len(steps) <= PAIRS:
            return None, f"{len(steps)} time steps; the extrapolation needs {PAIRS + 1}"
        paths = {way: path for way, path in self.slip.items() if path > 0}
        bodies = len(self.outcomes[0].deviation) // 2 - 1
        angles = [[*o.deviation[:bodies], o.deviation[2 * bodies]] for o in self.outcomes]  # rates at a contact vibrate
        slips = [[o.slip[way] / path - 1 for way, path in paths.items()] for o in self.outcomes]
        differences = np.hstack([angles, np.reshape(slips, (len(steps), len(paths)))])
        coarse, fine = steps[:-1, None], steps[1:, None]
        limits = ((coarse * differences[1:] - fine * differences[:-1]) / (coarse - fine))[-PAIRS:]
        changes, sizes = np.abs(np.diff(limits, axis=0)), np.abs(limits[-1])
        doubts = np.max(changes * CONVERGING ** np.arange(PAIRS - 2, -1, -1.0)[:, None], axis=0)
        bounds = np.repeat([FLOOR, SLIP_FLOOR], [bodies + 1, len(paths)]) + DOUBTS * doubts
        names = (
            *["the angle of a body"] * bodies,
            "the place of the foot",
            *(f"the {w.replace('_', ' ')}" for w in paths),
        )
        worst, vaguest = int(np.argmax(sizes / bounds)), int(np.argmax(doubts[: bodies + 1]))
        if sizes[worst] > bounds[worst]:
            words = f"{names[worst]} tends to an error of {sizes[worst]:.2g} as the time step tends to zero"
            return False, f"{words}; the errors of a consistent engine tend to less than {bounds[worst]:.2g}"
        if doubts[vaguest] > RESOLVED:
            words = f"its extrapolated error still changes by {doubts[vaguest]:.2g} from one time step to the next"
            return None, f"{names[vaguest]} does not converge: {words}"
        slides = bool(paths) and max(self.friction_effect.values()) > SLIP_FLOOR
        if slides and all(NOTICED * self.friction_effect[way] < bounds[k] for k, way in enumerate(paths, bodies + 1)):
            return (
                None,
                "the errors of the slip converge too slowly: friction that is wrong by 1 % would not be noticed",
            )
        words = f"the largest is {sizes[worst]:.2g} in {names[worst]}, with a limit of {bounds[worst]:.2g}"
        return True, f"all errors tend to zero with the time step; extrapolated, {words}"

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
    """The adapter of an engine by its name; an adapter of one's own is returned as it is.

    Raises
    ------
    UnknownNameError
        If there is no such engine, or it is not installed or cannot be imported.
    """
    if not isinstance(engine, str):
        return engine
    if engine not in ENGINES:
        words = f"{shown(engine)}: no such engine; use {', '.join(ENGINES)}"
        raise UnknownNameError(words).concerning("engine")
    if find_spec(ENGINES[engine]) is None:
        raise UnknownNameError(f"{engine}: is not installed; {INSTALL.get(engine, EXTRA)}").concerning("engine")
    try:
        found: type[Simulator] = import_module(f"gaitopt.engines.{engine}").Simulator
    except ImportError as error:  # as where it is compiled for another version of numpy
        first = (str(error).splitlines() or ["no reason is given"])[0]
        raise UnknownNameError(f"{engine}: cannot be imported: {first}").concerning("engine") from error
    return found


def run(reference: Reference, simulator: type[Simulator], dt: float, settings: Mapping[str, Any]) -> Outcome:
    """Walk one cycle in an engine and measure it.

    Parameters
    ----------
    settings : those of the adapter; besides them ``friction`` and ``gravity`` are factors, for tests.
    """
    changed = dict(settings)
    tree, mu = reference.tree, reference.friction * changed.pop("friction", 1.0)
    factor = changed.pop("gravity", 1.0)
    tree = Tree(bodies=tree.bodies, feet=tree.feet, gravity=(factor * tree.gravity[0], factor * tree.gravity[1]))
    walk, (q, v) = simulator(tree, mu, dt, changed), reference.coordinates(0.0)
    walk.place(q, v)
    cycle = len(reference.gait.steps)
    period = float(reference.starts[-1])
    n = int(np.ceil((1 + SETTLED) * period / dt)) + 1
    times, places, rates, forces = dt * np.arange(n + 1, dtype=float), [q], [v], list[Array]()
    step, began, landings, spent = 0, 0.0, list[float](), 0.0
    for t in times[:-1]:
        local = float(t) - began
        force, touching = reference.torques(step, local, q, v), reference.touching(step, local)
        start = time.perf_counter()
        try:
            q, v, f = walk.step(force, touching)
        except RuntimeError as error:  # of compiled code, as where a contact solver does not converge
            return Outcome(dt=dt, ending=f"failed: {str(error).splitlines()[0][:LONGEST_REASON]}")
        spent += time.perf_counter() - start
        if not np.isfinite(v).all() or np.abs(v).max() * reference.time > DIVERGED:
            return Outcome(dt=dt, ending="diverged")
        places.append(q.copy())
        rates.append(v.copy())
        forces.append(f)
        swing = 1 - reference.stance(step)
        if step < cycle and local >= reference.windows[step][1] and f[swing, 1] > 0:
            step, began = step + 1, float(t)
            landings.append(float(t))
    if len(landings) < cycle:
        motion = _motion(reference, times, places, rates, [*landings, np.inf])
        return Outcome(dt=dt, ending="no touchdown", motion=motion, seconds_per_second=spent / float(times[-1]))
    last = np.array([*forces, forces[-1]])
    measured = _measured(reference, times, np.array(places), np.array(rates), last, landings)
    motion = _motion(reference, times, places, rates, landings)
    return Outcome(dt=dt, ending=COMPLETED, seconds_per_second=spent / float(times[-1]), motion=motion, **measured)


def _measured(
    reference: Reference, times: Array, places: Array, rates: Array, forces: Array, landings: Sequence[float]
) -> dict[str, Any]:
    """The numbers of an outcome from coordinates, rates (m, n + 2) and forces (m, 2, 2) at times (m,)."""
    cycle, period, tree = len(reference.gait.steps), float(reference.starts[-1]), reference.tree
    end = (1 + SETTLED) * period

    def at(t: float, values: Array) -> Array:
        k = min(int(np.searchsorted(times, t, side="right")) - 1, len(times) - 2)
        s = (t - times[k]) / (times[k + 1] - times[k])
        return (1 - s) * values[k] + s * values[k + 1]

    deviation = _state(reference, cycle, at(end, places), at(end, rates)) - _state(
        reference, cycle, *reference.coordinates(end)
    )
    before = min((1 - SETTLED) * period, 0.99 * min(landings[-1:]))
    compared = _state(reference, cycle - 1, at(before, places), at(before, rates))
    early = compared - _state(reference, cycle - 1, *reference.coordinates(before))
    energies = [
        reference.energy(cycle, at(end, places), at(end, rates)),
        reference.energy(cycle, *reference.coordinates(end)),
    ]
    weight = tree.mass * float(np.hypot(*tree.gravity)) * reference.length
    slip, sequence, expected = {"slip_forward": 0.0, "slip_backward": 0.0}, list[Any](), list[Any]()
    creep = missed = invented = 0.0
    for step in range(cycle):
        foot = reference.stance(step)
        first, last = float(reference.starts[step]), min(float(reference.starts[step + 1]), landings[step])
        first = max(first, landings[step - 1] + SETTLED * period) if step else first
        inside = np.flatnonzero((times >= first) & (times <= last))
        moved = [tree.foot(foot, places[k], rates[k]) for k in inside]
        x, speed = np.array([place[0] for place, _ in moved]), np.array([velocity[0] for _, velocity in moved])
        path = np.diff(x)
        slip["slip_forward"] += float(path[path > 0].sum())
        slip["slip_backward"] -= float(path[path < 0].sum())
        window = max(1, round(SHORTEST * period / (times[1] - times[0])))  # a contact may chatter from step to step
        carried = np.convolve(forces[inside, foot, 1] > 0, np.ones(window), mode="same") > 0
        modes = np.where(carried, _modes(reference, speed), "off")
        stated = _modes(reference, reference.slip_speed(step, times[inside] - reference.starts[step]))
        slides, slips = (np.char.startswith(words, "slip") for words in (modes, stated))
        missed += float((slips & ~slides).sum() * (times[1] - times[0]) / period)
        invented += float((slides & ~slips).sum() * (times[1] - times[0]) / period)
        sequence.append(_runs(modes, window))
        expected.append(_runs(stated, window))
        for arc in (arc for arc in reference.gait.steps[step].arcs if arc.mode.sticks):
            margin = TRIMMED * arc.duration
            began, ended = (reference.starts[step] + t for t in (arc.start + margin, arc.end - margin))
            if began < ended < times[inside[-1]]:
                creep += abs(float(np.interp(ended, times[inside], x) - np.interp(began, times[inside], x)))
    return {
        "state_error": float(np.abs(deviation).max()),
        "error_before_impact": float(np.abs(early).max()),
        "slip": slip,
        "creep": creep,
        "slip_missed": missed,
        "slip_invented": invented,
        "sequence": tuple(sequence),
        "sequence_matches": sequence == expected,
        "impact_error": _impact_error(reference, times, forces, end),
        "energy_error": (energies[0] - energies[1]) / weight,
        "deviation": tuple(early.tolist()),
    }


def _state(reference: Reference, step: int, q: Array, v: Array) -> Array:
    """Angles, rates, place and speed of the stance foot in a step, in natural units."""
    place, velocity = reference.tree.foot(reference.stance(step), q, v)
    angles, rates = reference.tree.angles(q), reference.tree.angles(v)
    length, unit = reference.length, reference.time
    return np.concatenate([angles, rates * unit, place[:1] / length, velocity[:1] * unit / length])


def _impact_error(reference: Reference, times: Array, forces: Array, end: float) -> float:
    """Relative difference of the impulses at the landing foot, the forces after the impact included."""
    cycle, period = len(reference.gait.steps), float(reference.starts[-1])
    foot = reference.stance(cycle)
    spans = np.clip(end - times, 0.0, times[1] - times[0]) * (times > (1 - SETTLED) * period)
    impulse = spans @ forces[:, foot]
    middles = period + (end - period) * (np.arange(MIDDLES) + 0.5) / MIDDLES
    stated = reference.gait.steps[-1].final_impact.impulse
    expected = stated + (end - period) * np.mean([reference.force(float(t)) for t in middles], axis=0)
    return float(np.linalg.norm(impulse - expected) / np.linalg.norm(stated))


def _modes(reference: Reference, speed: Array) -> NDArray[np.str_]:
    """What a foot does at these speeds (m,) [m/s]."""
    slow = SLIPS * reference.length / reference.time
    return np.where(speed >= slow, "slip_forward", np.where(speed <= -slow, "slip_backward", "stick"))


def _runs(modes: NDArray[np.str_], shortest: float) -> tuple[str, ...]:
    """The modes in order, without those that are too short."""
    edges = np.flatnonzero(modes[1:] != modes[:-1]) + 1
    pieces = np.split(modes, edges)
    return _distinct(str(piece[0]) for piece in pieces if len(piece) >= shortest)


def _distinct(modes: Iterable[str]) -> tuple[str, ...]:
    """Without repetitions of neighbours."""
    result = list[str]()
    for mode in modes:
        if not result or result[-1] != mode:
            result.append(mode)
    return tuple(result)


def _motion(
    reference: Reference, times: Array, places: Sequence[Array], rates: Sequence[Array], landings: Sequence[float]
) -> dict[str, list[float]]:
    """Times, place of the stance foot from its start in each step, and shape coordinates, as the gait's steps count."""
    shown = np.unique(np.linspace(0, len(times) - 1, KEPT).round().astype(int))
    names, origin, last = reference.system.walker.shape, 0.0, 0
    columns: dict[str, list[float]] = {"t": [], "x": [], **{name: [] for name in names}}
    for k in shown:
        step = int(np.searchsorted(landings, times[k], side="right"))
        if step > len(reference.gait.steps) - 1 and times[k] > reference.starts[-1]:
            break
        z = reference.shape_state(step, places[k], rates[k])
        if step != last or k == 0:
            origin, last = float(z[len(names)]), step
        columns["t"].append(float(times[k]))
        columns["x"].append(float(z[len(names)]) - origin)
        for name, value in zip(names, z, strict=False):
            columns[name].append(float(value))
    return columns


def slip_paths(steps: Iterable[Step]) -> dict[str, float]:
    """Path of the stance foot forward and backward [m]."""
    arcs = [arc for step in steps for arc in step.arcs if arc.mode.slips]
    x = [arc.states[:, arc.dynamics.system.n_shape] for arc in arcs]
    paths = [float(place[-1] - place[0]) for place in x]
    return {"slip_forward": sum(p for p in paths if p > 0), "slip_backward": -sum(p for p in paths if p < 0)}


def friction_effect(gait: Gait) -> dict[str, float]:
    """Relative change of the slip of a gait in one cycle if the friction is wrong by ``WRONG``, at least.

    Infinite for a direction in which the foot does not slip then, or if the motion ends before.
    """
    parameters, slip = gait.dynamics.parameters, slip_paths(gait.steps)
    coefficients = [key for key in parameters if key.startswith("friction") and not key.endswith("viscous")]
    effects = dict.fromkeys(slip, np.inf)
    for factor in (1 - WRONG, 1 + WRONG):
        dynamics = gait.dynamics.at({key: factor * parameters[key] for key in coefficients})
        walked = WalkerSimulator(dynamics).run(gait.state, steps=len(gait.steps))
        if walked.ending is Ending.COMPLETED:
            changed = slip_paths(walked.steps)
            effects = {w: min(effects[w], abs(changed[w] / path - 1)) for w, path in slip.items() if path > 0}
    return effects


def replay(
    gait: Gait,
    simulator: type[Simulator],
    settings: Mapping[str, Mapping[str, Any]],
    time_steps: Sequence[float],
    finished: Callable[[Outcome], None],
    should_stop: Stop = None,
) -> list[Replay]:
    """Replay a gait at several settings, by name, with different time steps, the largest first: ``gaitopt.replay``."""
    from gaitopt.engines.process import outcomes  # it imports this module

    Reference(gait)  # is refused if an engine has no law for it
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
