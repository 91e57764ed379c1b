"""Every verb for every kind of walker: the table of docs/abilities.md, and how each of its cells is checked.

    python tests/abilities.py           runs the cells that have not passed yet, and writes the pages when all have
    python -m pytest -m slow tests/test_abilities.py -k "crawler or attractors"

A row is an example of one structure, a column is one verb with a check by other means. A cell without a reason passes
its check. A cell with a reason does not apply: the reason is mathematics or physics, or a limit of a named engine.
Cells that have passed are kept in ``.abilities`` for the sources with which they were run, so that an interrupted run
goes on where it ended.
"""

import hashlib
import json
import math
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
import pytest
from orbit_files import differing, written
from own_laws import DampedCompass, HipDamper, MidCompass

import gaitopt as go
from gaitopt.engines.outcome import run
from gaitopt.engines.plant import Reference
from gaitopt.engines.replay import adapter, from_landing
from gaitopt.problem.statement import problem_data
from gaitopt.requests import Engine
from gaitopt.show.catalogue import figures_of
from gaitopt.systems import problem_dynamics

ROOT = Path(__file__).resolve().parent.parent
PAGE, README, KEPT = ROOT / "docs" / "abilities.md", ROOT / "README.md", ROOT / ".abilities"
FEW: Mapping[str, Any] = {"workers": 1, "progress": False}
NEAR = 1.001
"""Factor of the parameter in sweeps, families and designs."""
SLIGHTLY = 1e-6
"""Relative change of the gravity in an orbit file, with which the events are still near those of the file."""
GRAVITY = "walker.gravity"
SLIPPERY = 0.3
"""Factor of the friction that a gait needs: the gait is continued to it, and ``explain`` is asked why there is none."""
FEW_POINTS = 60
"""Number of points of a continuation in friction."""
SMALLEST_FRICTION = 1e-9
"""A gait that needs less has no tangential forces."""
BESIDE = 1e-3
"""Relative distance from the end of a mode sequence at which gaits exist on one side only."""
WALKS = 2000
"""Number of walks of a search without a guess; half of them miss one gait of the compass from a file."""
TIME_STEPS = (1e-3, 2.5e-4)
"""Time steps of a replay [s]."""
PER_HALVING = 0.8
"""Largest ratio of the errors of a replay before the impact at a time step and at twice this time step, on average."""
REPLAYED, SETTLED = 2.5e-3, 0.01
"""Largest errors of a replay at the smallest time step, before the impact and after it, in natural units."""
HEAVIER = {"gravity": 1.01}
SEEN = 3.0
"""Factor by which 1 % more gravity in the engine increases the error before the impact, or more."""
OWN_WALKERS = (DampedCompass, MidCompass)
OPEN_LOOP = """
name: open-loop
walker: {model: compass_biped, leg_length: 1.6, leg_mass: 4, leg_com: 0.8, hip_mass: 2, gravity: 9.8, slope: 1 deg}
friction: 0.6
control: {type: open_loop, intervals: 2}
gait: {phases: [stick], impact: stick, guess: {step_length: 0.4, duration: 0.7}}
objective: torque_squared
constraints: {speed: 0.6}
"""
FROM_URDF = """
name: compass-from-file
walker: {urdf: compass.urdf, feet: [stance_leg_foot, swing_leg_foot], gravity: 9.8, slope: 1 deg}
friction: 0.14
gait:
  phases: [slip_forward, stick, slip_backward]
  impact: stick
  guess: {state: {stance_leg: -0.149, dstance_leg: 0.733, dswing_leg: 0.501}}
"""


@dataclass(frozen=True)
class Row:
    """An example of a structure.

    Attributes
    ----------
    name : of the structure.
    example : description of the example, and its problem.
    """

    name: str
    example: str
    problem: Callable[[], go.Problem]


def _changed(name: str, **keys: Any) -> Callable[[], go.Problem]:
    """A named problem with other values at some keys of its data."""

    def build() -> go.Problem:
        data = problem_data(go.load_problem(name))
        for key, value in keys.items():
            data[key] = {**data[key], **value} if isinstance(value, dict) and key == "walker" else value
        return go.parse_problem(json.dumps(data), walkers=OWN_WALKERS, controls=[HipDamper])

    return build


