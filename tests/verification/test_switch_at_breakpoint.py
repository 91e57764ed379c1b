"""A problem file whose gait slips where its PD law ends: solved, verified, stored, continued and designed.

The reference is the gait of a walker on a world with more gravity, which takes shorter steps in time: it ends 0.02 s
before the swing foot comes down. The PD law brakes, so that the foot slips as soon as the motors are off.
"""

import json

import numpy as np
import pytest
from named import solved

import gaitopt as go
from gaitopt.api.stored import load_run
from gaitopt.cli.main import main

REFERENCE = """
name: quick
walker: {model: compass_biped, leg_length: 1.6, leg_mass: 4, leg_com: 0.8, hip_mass: 2, gravity: 11.5, slope: 0.6 deg}
friction: 0.18
control: {type: none}
gait:
  phases: [stick]
  impact: stick
  guess: {state: {theta1: -0.1233, dtheta1: 0.6747, dtheta2: -0.4916}}
"""
TRACKED = """
name: motors-off
walker: {model: compass_biped, leg_length: 1.6, leg_mass: 4, leg_com: 0.8, hip_mass: 2, gravity: 9.8, slope: 1.5 deg}
friction: 0.15
control: {type: pd, kp: 20, kd: 4, reference: {gait: quick.yaml, beyond_end: off}}
gait:
  phases: [slip_forward, stick, slip_backward]
  impact: slip_forward
  guess: {state: {theta1: -0.1493, dtheta1: 0.650, dtheta2: -0.560, dx: 0.183}}
"""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("motors-off")
    (folder / "quick.yaml").write_text(REFERENCE)
    (folder / "motors-off.yaml").write_text(TRACKED)
    return folder


@pytest.fixture(scope="module")
def gait(files):
    return go.solve(go.load_problem(files / "motors-off.yaml"))


@pytest.mark.parametrize("engine", ["scipy", "heyoka"])
def test_the_stick_ends_with_the_reference_and_both_engines_verify_it(gait, engine):
    assert gait.converged, gait.message
    assert gait.timed == (1,)
    ends = np.cumsum([duration for _, duration in gait.phases])
    assert ends[1] == pytest.approx(gait.system.control.breakpoints[-1], abs=1e-14)
    assert gait.arcs[-1].dynamics is gait.dynamics
    verification = go.verify(gait, engine=engine)
    assert verification.passed, verification.to_record()
    assert verification.figure("multipliers") < 1e-10


@pytest.mark.parametrize(("friction", "timed"), [(0.125, ()), (0.14, (1,)), (0.17, ())])
def test_other_frictions_move_the_switch_off_the_breakpoint_on_either_side(gait, friction, timed):
    """Below 0.1308 the foot slips before the motors are off, above 0.1554 later."""
    other = solved(gait.problem.replace({"friction": friction}))
    assert other.timed == timed
    (off,) = gait.system.control.breakpoints
    end = other.phases[0][1] + other.phases[1][1]
    assert np.sign(np.round(end - off, 12)) == np.sign(friction - 0.14) * (not timed)


def test_the_command_stores_it_and_it_comes_back(files, gait, capsys):
    run = files / "run"
    assert main(["solve", str(files / "motors-off.yaml"), "-o", str(run)]) == 0
    assert "stick (until breakpoint)" in capsys.readouterr().out
    record = json.loads((run / "gait.json").read_text())
    assert [phase.get("until") for phase in record["phases"]] == [None, "breakpoint", None]
    assert record["verification"]["passed"]
    restored = load_run(run)
    assert restored.timed == gait.timed
    assert str(restored.cycle) == "slip_forward, stick (until breakpoint), slip_backward; slip_forward"
    np.testing.assert_allclose(restored.state, gait.state, atol=1e-12)
    assert main(["verify", str(run), "--json"]) == 0


@pytest.mark.parametrize(
    ("weight", "within", "best"),
    [(-1, (0.14, 0.165), 0.165), pytest.param(1, (0.125, 0.16), 0.125, marks=pytest.mark.slow)],
)
def test_a_design_moves_the_switch_off_its_breakpoint(files, weight, within, best):
    """The step grows with friction; the optimum lies beyond the place where the switch leaves the breakpoint."""
    free = f"friction: {{free: {[*within]}, guess: 0.15}}"
    text = TRACKED.replace("friction: 0.15", free) + f"objective: {{step_length: {weight}}}\n"
    (files / "design.yaml").write_text(text)
    design = solved(go.load_problem(files / "design.yaml"))
    assert design.freed["friction"] == pytest.approx(best, abs=1e-6)
    assert design.timed == ()
    assert go.verify(design).passed
