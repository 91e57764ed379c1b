"""References that are given: their torques by formulas of this file, their files, and errors of wrong ones."""

from dataclasses import replace
from math import comb, radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from casadi import SX, log, sin
from named import named
from numpy.typing import NDArray
from refusals import refusal
from scipy.interpolate import BPoly, CubicSpline

import gaitopt as go
from gaitopt import Mechanism, Mode
from gaitopt.errors import ProblemError, SolveError
from gaitopt.gait.curves import coefficients
from gaitopt.model.reference import Followed
from gaitopt.model.walkers.compass_biped import CompassBiped
from gaitopt.problem.problem import restore_problem
from gaitopt.store.run import Run
from gaitopt.systems import problem_dynamics

NAME = "compass-table"
STATE = np.array([0.05, -0.2, 0.0, 0.7, -0.4, 0.0])
POINTS = [-0.1, -0.05, 0.3, 0.14]
KP, KD = 30, 5
Array = NDArray[np.float64]


def with_reference(reference: object, **others: object) -> go.Problem:
    return go.load_problem(NAME).replace({"control.reference": reference} | others)


def torque(problem: go.Problem, t: float, z: Array = STATE) -> Array:
    dynamics = problem_dynamics(problem)
    segment = int(np.searchsorted(dynamics.system.control.breakpoints, t, side="right"))
    observed = dynamics.system.observation(Mode.STICK)(t, z, dynamics.p, dynamics.system.data(segment))
    return np.asarray(observed[1]).ravel()


def span(law: Any) -> tuple[float, float]:
    """Phase at both ends of the curve that a law follows."""
    (piece,) = law.reference.motion().pieces
    return piece.start, piece.end


def pd(angle: float, rate: float) -> Array:
    """Torques of ankle and hip at ``STATE`` if only the hip follows a reference."""
    return np.array([0, -KP * (STATE[1] - angle) - KD * (STATE[4] - rate)])


def bezier(s: float, order: int = 0) -> float:
    points = np.array(POINTS)
    for _ in range(order):
        points = np.diff(points) * (len(points) - 1)
    n = len(points) - 1
    return float(sum(comb(n, k) * c * s**k * (1 - s) ** (n - k) for k, c in enumerate(points)))


@pytest.mark.parametrize(
    ("beyond_end", "after"),
    [
        ("hold", pd(bezier(1), 0)),
        ("linear", pd(bezier(1) + 0.2 * bezier(1, 1) / 0.8, bezier(1, 1) / 0.8)),
        ("off", np.zeros(2)),
    ],
)
def test_bezier_curves_run_over_the_clock_and_then_as_stated(beyond_end: str, after: Array) -> None:
    problem = with_reference({"bezier": {"theta2": POINTS}, "duration": 0.8, "beyond_end": beyond_end})
    assert torque(problem, 0.3) == pytest.approx(pd(bezier(0.3 / 0.8), bezier(0.3 / 0.8, 1) / 0.8), abs=1e-12)
    assert torque(problem, 1.0) == pytest.approx(after, abs=1e-12)


@pytest.mark.parametrize(
    "reference",
    [
        {"bezier": {"theta2": POINTS}},
        {"table": {"theta1": np.linspace(-0.1, 0.3, 9), "theta2": [bezier(s) for s in np.linspace(0, 1, 9)]}},
    ],
)
def test_curves_over_a_phase_variable_are_not_clamped(reference: dict[str, object]) -> None:
    """The curve of a cubic table is that of its control points; s = 0.375, and 1.125 beyond the span."""
    more = {"span": [-0.1, 0.3]} if "bezier" in reference else {"degree": 3}
    problem = with_reference({**reference, **more, "phase": "theta1"})
    for theta1 in (STATE[0], 0.35):
        s = (theta1 + 0.1) / 0.4
        expected = pd(bezier(s), bezier(s, 1) * STATE[3] / 0.4)
        z = np.array([theta1, *STATE[1:]])
        assert torque(problem, 5.0, z) == pytest.approx(expected, abs=1e-10)


