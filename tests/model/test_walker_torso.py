"""A walker of a user's own: the compass with a torso, solved, verified and simulated like the built-in ones."""

import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from oracles import EXAMPLES, TorsoCompass, torso_oracle

import gaitopt as go
from gaitopt.errors import ProblemError

NAMES = ("torso-compass", "torso-compass-slip")


@cache
def solved(name: str) -> go.Gait:
    return go.solve(go.load_problem(EXAMPLES / f"{name}.yaml", walkers=(TorsoCompass,)))


@pytest.mark.parametrize(("name", "radius", "sliding"), [(NAMES[0], 0.7664, 0.0), (NAMES[1], 0.9002, 0.01238)])
def test_gait_is_confirmed_by_the_simulator_and_is_stable_and_slides_as_its_file_says(name, radius, sliding):
    gait = solved(name)
    assert [claim for claim in go.verify(gait).claims if not claim.passed] == []
    assert gait.spectral_radius == pytest.approx(radius, abs=5e-5)
    assert gait.measures["slip_distance"] == pytest.approx(sliding, abs=5e-6)


def test_sticking_gait_is_periodic_for_newtons_law_written_by_hand() -> None:
    """One step with the oracle's matrices, eq. (3) for the foot and eq. (9) for the impact: no CasADi anywhere."""
    gait = solved("torso-compass")
    oracle, shape, rates = torso_oracle(**dict(gait.problem.walker)), gait.state[:3], gait.state[4:7]
    q, dq, period = oracle.swing([*shape, 0, 0], [*rates, 0, 0])
    _, after = oracle.impulse(q, dq, 0, 0.0)
    assert period == pytest.approx(gait.period, abs=1e-9)
    np.testing.assert_allclose([-q[1], -q[0], q[2]], shape, atol=1e-9)
    np.testing.assert_allclose([-after[1], -after[0], after[2]], rates, atol=1e-8)
    assert oracle.swing_foot.position(q) == pytest.approx([gait.measures["step_length"], 0], abs=1e-9)


def test_walker_that_is_neither_registered_nor_given_is_refused_with_its_place() -> None:
    with pytest.raises(ProblemError, match=r"torso-compass\.yaml:\d+:\d+ walker\.model: .*torso_compass"):
        go.load_problem(EXAMPLES / "torso-compass.yaml")


def test_registered_walker_goes_through_the_command_line(tmp_path: Path) -> None:
    """A package of a user declares the entry point."""
    package = tmp_path / "torso_compass-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: torso-compass\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[gaitopt.walkers]\ntorso_compass = torso_compass:TorsoCompass\n")
    path = os.pathsep.join([str(tmp_path), str(EXAMPLES), os.environ.get("PYTHONPATH", "")])

    commands = [["solve", str(EXAMPLES / "torso-compass-slip.yaml"), "-o", "run"], ["simulate", "run", "--steps", "3"]]
    program = f"from gaitopt.cli.main import main; [main([*c, '--json', '--quiet']) for c in {commands}]"
    done = subprocess.run(
        [sys.executable, "-c", program],
        env={**os.environ, "PYTHONPATH": path},
        cwd=tmp_path, capture_output=True, text=True, check=False,
    )  # fmt: skip
    gait_record, walked = map(json.loads, done.stdout.splitlines())
    assert gait_record["status"] == "converged"
    assert gait_record["verification"]["passed"]
    assert walked["status"] == "completed"
    assert walked["period"] == pytest.approx(gait_record["period"], abs=1e-9)
