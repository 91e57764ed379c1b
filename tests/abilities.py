"""Every verb for every kind of walker: the table of docs/abilities.md, and how each of its cells is checked.

    python tests/abilities.py           writes the page
    python -m pytest -m slow tests/test_abilities.py -k "crawler or attractors"

A row is an example of one structure, a column is one verb with a check by other means. A cell without a reason passes
its check. A cell with a reason does not apply: the reason is mathematics or physics.
"""

import json
import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib.pyplot as plt
import numpy as np
import pytest
from own_laws import DampedCompass, HipDamper

import gaitopt as go
from gaitopt.problem.statement import problem_data
from gaitopt.requests import Engine
from gaitopt.show.catalogue import figures_of

PAGE = Path(__file__).resolve().parent.parent / "docs" / "abilities.md"
FEW: Mapping[str, Any] = {"workers": 1, "progress": False}
NEAR = 1.001
"""Factor of the parameter in sweeps, families and designs."""
GRAVITY = "walker.gravity"
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
    example : in words, and its problem.
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
        return go.parse_problem(json.dumps(data), walkers=[DampedCompass], controls=[HipDamper])

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
FRICTIONLESS = _changed("compass-torque-impact-slip", impact_law="frictionless")
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
    _named("static and kinetic friction", "compass-passive-static-kinetic"),
    Row("frictionless impact", "`compass-torque-impact-slip` with such an impact", FRICTIONLESS),
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
    assert go.verify(gait_of(row)).passed


def _continue(row: Row, folder: Path) -> None:
    value, alone = _changed_gait(row)
    end = go.continuation(gait_of(row), GRAVITY, to=value, progress=False)[-1].gait
    assert end.period == pytest.approx(alone.period, rel=_close(row))


def _find(row: Row, folder: Path) -> None:
    found = go.find(row.problem(), starts=1, steps=len(gait_of(row).steps), **FEW)
    assert any(gait.period == pytest.approx(gait_of(row).period, rel=1e-7) for gait in found)


def _sweep(row: Row, folder: Path) -> None:
    value, alone = _changed_gait(row)
    swept = go.sweep(row.problem(), {GRAVITY: (value / NEAR, value, 2)}, output=folder, **FEW)
    assert swept.column("period") == pytest.approx([gait_of(row).period, alone.period], rel=_close(row))


def _design(row: Row, folder: Path) -> None:
    gait = gait_of(row)
    problem, name = gait.problem, "speed" if abs(gait.scalar("speed")) > 1e-6 else "period"
    gravity, wanted = problem.parameters[GRAVITY], NEAR * gait.scalar(name)
    free = {"free": [gravity / 1.2, gravity * 1.2], "guess": gravity}
    designed = go.solve(problem.replace({GRAVITY: free, f"constraints.{name}": wanted}), progress=False)
    assert designed.converged, designed.message
    found = designed.to_record()["parameters"][GRAVITY]
    alone = go.solve(problem.replace({GRAVITY: found}), progress=False)
    assert alone.scalar(name) == pytest.approx(wanted, rel=1e-7)


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
    loaded = go.load_run(gait.save(folder / "run"), walkers=[DampedCompass], controls=[HipDamper])
    assert (loaded.problem.digest, loaded.cycle) == (gait.problem.digest, gait.cycle)
    assert loaded.state.tolist() == gait.state.tolist()
    for name, value in gait.measures.items():
        assert loaded.measures[name] == (value if value is None else pytest.approx(value, rel=1e-9, abs=1e-12)), name


@dataclass(frozen=True)
class Column:
    """A verb and the check of its cells."""

    name: str
    words: str
    check: Callable[[Row, Path], None]


COLUMNS = (
    Column(
        "Newton",
        "`solve` by Newton's method from the gait at another gravity; a simulated cycle takes as long",
        _newton,
    ),
    Column("IPOPT", "`solve` by IPOPT has the period that Newton's method finds", _ipopt),
    Column("nlp", "`casadi.nlpsol` solves the program of `nlp` from the gait at another gravity", _nlp),
    Column("simulate", "`simulate` is back at the gait after two cycles", _simulate),
    Column("verify", "`verify` passes", _verify),
    Column("continue", "`continue` in gravity ends at the gait that is solved there anew", _continue),
    Column("find", "`find` lists the gait among those to which walks lead", _find),
    Column("sweep", "`sweep` over gravity has the periods of gaits that are solved alone", _sweep),
    Column("design", "gravity for a given speed or period; a gait with this gravity has it", _design),
    Column("basin, SciPy", "`basin`: starts next to the gait settle on it, as `solve` confirms", _basin("scipy")),
    Column("basin, heyoka", "the same on heyoka, many states at once", _basin("heyoka")),
    Column("attractors", "`attractors`: the Lyapunov exponent is the logarithm of the largest multiplier", _attractors),
    Column("figures", "every figure of `plot` is drawn", _figures),
    Column("save", "`load_run` reads the same problem, modes, state and scalars back", _save),
)
OPTIMA = "the optimum at another gravity has other torques; `sweep` and `front` follow optima"
NO_LAW = (
    "`find` and `attractors` walk from states, but the guess of this example is a step length; without a guess `find` "
    "lists the gait, and `attractors` walks from the state of the gait"
)
UNSTABLE = "the gait of this example is unstable: walks that start next to it leave it"
REASONS: Mapping[tuple[str, str], str] = {
    ("frictionless impact", "basin, SciPy"): UNSTABLE,
    ("frictionless impact", "basin, heyoka"): UNSTABLE,
    ("frictionless impact", "attractors"): UNSTABLE,
    ("open-loop torques", "Newton"): "free torques are more unknowns than equations, so that an objective chooses them",
    ("open-loop torques", "find"): NO_LAW,
    ("open-loop torques", "attractors"): NO_LAW,
    ("open-loop torques", "continue"): OPTIMA,
}
"""Why a cell does not apply, by row and column."""


def page() -> str:
    """The page with the table."""
    numbers = {reason: k for k, reason in enumerate(dict.fromkeys(REASONS.values()), start=1)}
    lines = [
        "# Every verb for every walker",
        "",
        "Each cell with a tick is run on the example of its row, with the check of its column, by",
        "`python -m pytest -m slow tests/test_abilities.py`. A number refers to the reason why a cell does not apply.",
        "`python tests/abilities.py` writes this page.",
        "",
        "| structure | example | " + " | ".join(column.name for column in COLUMNS) + " |",
        "|---|---|" + "---|" * len(COLUMNS),
    ]
    for row in ROWS:
        reasons = (REASONS.get((row.name, column.name)) for column in COLUMNS)
        cells = ("✓" if reason is None else str(numbers[reason]) for reason in reasons)
        lines.append(f"| {row.name} | {row.example} | {' | '.join(cells)} |")
    lines += ["", "## Checks", "| column | check |", "|---|---|"]
    lines += [f"| {column.name} | {column.words} |" for column in COLUMNS]
    if numbers:
        lines += ["", "## Reasons"]
        lines += [f"{number}. {reason[0].upper()}{reason[1:]}." for reason, number in numbers.items()]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