def test_a_table_is_a_cubic_spline_through_its_rows() -> None:
    """A cubic is its own spline; the ends of the table are its first and its last row."""
    times = np.array([0, 0.1, 0.25, 0.4, 0.8])
    table = {"t": times, "theta2": [bezier(t / 0.8) for t in times]}
    problem = with_reference({"table": table, "beyond_end": "linear"})
    assert problem.control.breakpoints == tuple(times[1:])
    for t in (0.0, 0.2, 0.7, 1.0):
        s = min(t / 0.8, 1)
        rate = bezier(s, 1) / 0.8
        assert torque(problem, t) == pytest.approx(pd(bezier(s) + rate * max(t - 0.8, 0), rate), abs=1e-12)


def test_results_state_how_far_the_ends_of_a_table_are_from_the_joint() -> None:
    """The last angle of the spline is that at the impact, from ``scipy`` and the rows of the file."""
    gait = named(NAME)
    record = gait.to_record()
    spline = CubicSpline(np.arange(9) / 10, np.radians([-6, -4, 0, 5, 9, 11, 11, 9, 8]))
    before = gait.arcs[-1].states[-1]
    errors = record["tracking_errors"]["theta2"]
    assert errors["start"] == pytest.approx(gait.state[1] - radians(-6), abs=1e-12)
    assert errors["end"] == pytest.approx(before[1] - spline(gait.period), abs=1e-12)
    assert record["control"] == {"kp": KP, "kd": KD}
    assert not {"control", "tracking_errors"} & {*named("compass-passive-b").to_record()}


def test_ends_of_a_table_far_from_the_joint_are_remarked() -> None:
    """After the impact the joint is at -0.085; before it the legs have each other's angle, with the other sign."""
    assert not go.load_problem(NAME).remarks
    loose = with_reference({"table": {"t": [0, 0.4, 0.8], "theta2": [0.2, 0, -0.1]}, "beyond_end": "off"})
    words = [line.partition("table: table: ")[2] for line in loose.remarks]
    end = "at the guess; the torques jump at the impact"
    assert words == [
        f"the first value of theta2 is 0.285 rad from its joint just after the impact, {end}",
        f"the last value of theta2 is 0.185 rad from its joint just before the impact, {end}",
    ]
    over_phase = {"table": {"theta1": [-0.085, 0, 0.085], "theta2": [-0.085, 0, 0.2]}, "degree": 2, "phase": "theta1"}
    assert ["last value of theta2 is 0.115 rad" in line for line in with_reference(over_phase).remarks] == [True]


def test_joints_may_follow_those_of_another_walker() -> None:
    other = named("torso-passive")
    problem = with_reference({"gait": "torso-passive", "joints": {"theta2": "torso"}, "beyond_end": "hold"})
    arc, k = other.arcs[0], other.problem.walker.shape.index("torso")
    s = 2 * 0.2 / arc.duration - 1
    angle, rate = np.polynomial.chebyshev.chebval(s, coefficients(arc.states))[[k, other.system.n_shape + 1 + k]]
    assert torque(problem, 0.2) == pytest.approx(pd(angle, rate), abs=1e-9)


def test_a_gait_cannot_be_followed_over_a_phase_that_turns_back_in_it() -> None:
    turning = {"gait": "compass-passive-b", "phase": "theta2", "joints": {"theta1": "theta1"}, "degree": 6}
    with pytest.raises(SolveError, match="the phase variable theta2 is not monotone along compass-passive-b: it t"):
        problem_dynamics(with_reference(turning))


