"""Derivatives of gaits: against walks of the simulator at other parameters, closed forms, and where there are none."""

from collections.abc import Mapping
from math import cos

import numpy as np
import pytest
from named import named

import gaitopt as go
from gaitopt.arrays import Array
from gaitopt.design.derivatives import Derivatives, _stability
from gaitopt.design.sensitivity import Multiplier
from gaitopt.gait.gait import floquet_multipliers
from gaitopt.gait.measures import measure
from gaitopt.simulation.simulator import Simulator
from gaitopt.verification.return_map import ReturnMap

DIFFERENCE = 2e-4
"""Relative change of a parameter: with two differences, truncation is of fourth order."""
LENGTHS, MASSES = ("walker.leg_length", "walker.leg_com"), ("walker.leg_mass", "walker.hip_mass")


def walked(gait: go.Gait, changes: Mapping[str, float]) -> dict[str, complex]:
    """All quantities of the gait of the simulator at other parameters."""
    dynamics, cycle = gait.dynamics.at(changes), gait.cycle
    section = gait.system.section(cycle)
    return_map = ReturnMap(Simulator(dynamics), section, len(gait.steps), gait.state)
    point = return_map.fixed_point(gait.state[section.indices])
    assert point.converged
    assert point.jacobian is not None
    state = section.lift(point.xi, dynamics.p, gait.state)
    steps = Simulator(dynamics).run(state, steps=len(gait.steps), dense=True).steps
    values: dict[str, complex] = {
        f"state.{name}": x for name, x in zip(gait.system.state_names, state.tolist(), strict=True)
    }
    durations = [duration for step in steps for _, duration in step.phases]
    values |= {f"phases.{k}.duration": duration for k, duration in enumerate(durations)}
    values |= {name: value for name, value in measure(steps).items() if value is not None}
    multipliers = floquet_multipliers(point.jacobian)
    values |= {f"multipliers.{k}.re": m.real for k, m in enumerate(multipliers)}
    values |= {f"multipliers.{k}.im": m.imag for k, m in enumerate(multipliers)}
    return values | {"spectral_radius": float(np.abs(multipliers[0]))}


def by_differences(gait: go.Gait, key: str, h: float) -> dict[str, float]:
    """Central differences of the simulator, extrapolated from two lengths."""
    at = gait.dynamics.parameter(key)
    first, second = ([walked(gait, {key: at + sign * step}) for sign in (1, -1)] for step in (h, h / 2))
    coarse, fine = (
        {name: (ahead[name] - behind[name]).real / (2 * step) for name in ahead if name in behind}
        for (ahead, behind), step in ((first, h), (second, h / 2))
    )
    return {name: (4 * fine[name] - coarse[name]) / 3 for name in fine}


def assert_derivatives(gait: go.Gait, keys: tuple[str, ...]) -> None:
    found = go.sensitivity(gait)
    for key in keys:
        expected = by_differences(gait, key, DIFFERENCE * gait.dynamics.parameter(key))
        for quantity in found.quantities:
            value, reason = found.of(quantity, key), found.reasons.get(quantity)
            if reason is not None and np.isnan(value):
                continue
            assert value == pytest.approx(expected[quantity], rel=1e-6, abs=1e-6), (quantity, key)


def test_derivatives_of_gait_a_are_the_central_differences_of_the_simulator() -> None:
    assert_derivatives(named("compass-passive-a"), ("friction",))


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    ["compass-passive-a", "compass-passive-b", "compass-passive-two-step", "compass-unequal", "compass-torque-slip",
     "compass-push-off", "compass-virtual-constraint", "kneed-passive", "round-feet-passive", "rimless-wheel-slip",
     "heel-toe-slip", "flat-foot", "crawler", "hopper", "slip-run", "slip-walk"],
)  # fmt: skip
def test_derivatives_in_all_parameters_are_the_central_differences_of_the_simulator(name: str) -> None:
    gait = named(name)
    assert_derivatives(gait, tuple(key for key in go.sensitivity(gait).parameters if gait.dynamics.parameter(key)))