def _from_urdf() -> go.Problem:
    folder = Path(tempfile.mkdtemp())
    description = go.robot_description(go.load_problem("compass-passive-a").walker)
    (folder / "compass.urdf").write_text(description, encoding="utf-8")
    (folder / "compass.yaml").write_text(FROM_URDF, encoding="utf-8")
    return go.load_problem(folder / "compass.yaml")


def _named(structure: str, name: str) -> Row:
    return Row(structure, f"`{name}`", lambda: go.load_problem(name))


DAMPED = _changed("compass-passive-stick", walker={"model": "damped_compass"})
FRICTIONLESS = _changed(
    "compass-torque-impact-slip",
    impact_law="frictionless",
    friction=0.15,
    control={"type": "constant_torque", "ankle": 1.32, "hip": 0.265},
    gait={
        "phases": ["slip_forward", "stick"],
        "impact": "slip_forward",
        "guess": {"state": {"theta1": -0.111, "dtheta1": 0.292, "dtheta2": -0.422, "dx": 0.423}},
    },
)
MID_STRIDE = _changed(
    "compass-passive-a",
    walker={"model": "mid_compass"},
    gait={
        "section": {"margin": "middle"},
        "phases": ["stick", "slip_backward", {"mode": "slip_forward", "impact": "stick"}, "stick"],
        "guess": {"state": {"theta2": 0.1603, "dtheta1": 0.2451, "dtheta2": 0.7388}},
    },
)
VISCOUS = {"static": 0.42, "kinetic": 0.4, "viscous": 0.5}
ROWS = (
    _named("one foot", "compass-passive-stick"),
    _named("slips", "compass-passive-a"),
    _named("two steps", "compass-passive-two-step"),
    _named("unequal legs", "compass-unequal"),
    _named("stops", "kneed-passive"),
    _named("switches and flight", "hopper"),
    _named("massless feet and flight", "slip-run"),
    _named("push-off", "compass-push-off"),
    _named("rolling feet", "round-feet-passive"),
    _named("several contacts that swap", "heel-toe"),
    _named("several contacts with a clock", "crawler"),
    _named("double support on massless legs", "slip-walk-stable"),
    _named("a section at a margin", "bounding"),
    Row("a section in mid-stride", "`compass-passive-a` from one upright stance leg to the next", MID_STRIDE),
    _named("static and kinetic friction", "compass-passive-static-kinetic"),
    Row("frictionless impact", "`compass-torque-impact-slip` with such an impact and a stable gait", FRICTIONLESS),
    Row("viscous drag", "`rimless-wheel-slip` with drag", _changed("rimless-wheel-slip", friction=VISCOUS)),
    _named("constant torques", "compass-torque-stick"),
    _named("PD on a gait", "compass-pd-impact-slip"),
    _named("PD on a curve", "compass-shaped"),
    _named("PD on a table", "compass-table"),
    _named("virtual constraints", "compass-virtual-constraint"),
    Row("open-loop torques", "a compass with free torques", lambda: go.parse_problem(OPEN_LOOP)),
    Row("a robot from URDF", "a compass from a file", _from_urdf),
    Row("an own walker", "a compass with a damper", DAMPED),
    Row("an own law", "a hip motor that brakes", _changed("compass-passive-stick", control={"type": "hip_damper"})),
)  # fmt: skip


@cache
def gait_of(row: Row) -> go.Gait:
    """The gait of a row."""
    gait = go.solve(row.problem(), progress=False)
    assert gait.converged, gait.message
    return gait


def _changed_gait(row: Row) -> tuple[float, go.Gait]:
    """A value of gravity next to that of the row, and the gait that is solved there anew."""
    value = row.problem().parameters[GRAVITY] * NEAR
    alone = go.solve(row.problem().replace({GRAVITY: value}), progress=False)
    assert alone.converged, alone.message
    return value, alone


def _nearby(row: Row) -> go.Problem:
    """The problem at this value, with the gait of the row as the guess; an optimum is sought from its own guess."""
    gait = gait_of(row)
    if gait.problem.is_design:
        return row.problem()
    value = gait.problem.parameters[GRAVITY] * NEAR
    return gait.problem.with_gait(gait.to_record()).replace({GRAVITY: value})