@pytest.mark.slow
def test_a_free_set_point_gives_the_step_length_of_the_fixed_one() -> None:
    upright = go.load_problem("torso-upright")
    expected = go.solve(upright.replace({"control.reference.constant.theta2": "12 deg"}))
    free = {"free": ["8 deg", "14 deg"], "guess": "10 deg"}
    design = upright.replace(
        {"control.reference.constant.theta2": free, "constraints": {"step_length": expected.scalar("step_length")}}
    )
    gait = go.solve(design)
    assert gait.freed == {"control.reference.constant.theta2": pytest.approx(radians(12), abs=1e-7)}
    assert go.verify(gait).passed
    again = design.with_guess(gait.to_record())
    assert again.parameters["control.reference.constant.theta2"] == pytest.approx(radians(12), abs=1e-7)


def test_verify_states_that_the_phase_does_not_turn_back() -> None:
    rows = [-0.1, -0.12706416905448156, -0.045, 0.419, 0.156, 0.139, 0.1]
    reference = {"bezier": {"theta2": rows}, "phase": "theta1", "span": [-0.1, 0.1]}
    control = {"type": "pd", "kp": 300, "kd": 30, "reference": reference}
    gait = go.solve(go.load_problem("compass-virtual-constraint").replace({"control": control}))
    claims = {claim.name: claim for claim in go.verify(gait).claims}
    assert all(claim.passed for claim in claims.values())
    arc, unit = gait.arcs[0], gait.dynamics.scales.time
    slowest = min(arc.states[:, gait.system.n_shape + 1])
    assert claims["phase variable"].figure == pytest.approx(-slowest * unit, rel=1e-3)
    assert "phase variable" not in {claim.name for claim in go.verify(named(NAME)).claims}


def test_a_phase_that_turns_back_is_named() -> None:
    reference = {"bezier": {"theta1": [-0.1, 0.1]}, "phase": "theta2", "span": [-0.1, 0.1]}
    changes = {"control": {"type": "pd", "kp": 0, "kd": 0, "reference": reference}}
    gait = go.solve(go.load_problem("compass-passive-stick").replace(changes))
    assert [cause.what for cause in gait.causes] == ["phase"]
    assert "the phase variable theta2 is not monotone: it turns back 0.0" in gait.message


class Faulty(go.Control):
    """Holds the hip at the first angle of another gait's swing leg, wrongly."""

    type = "faulty"

    reference: Followed
    mistake: str

    @property
    def breakpoints(self) -> tuple[float, ...]:
        return self.reference.motion().breakpoints

    @property
    def horizon(self) -> float:
        return self.reference.motion().horizon

    def data(self, segment: int) -> Array:
        return self.reference.motion().data(segment)

    def torques(self, now: go.Instant) -> dict[str, SX]:
        target, active = self.reference.motion().weighted(now, now.p.reference, (1, 0))
        return {"hip": log(-1 - now.q.theta2**2) if self.mistake == "nan" else active * (1 + target[0])}


@pytest.mark.parametrize(
    ("mistake", "words"),
    [("nan", "Faulty: the torque of hip is nan at the guess"), ("jump", "Faulty: the torque of hip jumps from 1.")],
)
def test_a_law_with_a_gait_is_checked_once_that_is_solved(mistake: str, words: str) -> None:
    control = f"{{type: faulty, mistake: {mistake}, reference: {{gait: compass-passive-b, beyond_end: off}}}}"
    text = f"{go.load_problem('compass-passive-stick').text}\ncontrol: {control}\n"
    problem = go.parse_problem(text, controls=[Faulty])
    with pytest.raises(ProblemError, match=rf"control: {words}"):
        problem_dynamics(problem)


class Short(go.Control):
    """Turns the swing leg for 0.3 s."""

    type = "short"

    @property
    def horizon(self) -> float:
        return 0.3

    def torques(self, now: go.Instant) -> dict[str, SX]:
        return {"hip": 30 * (0.14 - now.q.theta2) - 5 * now.dq.theta2}


def test_a_law_that_ends_before_the_step_does_is_named() -> None:
    text = go.load_problem(NAME).text
    control = text[text.index("control:") : text.index("gait:")]
    gait = go.solve(go.parse_problem(text.replace(control, "control: {type: short}\n"), controls=[Short]))
    assert [cause.what for cause in gait.causes] == ["control"]
    assert "the control law ends 0.3 s after the impact, but the step takes at least 0.68" in gait.message


