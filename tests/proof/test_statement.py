"""What the printed statement of a theorem says of laws, robots and classes of other packages; units; equal steps."""

from pathlib import Path

import numpy as np
import pytest
from certificates import failed, gait, proof, restored, through_json
from flint import arb, ctx
from named import solved

import gaitopt as go
from gaitopt.model.reference import TableReference
from gaitopt.model.tracking import ProportionalDerivative
from gaitopt.proof.arithmetic import PRECISION
from gaitopt.proof.check import check
from gaitopt.proof.law import exact_law
from gaitopt.proof.law_data import DURATION_ERROR, duration_claim
from gaitopt.proof.prove import arc_records, arcs_of, certificate_header
from gaitopt.proof.taylor import PhaseSpace, VectorField

ORBITS = Path(__file__).parents[2] / "results" / "reference-orbits"


# control laws


def tracking(table):
    return ProportionalDerivative(kp=1.0, kd=1.0, reference=TableReference.model_validate(table))


@pytest.mark.parametrize("rows", [2, 3, 4, 5, 30])
@pytest.mark.parametrize("beyond_end", ["hold", "linear", "off"])
def test_a_table_is_a_spline_in_balls(rows, beyond_end):
    """SciPy's not-a-knot spline in doubles lies next to it; at its knots it has the values of the table."""
    rng = np.random.default_rng(rows)
    times = np.round(np.append(0.0, np.cumsum(rng.uniform(0.02, 0.1, rows - 1))), 4)
    angles = np.round(rng.normal(size=rows), 3)
    law = tracking({"table": {"t": times.tolist(), "theta2": angles.tolist()}, "beyond_end": beyond_end})
    with ctx.workprec(PRECISION):
        exact = exact_law(law, lambda key, value: repr(value))
        for k, data in enumerate(exact.data):
            np.testing.assert_allclose([float(value) for value in data], law.data(k), rtol=1e-10, atol=1e-10)
        width = (len(exact.data[0]) - 3) // 2
        for data, angle in zip(exact.data, angles, strict=True):  # the series at the start of each piece
            start = sum((-c if k % 2 else c for k, c in enumerate(data[3 : 3 + width])), arb(0))
            assert start.overlaps(arb(repr(float(angle))))
            assert float(start.rad()) < 1e-25
        assert exact.breakpoints[0].overlaps(arb(repr(float(times[1]))))


def test_a_fit_in_balls_is_the_least_squares_fit():
    rng = np.random.default_rng(1)
    table = {"t": np.linspace(0, 0.8, 30).round(4).tolist(), "theta2": rng.normal(size=30).round(3).tolist()}
    law = tracking({"table": table, "degree": 8, "beyond_end": "hold"})
    with ctx.workprec(PRECISION):
        exact = exact_law(law, lambda key, value: repr(value))
    np.testing.assert_allclose([float(value) for value in exact.data[0]], law.data(0), rtol=1e-9)
    assert max(float(value.rad()) for value in exact.data[0]) < 1e-20


@pytest.mark.parametrize("ratio", [1 - 2 * DURATION_ERROR, 1 + 2 * DURATION_ERROR])
def test_a_duration_is_the_period_of_a_gait_up_to_its_error(ratio):
    with ctx.workprec(PRECISION):
        period = arb("0.75", "1e-20")
        assert duration_claim(0.75, period, DURATION_ERROR, "a gait").proved
        assert not duration_claim(0.75 * ratio, period, DURATION_ERROR, "a gait").proved
        assert not duration_claim(0.75, arb("0.75", "1e-9"), DURATION_ERROR, "a gait").proved


@pytest.mark.slow
def test_a_gait_that_follows_a_table_is_proved_from_its_decimals():
    result = proof("compass-table")
    assert result.proved, failed(result)
    assert result.statement["law"]["reference.table.theta2"].startswith("-6 deg, -4 deg")
    assert "not-a-knot" in result.statement["law"]["reference.curve"]


@pytest.mark.slow
def test_a_designed_curve_over_a_phase_variable_is_proved_or_refused_in_words():
    """It has no duration; its span is that of the file, or that of another gait, which no certificate covers."""
    text = go.load_problem("compass-passive-stick").text.replace("name: compass-passive-stick", "name: over-phase")
    text = text.replace("slope: 1 deg", "slope: 0.5 deg").replace("friction: 0.2", "friction: 0.4")
    curve = "curve: {degree: 3, start: compass-passive-stick, within: 1}, joints: {theta2: theta2}, phase: theta1"
    for span, words in ((", span: [-0.15, 0.15]", ""), ("", "state it: span: [START, END]")):
        law = f"control: {{type: pd, kp: 30, kd: 4, reference: {{{curve}{span}}}}}\nobjective: torque_squared\n"
        result = go.prove(solved(go.parse_problem(text + law)), progress=False)
        assert result.proved is not bool(words), failed(result)
        assert words in failed(result).get("statement", "")
        assert words or result.statement["law"]["reference.span.1"] == "0.15"