def _slippery(row: Row) -> dict[str, float]:
    """Coefficients of friction that are too small for the sticking phases of the gait; empty if it needs none."""
    needed = gait_of(row).measures.get("required_friction")
    if needed is not None and needed < SMALLEST_FRICTION:
        return {}
    frictions = {key: value for key, value in row.problem().parameters.items() if key.partition(".")[0] == "friction"}
    frictions = {key: value for key, value in frictions.items() if not key.endswith("viscous")}
    scale = SLIPPERY * min(1.0, 1.0 if needed is None else needed / min(frictions.values()))
    return {key: scale * value for key, value in frictions.items()}


def _close(row: Row) -> float:
    """Relative accuracy of a gait, or of an optimum, which is flat."""
    return 1e-5 if row.problem().is_design else 1e-8


def _newton(row: Row, folder: Path) -> None:
    value = row.problem().parameters[GRAVITY] * NEAR
    guesses = row.problem().replace({GRAVITY: value}), _nearby(row)
    tried = (go.solve(problem, method="newton", progress=False) for problem in guesses)
    gait = next(gait for gait in tried if gait.converged)
    walked = go.simulate(gait, steps=len(gait.steps)).trajectory
    assert sum(step.period for step in walked.steps) == pytest.approx(gait.period, rel=1e-7)


def _ipopt(row: Row, folder: Path) -> None:
    gait = go.solve(row.problem(), method="ipopt", progress=False)
    assert gait.period == pytest.approx(gait_of(row).period, rel=_close(row))


def _nlp(row: Row, folder: Path) -> None:
    alone = gait_of(row) if row.problem().is_design else _changed_gait(row)[1]
    program = go.nlp(_nearby(row))
    options = {"ipopt.linear_solver": "mumps", "ipopt.tol": 1e-10, "ipopt.print_level": 0, "print_time": False}
    end = ca.nlpsol("solver", "ipopt", program.casadi(), {**getattr(program, "derivatives", {}), **options})(
        **program.arguments()
    )
    assert program.gait(end["x"]).period == pytest.approx(alone.period, rel=100 * _close(row))


def _simulate(row: Row, folder: Path) -> None:
    gait = gait_of(row)
    states = go.simulate(gait, steps=2 * len(gait.steps)).trajectory.section_states
    section = gait.system.section(gait.cycle).indices
    bound = 1e-8 * max(1.0, gait.spectral_radius or 0.0) ** 2
    assert states[-1][section] == pytest.approx(gait.state[section], abs=bound)


def _verify(row: Row, folder: Path) -> None:
    gait = gait_of(row)
    assert go.verify(gait).passed
    other = gait.problem.replace({GRAVITY: gait.problem.parameters[GRAVITY] * NEAR})
    assert not go.verify(replace(gait, problem=other, dynamics=problem_dynamics(other))).passed