class HipCompass(CompassBiped):
    """A compass that names the position of its hip along the ground."""

    model = "hip_compass"
    phases = ("hip_x",)

    @classmethod
    def mechanism(cls, q: Any, p: Any) -> Mechanism:
        return replace(CompassBiped.mechanism(q, p), phases={"hip_x": p.leg_length * sin(q.theta1)})


def test_free_curves_need_no_start_where_points_and_duration_or_span_are_given() -> None:
    walker = type(go.load_problem(NAME).walker)
    points, free = {"theta2": [-0.1, 0.2, 0.1]}, [{"free": [-0.6, 0.6], "guess": c} for c in (-0.1, 0.2, 0.1)]
    for over in ({"beyond_end": "hold"}, {"phase": "theta1", "span": [-0.1, 0.1]}):
        keys = {**over, "duration": 0.8} if "beyond_end" in over else over
        curve = {"degree": 2, "points": points} | ({"duration": 0.8} if "beyond_end" in over else {})
        mine = with_reference({"curve": curve, **over}, objective="torque_squared")
        other = with_reference({"bezier": {"theta2": free}, **keys}, objective="torque_squared")
        assert mine.control == other.control
        assert mine.digest == other.digest
        assert len(mine.control.unknowns(walker)) == 3


def test_a_phase_that_the_walker_names() -> None:
    """The position of the hip: its rate is that of the angle times l cos(theta1)."""
    text = go.load_problem(NAME).text.replace("compass_biped", "hip_compass")
    base = go.parse_problem(text.replace("table: compass-table.csv, beyond_end: hold", "constant: {theta2: 0}"),
                            walkers=[HipCompass])  # fmt: skip
    curve = {"bezier": {"theta2": POINTS}, "phase": "hip_x", "span": [-0.15, 0.2]}
    problem = base.replace({"control.reference": curve})
    s = (1.6 * np.sin(STATE[0]) + 0.15) / 0.35
    rate = 1.6 * np.cos(STATE[0]) * STATE[3] / 0.35
    assert torque(problem, 1.0) == pytest.approx(pd(bezier(s), bezier(s, 1) * rate), abs=1e-12)
    with pytest.raises(ProblemError, match="no phase variable 'hip'; it has theta1, theta2, hip_x; clock is the time"):
        base.replace({"control.reference": {**curve, "phase": "hip"}})


def test_a_gait_is_followed_over_a_phase_that_the_walker_names(tmp_path: Path) -> None:
    """The gait follows a curve over theta1, hence over the position of the hip, l sin(theta1)."""
    source = go.load_problem("compass-virtual-constraint")
    rows = source.control.reference.bezier["theta2"]  # type: ignore[attr-defined]
    (tmp_path / "source.yaml").write_text(source.text.replace("compass_biped", "hip_compass"))
    text = go.load_problem(NAME).text.replace("compass_biped", "hip_compass")
    reference = "gait: source.yaml, phase: hip_x, joints: {theta2: theta2}, degree: 10"
    text = text.replace("table: compass-table.csv, beyond_end: hold", reference)
    problem = go.parse_problem(text, tmp_path / "follower.yaml", walkers=[HipCompass])
    assert restore_problem(problem.resolved(), walkers=[HipCompass]).digest == problem.digest
    law = problem_dynamics(problem).system.control
    assert span(law) == pytest.approx((-1.6 * np.sin(0.1), 1.6 * np.sin(0.1)), abs=1e-9)  # type: ignore[attr-defined]
    assert law.reference.motion().fit_errors["theta2"] < 1e-6  # type: ignore[attr-defined]
    s = (STATE[0] + 0.1) / 0.2
    angle = BPoly([[c] for c in rows], [0, 1])
    assert torque(problem, 1.0) == pytest.approx(pd(angle(s), angle.derivative()(s) * STATE[3] / 0.2), abs=1e-3)