@pytest.mark.portable
def test_derivatives_obey_the_similarity_of_walkers() -> None:
    """Multipliers are ratios: neither the unit of mass nor that of length nor gravity changes them."""
    found = go.sensitivity(named("compass-passive-a"))

    def together(quantity: str, keys: tuple[str, ...]) -> float:
        at = dict(zip(found.parameters, found.at.tolist(), strict=True))
        return sum(at[key] * found.of(quantity, key) for key in keys)

    values = dict(zip(found.quantities, found.values.tolist(), strict=True))
    for quantity in ("multipliers.0.re", "multipliers.0.im", "multipliers.2.re", "spectral_radius", "state.theta1"):
        for keys in (LENGTHS, MASSES, ("walker.gravity",)):
            assert together(quantity, keys) == pytest.approx(0.0, abs=1e-9)
    assert together("step_length", LENGTHS) == pytest.approx(values["step_length"], abs=1e-10)
    assert together("min_normal_force", MASSES) == pytest.approx(values["min_normal_force"], abs=1e-7)
    assert together("period", LENGTHS) == pytest.approx(values["period"] / 2, abs=1e-10)
    assert together("period", ("walker.gravity",)) == pytest.approx(-values["period"] / 2, abs=1e-10)
    assert found.of("gravity_cost", "walker.slope") == pytest.approx(cos(0.0174532925199433), abs=1e-12)
    assert found.of("required_friction", "friction") == pytest.approx(1.0, abs=1e-9)  # it slips: friction is needed


def test_an_extremum_that_two_values_share_has_no_derivative_in_what_tells_them_apart() -> None:
    """The motor of the crawler pushes as hard as it pulls."""
    found = go.sensitivity(named("crawler"))
    tied = [key for key in found.parameters if np.isnan(found.of("peak_torque", key))]
    assert len(tied) == 2
    assert all(key.startswith("control.") for key in tied)
    assert "several values" in found.reasons["peak_torque"]
    assert found.to_record()["derivatives"]["peak_torque"][tied[0]] is None


def stability(*values: complex) -> tuple[dict[str, Array], dict[str, str]]:
    """Derivatives of multipliers and spectral radius, and why there are none; each multiplier changes by one."""
    reasons = dict[str, str]()
    rows = dict(_stability([Multiplier(value, np.ones(1, dtype=complex)) for value in values], 1, reasons))
    return {key: gradient for key, (_, gradient) in rows.items()}, reasons


def test_multiple_multipliers_and_ties_of_the_modulus_have_no_derivative() -> None:
    rows, reasons = stability(0.5, 0.5 + 1e-9, 0.2)
    assert np.isnan(rows["multipliers.0.re"]).all()
    assert np.isnan(rows["spectral_radius"]).all()
    assert rows["multipliers.2.re"] == 1
    assert reasons == {
        "multipliers.0.re": "the multiplier is multiple",
        "multipliers.1.re": "the multiplier is multiple",
        "spectral_radius": "the largest multiplier is multiple",
    }
    rows, reasons = stability(-0.7, 0.7)
    assert rows["multipliers.0.re"] == 1
    assert reasons == {"spectral_radius": "two multipliers have the largest modulus"}
    rows, reasons = stability(0.6 + 0.8j, 0.6 - 0.8j)
    assert rows["spectral_radius"] == pytest.approx(0.6)
    assert not reasons


def test_a_problem_and_an_unknown_name_are_refused() -> None:
    with pytest.raises(go.GaitoptError, match="takes a gait, not a problem"):
        go.sensitivity("compass-passive-a")  # type: ignore[arg-type]
    with pytest.raises(go.GaitoptError, match=r"friktion .* did you mean friction"):
        go.sensitivity(named("compass-passive-a")).of("period", "friktion")


@pytest.mark.slow
def test_a_gait_at_a_fold_has_no_derivatives() -> None:
    branch = go.continuation(named("compass-torque-stick"), "control.hip", to=0.3, max_points=60)
    (fold,) = [special.gait for special in branch.special("fold") if special.gait is not None]
    with pytest.raises(go.GaitoptError, match="not a function of its parameters"):
        go.sensitivity(fold)


def test_the_table_names_units_and_what_stabilises_most() -> None:
    found = go.sensitivity(named("compass-passive-a"))
    assert isinstance(found, Derivatives)
    assert found.levers[0][0] == "friction"
    assert found.unit("step_length", "walker.slope") == "m/rad"
    assert found.unit("period", "walker.gravity") == "s/(m/s^2)"
    assert found.unit("step_length", "walker.leg_length") == ""
    frame = found.to_frame()
    row = frame[(frame.quantity == "speed") & (frame.parameter == "friction")].iloc[0]
    assert row.derivative == found.of("speed", "friction")
    assert row.unit == "m/s"
    assert "radius at +1 %" in found._repr_html_()