def _continue(row: Row, folder: Path) -> None:
    gait = gait_of(row)
    value = gait.problem.parameters[GRAVITY] * NEAR
    alone = go.solve(gait.problem.replace({GRAVITY: value}), progress=False)
    end = go.continuation(gait, GRAVITY, to=value, progress=False)[-1].gait
    assert end.period == pytest.approx(alone.period, rel=1e-8)
    for key, smallest in [*_slippery(row).items()][-1:]:
        branch = go.continuation(gait, key, to=smallest, max_points=FEW_POINTS, progress=False)
        for number in {point.branch for point in branch}:
            points = branch.branch(number).points
            assert go.verify(points[len(points) // 2].gait).passed


def _find(row: Row, folder: Path) -> None:
    found = go.find(row.problem(), starts=1, steps=len(gait_of(row).steps), **FEW)
    assert any(gait.period == pytest.approx(gait_of(row).period, rel=max(_close(row), 1e-7)) for gait in found)


def _first_gait(row: Row, folder: Path) -> None:
    problem, gait = row.problem(), gait_of(row)
    data, steps = problem_data(problem), len(gait.steps)
    opened = {"phases": "auto"} | {key: data["gait"][key] for key in ("section",) if key in data["gait"]}
    data["gait"] = opened | ({"steps": steps} if steps > 1 else {})
    walkers, controls = [type(problem.walker)], [type(problem.control)]
    nothing = go.parse_problem(json.dumps(data), walkers=walkers, controls=controls)
    assert nothing.start is None
    periods = [found.period for found in go.find(nothing, steps=steps, starts=WALKS, **FEW)]
    assert any(period == pytest.approx(gait.period, rel=max(_close(row), 1e-7)) for period in periods)


def _explain(row: Row, folder: Path) -> None:
    problem = row.problem()
    assert go.explain(problem, starts=1, **FEW).exists
    frictions = _slippery(row)
    if not frictions:
        return  # without tangential forces, no friction excludes the gait
    why = go.explain(problem.replace(frictions), starts=1, **FEW)
    assert not why.exists
    assert why.causes
    assert why.causes[0].description
    if why.causes[0].what == "friction":
        assert (why.causes[0].needed or 0.0) > (why.causes[0].available or 0.0)
    for nearest in why.nearest:
        if nearest.parameter in frictions:
            guesses = [problem, problem if nearest.gait is None else problem.with_gait(nearest.gait.to_record())]
            values = [{nearest.parameter: nearest.value * (1 + side)} for side in (-BESIDE, BESIDE)]
            beside = [[go.solve(guess.replace(value), progress=False) for guess in guesses] for value in values]
            assert sorted(any(gait.converged for gait in gaits) for gaits in beside) == [False, True]


def _sweep(row: Row, folder: Path) -> None:
    value, alone = _changed_gait(row)
    swept = go.sweep(row.problem(), {GRAVITY: (value / NEAR, value, 2)}, output=folder, **FEW)
    assert swept.column("period") == pytest.approx([gait_of(row).period, alone.period], rel=_close(row))


def _freed(row: Row) -> tuple[dict[str, Any], str, float]:
    """Free gravity, the scalar that determines it, and the value of that scalar in the gait."""
    gait = gait_of(row)
    name, gravity = "speed" if abs(gait.scalar("speed")) > 1e-6 else "period", gait.problem.parameters[GRAVITY]
    return {GRAVITY: {"free": [gravity / 1.2, gravity * 1.2], "guess": gravity}}, name, gait.scalar(name)


def _has(row: Row, gravity: float, name: str, wanted: float) -> bool:
    """Whether the gait that is solved alone at a value of gravity has a scalar."""
    alone = go.solve(gait_of(row).problem.replace({GRAVITY: gravity}), progress=False)
    return bool(alone.scalar(name) == pytest.approx(wanted, rel=1e-7))


def _design(row: Row, folder: Path) -> None:
    freed, name, value = _freed(row)
    problem = gait_of(row).problem.replace({**freed, f"constraints.{name}": NEAR * value})
    designed = go.solve(problem, progress=False)
    assert designed.converged, designed.message
    assert _has(row, designed.to_record()["parameters"][GRAVITY], name, NEAR * value)


def _front(row: Row, folder: Path) -> None:
    freed, name, value = _freed(row)
    problem = gait_of(row).problem.replace({**freed, "objective": {GRAVITY: 1}, f"constraints.{name}": value})
    points = go.front(problem, {f"constraints.{name}": (value, NEAR * value, 2)}, output=folder, progress=False)
    for point, wanted in zip(points, (value, NEAR * value), strict=True):
        assert point.converged
        assert _has(row, point.gait["parameters"][GRAVITY], name, wanted)


def _starts(row: Row, folder: Path) -> None:
    optima = go.multistart(row.problem(), 2, spread=0.01, output=folder, **FEW)
    periods = [optimum.record["period"] for optimum in optima]
    assert any(period == pytest.approx(gait_of(row).period, rel=_close(row)) for period in periods)


def _basin(engine: str) -> Callable[[Row, Path], None]:
    def check(row: Row, folder: Path) -> None:
        if engine == Engine.HEYOKA:
            pytest.importorskip("heyoka")
        gait = gait_of(row)
        name = gait.problem.map_section.names[0]
        value = float(gait.state[gait.system.state_names.index(name)])
        over = {name: (value - 1e-4, value + 1e-4, 2)}
        steps = math.ceil(math.log(1e-12) / math.log(gait.spectral_radius or 0.5))
        (attractor,) = go.basin(gait, over, steps=steps, engine=engine, output=folder, **FEW).attractors
        assert attractor.count == 2
        assert go.solve(attractor, progress=False).period == pytest.approx(gait.period, rel=1e-9)

    return check


def _attractors(row: Row, folder: Path) -> None:
    gait, value = gait_of(row), row.problem().parameters[GRAVITY]
    problem = gait.problem.with_gait(gait.to_record())
    found = go.attractors(
        problem, {GRAVITY: (value, value * NEAR, 2)}, starts=1, transient=100, keep=6, output=folder, **FEW
    )
    (run,) = found.records[0]["attractors"]
    assert run["period_steps"] == len(gait.steps)
    assert run["lyapunov"] == pytest.approx(math.log(gait.spectral_radius or 0.0) / len(gait.steps), abs=1e-5)


def _figures(row: Row, folder: Path) -> None:
    figures = figures_of(gait_of(row))
    for name in figures.names:
        figure = figures.draw(name)
        lines = [line.get_xydata() for axes in figure.axes for line in axes.lines]
        assert lines or any(axes.patches or axes.collections for axes in figure.axes), name
        assert all(np.isfinite(points).any() for points in lines if len(points)), name
        plt.close(figure)


def _save(row: Row, folder: Path) -> None:
    gait = gait_of(row)
    loaded = go.load_run(gait.save(folder / "run"), walkers=OWN_WALKERS, controls=[HipDamper])
    assert (loaded.problem.digest, loaded.cycle) == (gait.problem.digest, gait.cycle)
    assert loaded.state.tolist() == gait.state.tolist()
    for name, value in gait.measures.items():
        assert loaded.measures[name] == (value if value is None else pytest.approx(value, rel=1e-9, abs=1e-12)), name


def _orbit(row: Row, folder: Path) -> None:
    data = written(gait_of(row))
    assert differing(data) == []
    gravity = next(entry for entry in data["statement"]["parameters"].values() if entry["key"] == GRAVITY)
    gravity["value"] *= 1 + SLIGHTLY
    assert "initial state" in differing(data)


def _prove(row: Row, folder: Path) -> None:
    gait, certificate = gait_of(row), folder / "proof.json"
    proof = go.prove(gait, output=certificate, progress=False)
    assert proof.proved, proof
    walked = go.simulate(gait, steps=len(gait.steps)).trajectory
    periods = sum(float(duration.mid()) for duration in proof.durations)
    assert sum(step.period for step in walked.steps) == pytest.approx(periods, rel=1e-8)
    checked = go.check_proof(certificate, walkers=[type(gait.problem.walker)], controls=[type(gait.problem.control)])
    assert checked.proved


def _replay(row: Row, folder: Path) -> None:
    pytest.importorskip("mujoco")
    (replay,) = go.replay(gait_of(row), "mujoco", settings="best", time_steps=TIME_STEPS, progress=False)
    coarse, fine = replay.outcomes
    assert fine.sequence_matches
    halvings = math.log2(coarse.dt / fine.dt)
    assert fine.error_before_impact < min(PER_HALVING**halvings * coarse.error_before_impact, REPLAYED)
    assert fine.state_error < SETTLED
    wrong = run(Reference(from_landing(gait_of(row))), adapter("mujoco"), fine.dt, {**replay.settings, **HEAVIER})
    assert wrong.error_before_impact > SEEN * fine.error_before_impact


@dataclass(frozen=True)
class Column:
    """A verb and the check of its cells."""

    name: str
    check_text: str
    check: Callable[[Row, Path], None]


COLUMNS = (
    Column(
        "Newton",
        "`solve` by Newton's method from the gait at another gravity; a simulated cycle takes as long",
        _newton,
    ),
    Column("IPOPT", "`solve` by IPOPT has the period that Newton's method finds", _ipopt),
    Column("nlp", "`casadi.nlpsol` solves the program of `nlp` from the gait at another gravity", _nlp),
    Column("first gait", "`find` lists the gait without a guess, from walks that start anywhere", _first_gait),
    Column("simulate", "`simulate` is back at the gait after two cycles", _simulate),
    Column("verify", "`verify` passes, and refutes the motion at another gravity", _verify),
    Column(
        "continue",
        "`continue` in gravity ends at the gait that is solved there anew; in friction, down to three tenths of what "
        "the gait needs, modes change, and a gait of each mode sequence passes `verify`",
        _continue,
    ),
    Column("find", "`find` lists the gait among those to which walks lead", _find),
    Column(
        "explain",
        "`explain` says that the gait exists; with three tenths of the friction that it needs, why it does not, and "
        "gaits exist on one side of the nearest friction only",
        _explain,
    ),
    Column("sweep", "`sweep` over gravity has the periods of gaits that are solved alone", _sweep),
    Column("design", "gravity for a given speed or period; a gait with this gravity has it", _design),
    Column("front", "`front`: gravity for two speeds or periods; gaits with these values have them", _front),
    Column("starts", "`solve --starts` from guesses around that of the problem lists the gait", _starts),
    Column("basin, SciPy", "`basin`: starts next to the gait settle on it, as `solve` confirms", _basin("scipy")),
    Column("basin, heyoka", "the same on heyoka, many states at once", _basin("heyoka")),
    Column("attractors", "`attractors`: the Lyapunov exponent is the logarithm of the largest multiplier", _attractors),
    Column("figures", "every figure of `plot` is drawn", _figures),
    Column("save", "`load_run` reads the same problem, modes, state and scalars back", _save),
    Column(
        "orbit",
        "`recompute.py` of the [reference orbits](reference-orbits.md), which does not use gaitopt, finds all numbers "
        "of the gait's orbit file again, and refutes its state at a slightly different gravity",
        _orbit,
    ),
    Column(
        "prove",
        "`prove` proves all claims, and a simulated cycle has the proved period; `check_proof` proves the certificate "
        "again",
        _prove,
    ),
    Column(
        "replay",
        "`replay` in MuJoCo finds the mode sequence; its errors fall by a fifth or more where the time step is halved, "
        "to 0.0025 before the impact and 0.01 after it in natural units, and 1 % more gravity triples them",
        _replay,
    ),
)
UNSTABLE = "the gait of this example is unstable: walks that start next to it leave it"
NARROW = (
    "of 1000 walks that start anywhere, none takes three steps: the legs hold it only where they were placed before"
)
SOFT = "limit of MuJoCo: its joint limits are soft constraints, and this stop is an inelastic impact"
MASSLESS = "limit of MuJoCo: it integrates accelerations F/m, which a massless foot does not have"
CONVEX = "limit of MuJoCo: its contact law is convex, so that a contact that slips hops at every time step"
ONE_COEFFICIENT = "limit of MuJoCo: friction of a contact is dry and has one coefficient"
LEAVES_FAST = (
    "limit of MuJoCo: by its convex contact law, the foot that leaves at v_t along the ground does so at mu v_t or "
    "faster, which is three times its rate in this gait"
)
OWN_COORDINATES = (
    "the theorem compares modes by their accelerations, from which the forces of massless contacts with coordinates of "
    "their own do not follow; and none of its exact identities says that the springs conserve the energy"
)
REASONS: Mapping[tuple[str, str], str] = {
    ("open-loop torques", "Newton"): "free torques are more unknowns than equations, so that an objective chooses them",
    ("double support on massless legs", "first gait"): NARROW,
    ("double support on massless legs", "prove"): OWN_COORDINATES,
    ("a section at a margin", "basin, SciPy"): UNSTABLE,
    ("a section at a margin", "basin, heyoka"): UNSTABLE,
    ("a section at a margin", "attractors"): UNSTABLE,
    ("a section at a margin", "prove"): OWN_COORDINATES,
    ("two steps", "replay"): LEAVES_FAST,
    ("stops", "replay"): SOFT,
    ("switches and flight", "replay"): SOFT,
    ("massless feet and flight", "replay"): MASSLESS,
    ("double support on massless legs", "replay"): MASSLESS,
    (
        "push-off",
        "replay",
    ): "limit of MuJoCo: forces act over time steps, and this push-off is an impulse at one instant",
    ("several contacts with a clock", "replay"): CONVEX,
    ("a section at a margin", "replay"): MASSLESS,
    ("static and kinetic friction", "replay"): ONE_COEFFICIENT,
    ("viscous drag", "replay"): ONE_COEFFICIENT,
    ("frictionless impact", "replay"): "limit of MuJoCo: its impacts have the friction of its contacts",
}
"""Why a cell does not apply, by row and column."""
GROUPS: Mapping[str, tuple[str, ...]] = {
    "solve": ("Newton", "IPOPT", "nlp", "first gait", "starts"),
    "simulate, verify": ("simulate", "verify"),
    "continue, find, explain, sweep": ("continue", "find", "explain", "sweep"),
    "design": ("design", "front"),
    "settle": ("basin, SciPy", "basin, heyoka", "attractors"),
    "plot, save": ("figures", "save", "orbit"),
    "prove": ("prove",),
    "replay": ("replay",),
}
"""Columns of the small table in the README, each with columns of the whole table."""
MARKS = "<!-- abilities: written by tests/abilities.py -->\n", "<!-- end of abilities -->\n"


def page() -> str:
    """The page with the table."""
    numbers = {reason: k for k, reason in enumerate(dict.fromkeys(REASONS.values()), start=1)}
    lines = [
        "# Every verb for every walker",
        "",
        "Each cell with a tick is run on the example of its row, with the check of its column. A number refers to the",
        "reason why a cell does not apply. `python tests/abilities.py` runs all cells in less than two hours on two",
        "cores, and writes this page; if it is interrupted, it goes on where it ended.",
        "",
        "| structure | example | " + " | ".join(column.name for column in COLUMNS) + " |",
        "|---|---|" + "---|" * len(COLUMNS),
    ]
    for row in ROWS:
        keys = [(row.name, column.name) for column in COLUMNS]
        cells = (str(numbers[REASONS[key]]) if key in REASONS else "✓" for key in keys)
        lines.append(f"| {row.name} | {row.example} | {' | '.join(cells)} |")
    lines += ["", "## Checks", "| column | check |", "|---|---|"]
    lines += [f"| {column.name} | {column.check_text} |" for column in COLUMNS]
    lines += ["", "## Reasons"]
    lines += [f"{number}. {reason[0].upper()}{reason[1:]}." for reason, number in numbers.items()]
    return "\n".join(lines) + "\n"


def small_table() -> str:
    """The table of the README: for every structure the number of columns of a group with a tick, if not all of them."""
    lines = ["| | " + " | ".join(GROUPS) + " |", "|---|" + "---|" * len(GROUPS)]
    for row in ROWS:
        cells = list[str]()
        for names in GROUPS.values():
            apply = sum((row.name, name) not in REASONS for name in names)
            cells.append("✓" if apply == len(names) else f"{apply} of {len(names)}" if apply else "–")
        lines.append(f"| {row.name} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def readme() -> str:
    """The README with the small table between its marks."""
    text, (begin, end) = README.read_text(encoding="utf-8"), MARKS
    before, _, rest = text.partition(begin)
    return before + begin + small_table() + end + rest.partition(end)[2]


@cache
def sources() -> str:
    """A hash of the package."""
    found = hashlib.sha256()
    for path in sorted((ROOT / "gaitopt").rglob("*.py")):
        found.update(path.read_bytes())
    return found.hexdigest()


def failure(row: Row, column: Column) -> str:
    """Why a cell fails, or an empty text; if it has passed before with these sources, it is not run again."""
    file = KEPT / sources() / f"{row.name}, {column.name}.json"
    if file.exists():
        return ""
    began = time.process_time()
    try:
        with tempfile.TemporaryDirectory() as folder:
            column.check(row, Path(folder))
    except Exception:  # noqa: BLE001 - any failure is a result of the table
        return traceback.format_exc()
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps({"seconds": round(time.process_time() - began, 1)}), encoding="utf-8")
    return ""


def run_row(number: int) -> tuple[int, int]:
    """Run all cells of a row without a reason; returns the numbers of cells that passed and that were run."""
    row = ROWS[number]
    columns = [column for column in COLUMNS if (row.name, column.name) not in REASONS]
    passed = 0
    for column in columns:
        try:
            report = failure(row, column)
        except pytest.skip.Exception as missing:  # an engine
            report = str(missing)
        passed += not report
        sys.stdout.write(f"{row.name}, {column.name}: {report or 'passed'}\n")
        sys.stdout.flush()
    return passed, len(columns)


def main() -> int:
    """Run all cells without a reason, a row in each process; write the pages if none fails."""
    with ProcessPoolExecutor(mp_context=get_context("spawn")) as processes:
        passed, total = np.sum([*processes.map(run_row, range(len(ROWS)))], axis=0)
    sys.stdout.write(f"{passed} of {total} cells passed\n")
    if passed == total:
        PAGE.write_text(page(), encoding="utf-8")
        README.write_text(readme(), encoding="utf-8")
    return int(passed < total)


if __name__ == "__main__":
    sys.exit(main())