# files


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """The problem ``compass-table`` with its table in a folder beside it."""
    (tmp_path / "tables").mkdir()
    shipped = go.load_problem(NAME).path
    assert shipped is not None
    (tmp_path / "tables" / "swing.csv").write_text(shipped.with_suffix(".csv").read_text())
    (tmp_path / "walk.yaml").write_text(shipped.read_text().replace("compass-table.csv", "tables/swing.csv"))
    return tmp_path / "walk.yaml"


def test_a_table_enters_the_hash_and_stays_in_the_run(file: Path) -> None:
    problem, table = go.load_problem(file), file.parent / "tables" / "swing.csv"
    text = table.read_text()
    table.write_text(text.replace("11", "10"))
    assert go.load_problem(file).digest != problem.digest
    table.write_text(text)
    assert go.load_problem(file).digest == problem.digest
    run = Run(file.parent / "run")
    run.folder.mkdir()
    gait = go.solve(problem)
    with run.begun(problem):
        pass
    table.unlink()
    file.unlink()
    assert (run.folder / "control.reference.csv").read_text() == text
    restored = run.problem()
    assert restored.digest == problem.digest
    assert go.solve(restored).period == gait.period


def test_a_table_is_found_beside_its_problem_by_overrides_too(file: Path) -> None:
    (file.parent / "other.csv").write_text("t,theta2\n0,-0.1\n0.8,0.1\n")
    problem = go.load_problem(file).replace({"control.reference.table": "other.csv"})
    assert problem.control.reference.table.file == "other.csv"  # type: ignore[attr-defined]
    array = problem.replace({"control.reference.table": {"t": np.array([0, 0.8]), "theta2": np.array([-0.1, 0.1])}})
    assert torque(array, 0.3) == pytest.approx(torque(problem, 0.3), abs=1e-14)


def test_the_gait_of_a_stored_run_can_be_followed(file: Path) -> None:
    followed = go.load_problem("compass-passive-b").replace({"walker.slope": "1 deg"})
    run = Run(file.parent / "runs" / "passive")
    run.folder.mkdir(parents=True)
    with run.begun(followed):
        pass
    text = file.read_text().replace("table: tables/swing.csv, beyond_end", "gait: runs/passive, beyond_end")
    file.write_text(text)
    problem = go.load_problem(file)
    assert problem.reference is not None
    assert problem.reference.digest == followed.digest
    assert restore_problem(problem.resolved()).digest == problem.digest
    (run.folder / "resolved.json").write_text("[")
    with pytest.raises(ProblemError, match=r"18:15 control.reference.gait: .*resolved.json:1:1: is not JSON"):
        go.load_problem(file)
    (run.folder / "resolved.json").unlink()
    with pytest.raises(ProblemError, match=r"18:15 control.reference.gait: .*resolved.json:1:1: no such file"):
        go.load_problem(file)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("t,theta2\n0,0.1\n0.1\n", "swing.csv:3: has 1 entry, must have 2, one for each column"),
        ("# degrees\nt,theta2 [deg]\n\n0,1\n0.1,x\n", "swing.csv:5: 'x' is not a number"),
        ("t,theta2\n0,0\n0.1,1_0\n", "swing.csv:3: '1_0' is not a number"),
        ("t,theta2\n0,0\n0.1,nan\n", "swing.csv:3: theta2 = nan is not a finite number"),
        ("t,theta2\n0,0\n0.2,1e9\n", "swing.csv:3: theta2 = 1e9 is not a finite number of at most 1000"),
        ("t,theta2\n0,0\n0.2,0\n0.2,0.1\n", "swing.csv:4: t = 0.2 after 0.2; it must increase from row to row"),
        ("t,theta2\n0.1,0\n0.2,0\n", "swing.csv: t starts at 0.1 and ends at 0.2, but must rise from 0"),
        ("theta1,theta2\n0,0\n0.2,0\n", "swing.csv: its first column is theta1, but must be t"),
        ("t,torso\n0,0\n0.2,0\n", "torso is not a tracked joint of compass_biped; the tracked joints are theta1"),
        ("t,theta2\n0,0\n0.2,2\n", "swing.csv: theta2 reaches 2 rad, which is impossible: angles of compass_biped"),
        ("t,theta2\n0,0\n", "swing.csv has 1 row of numbers, must have from 2 to"),
        ("0,0\n0.1,1\n", "swing.csv:1: '0,0' does not name the columns: it must have a line of names such as t,theta2"),
        ("t\n0\n", "swing.csv:1: one column is not enough"),
        ("t,t\n0,1\n1,2\n", "swing.csv:1: two columns have one name"),
        ("", "swing.csv is empty: it must have a line of names"),
        (b"\xff\xfe", "swing.csv:1:1: byte 0xff is not UTF-8 text"),
        (None, "swing.csv:1:1: no such file"),
    ],
)
def test_a_wrong_table_is_one_sentence_with_file_and_line(file: Path, content: Any, words: str) -> None:
    table = file.parent / "tables" / "swing.csv"
    if content is None:
        table.unlink()
    else:
        table.write_bytes(content if isinstance(content, bytes) else content.encode())
    told = refusal(go.load_problem, file)
    assert told.startswith(f"{file}:18:15 control.reference.table: ")
    assert words in told