# walkers


@pytest.mark.slow
def test_a_robot_from_a_file_is_printed_with_its_numbers():
    """A robot that calls itself like an included walker is told from it."""
    text = go.load_problem("compass-passive-stick").text
    start, end = text.index("  model:"), text.index("  gravity:")
    text = text[:start] + "  urdf: compass-passive-stick.urdf\n  feet: [stance_leg_foot, swing_leg_foot]\n" + text[end:]
    text = text.replace("theta1", "stance_leg").replace("theta2", "swing_leg")
    result = go.prove(solved(go.parse_problem(text, ORBITS / "x.yaml")), progress=False)
    assert result.proved, failed(result)
    words = result.statement["walker_data"]
    assert "compass-passive-stick.urdf" in words["walker"]
    assert words["link stance_leg"].startswith("mass 5.0, com [0.0, -0.64], inertia 0.512")
    assert len(words["expressions_sha256"]) == 64
    robot = (ORBITS / "compass-passive-stick.urdf").read_text()
    assert result.certificate["problem"]["files"]["compass-passive-stick.urdf"]["text"] == robot
    assert check(through_json(result.certificate)).to_record() == result.to_record()


def test_the_apparent_mass_has_the_static_coefficient_and_the_statement_says_that_sticking_is_chosen():
    """C_tt + mu_s C_nt and C_tt - mu_s C_nt, from the apparent masses at the kinetic coefficient of two systems."""
    walk = gait("compass-passive-static-kinetic")
    certificate = through_json(certificate_header(walk) | {"arcs": arc_records(arcs_of(walk))})
    words = "static and kinetic; sticking is chosen where both are consistent"
    assert restored(certificate).printed["friction"] == words
    y = [*map(arb, map(float, walk.arcs[1].states[0])), arb(0.1)]

    def masses(static, kinetic):
        p = dict(walk.dynamics.parameters) | {"friction.static": static, "friction.kinetic": kinetic}
        with ctx.workprec(PRECISION):
            values = [arb(float(p[key])) for key in walk.system.parameters]
            units = [1.0] * (walk.system.n_z + 1)
            field = VectorField(PhaseSpace(walk.system, None), go.Mode.STICK, values, [], units)
            return [float(value) for value in field.apparent_masses(y)[0]]

    assert masses(0.15, 0.12) == pytest.approx(masses(0.15, 0.15), rel=1e-14)
    (forward, backward), (wide, narrow) = masses(0.15, 0.12), masses(0.3, 0.12)
    assert wide - narrow == pytest.approx(2 * (forward - backward))  # C_tt +- mu_s C_nt
    assert wide + narrow == pytest.approx(forward + backward)
    assert abs(forward - backward) > 0.01


# units, and equal steps


def test_intervals_whose_corner_breaks_a_rule_between_parameters_are_refused():
    """Each end is possible with the other parameters of the file; only both together put the mass beyond the hip."""
    intervals = {"walker.leg_com": "0.8..1.0", "walker.leg_length": "0.9..1.7"}
    with pytest.raises(go.GaitoptError, match=r"contradict each other: .*leg_com = 1 m must be less than leg_length"):
        go.prove(gait("compass-passive-stick"), intervals, progress=False)


@pytest.mark.parametrize(
    ("name", "length", "size"),
    [
        ("rimless-wheel-slip", {"radius": 1.0, "gravity": 1.0}, 1e-6),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (
            ("rimless-wheel-slip", {"radius": 1.0, "gravity": 1.0}, 1e6),
            *(("compass-passive-a", {"leg_length": 1.6, "leg_com": 0.8, "gravity": 9.8}, size)
              for size in (1e-6, 1e-3, 1e3, 1e6)),
        )),
    ],
)  # fmt: skip
def test_a_proof_does_not_depend_on_the_unit_of_length(name, length, size):
    problem = go.load_problem(name).replace({f"walker.{key}": value * size for key, value in length.items()})
    result = go.prove(go.solve(problem.from_guess(), progress=False), progress=False)
    assert result.proved, failed(result)
    assert float(result.spectral_radius) == pytest.approx(gait(name).spectral_radius, abs=1e-9)
    assert name != "rimless-wheel-slip" or float(result.multipliers[0].real.rad()) < 1e-12


def test_a_cycle_of_two_equal_steps_does_not_have_the_least_period():
    assert proof("rimless-wheel-stick").minimal_period is True
    step = {"phases": ["stick"], "impact": "stick"}
    twice = go.load_problem("rimless-wheel-stick").replace({"gait.steps": [step, step]})
    result = go.prove(go.solve(twice, progress=False), progress=False)
    assert result.proved, failed(result)
    assert result.minimal_period is False
    assert result.to_record()["statement"]["not_proved"][-1] == "whether the period is the least one"
