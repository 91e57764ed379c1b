"""Problems that have no solution: never a gait that is not verified, never an internal error, and an end in time."""

import json
import os
import subprocess
import sys

import pytest

CPU_SECONDS = 300
NOT_A_GAIT, DISAGREES = 4, 5
WHEEL, WHEEL_SLIP, SLOPE = "rimless-wheel-stick", "rimless-wheel-slip", "rimless-wheel-slope"
STICK, A, B = "compass-passive-stick", "compass-passive-a", "compass-passive-b"
TORQUE, TORQUE_SLIP, TORQUE_IMPACT = "compass-torque-stick", "compass-torque-slip", "compass-torque-impact-slip"
CHEAP, STABLE, FIRM = "compass-torque-efficient", "compass-torque-stable-slip", "compass-minimum-friction"
SEQUENCES = ("[stick]", "[slip_forward, stick]", "[slip_backward, stick]", "[stick, slip_forward]", "[slip_forward]",
             "[stick, slip_backward]", "[slip_forward, stick, slip_backward]")  # fmt: skip
OWN = {
    WHEEL: "[stick]", WHEEL_SLIP: "[stick, slip_forward]", STICK: "[stick]", TORQUE: "[stick]",
    A: "[slip_forward, stick, slip_backward]", TORQUE_SLIP: "[slip_forward, stick, slip_backward]",
}  # fmt: skip
WRONG_MODES = [(name, f"gait.phases={modes}") for name, own in OWN.items() for modes in SEQUENCES if modes != own]
NO_ENERGY = [(name, f"walker.slope={slope}") for name in (WHEEL, STICK, A) for slope in ("0", "-2 deg")]
TOO_SLIPPERY = [
    (name, f"friction={mu}")
    for name, frictions in {
        WHEEL: (0, 0.1, 0.5, 0.9), WHEEL_SLIP: (0.05,), STICK: (0.01, 0.1, 0.17), A: (0.01,), TORQUE: (0.05, 0.19),
    }.items() for mu in frictions
]  # fmt: skip
OUT_OF_REACH = [
    (SLOPE, "constraints.speed=3"),
    (SLOPE, "constraints.speed=0.01"),
    (SLOPE, "walker.slope={free: [1 deg, 2 deg], guess: 1.5 deg}"),
    (CHEAP, "constraints.speed=3"),
    (FIRM, "constraints.speed=2.5"),
    (CHEAP, "constraints.peak_torque={max: 1e-6}"),
    (STABLE, "constraints.spectral_radius={max: 1e-3}"),
]
NONE_AT_ALL = [*NO_ENERGY, (WHEEL, "friction=0.1"), (STICK, "friction=0.01")]
"""Problems to which there is no other gait either."""
INFEASIBLE = [*NO_ENERGY, *TOO_SLIPPERY, *WRONG_MODES, *OUT_OF_REACH]
SAMPLE = [NO_ENERGY[0], NO_ENERGY[2], TOO_SLIPPERY[1], WRONG_MODES[0]]


def limit_processor_time():
    import resource

    resource.setrlimit(resource.RLIMIT_CPU, (CPU_SECONDS, CPU_SECONDS))


def arguments(name, change):
    return ["solve", name, "--set", change, "--json", "--quiet"]


def solve(name, change, folder):
    """Exit code, stdout and stderr of ``gaitopt solve`` in a process of its own."""
    limit = limit_processor_time if os.name == "posix" else None
    command = [sys.executable, "-m", "gaitopt", *arguments(name, change)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False, preexec_fn=limit)
    return done.returncode, done.stdout, done.stderr


def check(code, out, err):
    record = json.loads(out or "{}")
    assert code in (0, NOT_A_GAIT, DISAGREES), err
    if code == 0:  # there is a gait after all
        assert record["status"] == "converged"
        assert record["verification"]["passed"]
    if code == NOT_A_GAIT:
        assert record["status"] in ("infeasible", "not_converged")
        assert record["message"]
    return code


@pytest.mark.parametrize(("name", "change"), SAMPLE)
@pytest.mark.usefixtures("empty_folder")
def test_what_cannot_be_solved_is_said_to_be_so(name, change, run):
    assert check(*run(*arguments(name, change))) == NOT_A_GAIT


@pytest.mark.slow
@pytest.mark.parametrize(("name", "change"), INFEASIBLE)
def test_no_infeasible_problem_has_an_unverified_gait(name, change, tmp_path):
    code = check(*solve(name, change, tmp_path))
    assert code == NOT_A_GAIT or (name, change) not in NONE_AT_ALL