CURVE = {"bezier": {"theta2": [0, 0.1]}}
TIME, EMPTY = {"duration": 1, "beyond_end": "off"}, {"free": [1, 0], "guess": 0}
FREE, HELD, OFF = {"degree": 2, "duration": 1}, {"beyond_end": "hold"}, {"beyond_end": "off"}
FLAT = {"curve": {"degree": 2, "points": {"theta2": [0, 0, 0]}}}
TIMED, LONG = {"t": [0, 1], "theta2": [0, 1]}, {"t": np.arange(80), "theta2": np.zeros(80)}
PASSIVE, TORSO = {"gait": "compass-passive-b"}, {"gait": "torso-passive", "beyond_end": "hold"}
THETA1 = {"phase": "theta1", "span": [0, 1]}
OVER_PHASE = {"gait": "compass-passive-b", "phase": "theta1", "joints": {"theta2": "theta2"}}


@pytest.mark.parametrize(
    ("reference", "key", "words"),
    [
        ({}, "", "does not say what to follow: give one of {constant: {JOINT: 10 deg}} or {bezier:"),
        (3, "", "give one of {constant: {JOINT: 10 deg}} or"),
        ({"constant": {"theta2": 0.1}, "gait": "x"}, "", "has both constant and gait: give one of {constant:"),
        ({"constant": {"theta2": 0.1}, "beyond_end": "hold"}, "", "beyond_end does not belong to constant, which has"),
        ({"bezier": {"theta2": [0]}, **TIME}, ".bezier.theta2", "has 1 control point, must have at least 2"),
        ({"bezier": {"hip": [0, 1]}, "duration": 1, "beyond_end": "off"}, ".bezier.hip", "is not a tracked joint"),
        ({"bezier": {}, "duration": 1, "beyond_end": "off"}, ".bezier", "has no curve: give the control points"),
        ({**CURVE, "beyond_end": "off"}, ".duration", "is missing: curves of time need their duration"),
        ({**CURVE, "duration": 1}, ".beyond_end", "is missing: give linear, hold or off, because a step may last"),
        ({**CURVE, "duration": 1, "beyond_end": "flow"}, ".beyond_end", "'flow' is not one of the choices"),
        ({**CURVE, "duration": 0, "beyond_end": "off"}, ".duration", "0 must be greater than 0"),
        ({**CURVE, "phase": "hip", "span": [0, 1]}, ".phase", "no phase variable 'hip'; it has theta1, theta2; clock"),
        ({**CURVE, "phase": "theta1"}, ".span", "is missing: curves of a phase variable need span: [START, END]"),
        ({**CURVE, "phase": "theta1", "span": [1, 1]}, ".span", "is empty: both ends are 1"),
        ({**CURVE, "phase": "theta2", "span": [0, 1]}, ".bezier.theta2", "is the phase variable"),
        ({**CURVE, "phase": "theta1", "span": [0, 1], "beyond_end": "hold"}, ".beyond_end", "applies only to curves"),
        ({**CURVE, "phase": "theta1", "span": [0, 1], "duration": 1}, ".duration", "does not apply"),
        ({"constant": {"theta2": {"free": [1, 0], "guess": 0.5}}}, ".constant.theta2.free", "is empty: [1, 0] needs"),
        ({"constant": {"theta2": {"free": [0, 0.1], "guess": 1}}}, ".constant.theta2.guess", "1 is outside of its"),
        ({"constant": {"theta2": {"free": [0], "guess": 0}}}, ".constant.theta2.free[1]", "is missing (bounds"),
        ({"constant": {"theta2": {"free": [0, 1]}}}, ".constant.theta2.guess", "is missing (first guess, within the"),
        ({"constant": {"theta2": {"fre": [0, 1]}}}, ".constant.theta2", "{'fre': [0, 1]} is not a number (angle of"),
        ({"bezier": {"theta2": [0, EMPTY]}, **TIME}, ".bezier.theta2[1].free", "is empty: [1, 0] needs lo < hi"),
        ({"constant": {"theta2": {**EMPTY, "gues": 0}}}, ".constant.theta2.gues", "unknown key; did you mean guess?"),
        ({"constant": {"theta2": {"free": [0, 3], "guess": 0}}}, ".constant.theta2", "3 is impossible: angles of"),
        ({"table": 3}, ".table", "3 is not a path of a CSV file"),
        ({"table": {"t": [0, 1], "theta2": [0]}}, ".table", "the columns differ in length (t: 2, theta2: 1)"),
        ({"table": {"t": [0, 1], "theta2": "x"}}, ".table", "the column theta2 is not a list of numbers"),
        ({"table": {"t": [0, 1], "theta2": [[0], [0, 1]]}}, ".table", "the column theta2 is not a list of numbers"),
        ({"table": {"t": [0, 1], "theta2": [0, 1]}}, ".beyond_end", "is missing: give linear, hold or off"),
        ({"table": {"theta1": [0, 1], "theta2": [0, 1]}, "phase": "theta1"}, ".degree", "is missing: curves of a "),
        ({"table": TIMED, "degree": 2, **OFF}, ".degree", "2 is too large: 2 rows determine at most 1"),
        ({"table": LONG, **OFF}, ".degree", "is missing: a spline through 80 rows divides the motion at every row"),
        ({"gait": "compass-passive-b"}, ".beyond_end", "is missing: give flow, linear, hold or off, because a step"),
        ({"gait": "compass-passive-b", "beyond_end": "off", "degree": 6}, ".degree", "does not apply: without a phase"),
        ({"gait": "compass-passive-b", "phase": "theta1", "degree": 6}, ".phase", "theta1 cannot follow a curve that"),
        ({**OVER_PHASE}, ".degree", "is missing: curves of a phase variable are polynomials"),
        ({**OVER_PHASE, "degree": 6, "span": [1, 1]}, ".span", "is empty: both ends are 1"),
        ({**OVER_PHASE, "degree": 6, "phase": "hip"}, ".phase", "no phase variable 'hip'; it has theta1, theta2;"),
        ({"gait": "compass-passive-b", "span": [0, 1], "beyond_end": "off"}, ".span", "does not apply to curves"),
        ({"curve": {"degree": 2, "start": "compass-passive-b"}}, ".beyond_end", "is missing: give linear, hold or off"),
        ({**FLAT, **HELD}, ".curve.duration", "is missing: curves of time need their duration"),
        ({"curve": {"degree": 2}, "beyond_end": "hold"}, ".curve.start", "is missing: give a problem whose gait is"),
        (
            {**FLAT, "phase": "theta1"},
            ".span",
            "is missing: curves of a phase variable need span: [START, END]",
        ),
        ({"curve": {**FREE, **FLAT["curve"]}, "span": [0, 1], **HELD}, ".span", "does not apply to curves of time"),
        ({"curve": {**FREE, **FLAT["curve"]}, **THETA1}, ".curve.duration", "does not apply: curves of a phase"),
        ({"curve": {**FREE, "points": {"theta2": [0, 0, 0.7]}}, **HELD}, ".curve.points.theta2[2]", "0.7 is outside"),
        ({"curve": {**FREE, "points": {"theta2": [0, 0]}}, **HELD}, ".curve.points.theta2", "of degree 2 has 3"),
        ({"curve": {**FREE, "points": {"hip": [0, 0, 0]}}, **HELD}, ".curve.points.hip", "is not a tracked joint of"),
        (
            {"curve": {**FREE, **FLAT["curve"], "invariant": True}, **HELD},
            ".curve.invariant",
            "applies to virtual_const",
        ),
        ({"curve": {"degree": 2, "start": "compass-passive-b"}, "phase": "theta1"}, ".phase", "theta1 cannot follow"),
        ({**OVER_PHASE, "degree": 6, "beyond_end": "off"}, ".beyond_end", "applies only to curves of time"),
        (TORSO, ".gait", "say which of them each joint follows, joints: {th"),
        ({**PASSIVE, "joints": {"hip": "theta1"}, **HELD}, ".joints.hip", "not a tracked joint"),
        ({**TORSO, "joints": {"theta2": "knee"}}, ".gait", "which has no knee to"),
    ],
)
def test_a_wrong_reference_is_one_sentence_that_shows_the_right_form(reference: Any, key: str, words: str) -> None:
    told = refusal(with_reference, reference)
    assert f"control.reference{key}: " in told
    assert words in told


