"""Equations of motion in 300 bits beside those in doubles: no foot is too light for their digits."""

import numpy as np
import pytest

from gaitopt import Mode, load_problem
from gaitopt.systems import build_system

flint = pytest.importorskip("flint")

from gaitopt.proof.arithmetic import BallFunction  # noqa: E402

FEET_APART = 0.05
"""Angle of the stance leg [rad]; at a foot under the hip the apparent mass of a slipping one is its own."""
LOST = 1e-11
"""Relative error of rates and forces; the claims of a verified gait are 1e-9 wide."""


@pytest.mark.parametrize("mode", [Mode.STICK, Mode.SLIP_FORWARD, Mode.SLIP_BACKWARD])
@pytest.mark.parametrize("foot_mass", [1e-3, 1e-6, 1e-9])
def test_accelerations_and_forces_keep_their_digits_however_light_the_feet(foot_mass: float, mode: Mode) -> None:
    lengths = {"leg_length": 1.0, "leg_com": 1e-9, "gravity": 1.0}
    changes = {**lengths, "leg_mass": foot_mass, "hip_mass": 1.0}
    problem = load_problem("compass-passive-a").replace({f"walker.{key}": value for key, value in changes.items()})
    system = build_system(problem)
    flow, p = system.flow(mode), system.values(problem.parameters)
    rng = np.random.default_rng(0)
    for _ in range(10):
        z = rng.normal(size=system.n_z) * [0.0, 0.3, 0.1, 1.0, 1.0, 0.5]
        z[0] = rng.uniform(FEET_APART, 0.4) * rng.choice([-1, 1])
        inputs = [np.zeros(1), z, p, np.zeros(flow.size1_in(3))]
        with flint.ctx.workprec(300):
            balls = [[flint.arb(float(x)) for x in values] for values in inputs]
            exact = [[float(x.mid()) for x in column] for column in BallFunction(flow, balls[1:])(balls[0])]
        for ours, theirs in zip(flow.call(inputs), exact, strict=True):
            assert np.asarray(ours).ravel() == pytest.approx(theirs, rel=LOST, abs=LOST * np.abs(theirs).max())