@pytest.mark.parametrize(
    ("reference", "key", "meaning"),
    [
        ({"constant": {"theta2": "x deg"}}, ".constant.theta2", "write an angle as a number in rad"),
        ({"constant": {"theta2": 2000}}, ".constant.theta2", "(angle of each tracked joint [rad], a number or an unkn"),
        ({"bezier": {"theta2": [0, 2000]}, **TIME}, ".bezier.theta2[1]", "(control points of each curve [rad]; "),
        ({**CURVE, "beyond_end": 3, "duration": 1}, ".beyond_end", "allowed: linear, hold, off"),
        ({**CURVE, "phase": ""}, ".phase", "(argument of the curves: clock (time since the impact), a shape coordin"),
        ({"table": TIMED, "degree": 0, **OFF}, ".degree", "(degree of the polynomials fitted to the rows; by "),
        ({"table": TIMED, "phase": "", **OFF}, ".phase", "a shape coordinate or a phase variable)"),
        ({"table": TIMED, "beyond_end": "flow"}, ".beyond_end", "allowed: linear, hold, off"),
        ({**PASSIVE, "degree": 0}, ".degree", "(degree of the polynomials fitted to the gait's angles as functions"),
        ({**PASSIVE, "phase": ""}, ".phase", "a shape coordinate or a phase variable; by default the clock)"),
        ({**PASSIVE, "beyond_end": "of"}, ".beyond_end", "did you mean off?"),
        ({"curve": {"degree": 0}, **HELD}, ".curve.degree", "(degree of the curve of each joint)"),
        ({"curve": FREE, "span": 0, **HELD}, ".span", "(values of the phase variable at the start and the end of"),
    ],
)
def test_a_wrong_value_is_explained_by_the_kind_of_its_reference(reference: Any, key: str, meaning: str) -> None:
    told = refusal(with_reference, reference)
    assert f"control.reference{key}: " in told
    assert meaning in told
