"""Gaits of other kinds: two steps, two coefficients of friction, a tracked reference; solved and verified."""

from functools import partial

from timing import Row, compared

from gaitopt import load_problem, solve, verify

NAMES = {
    "compass-passive-two-step": "a cycle of two steps",
    "compass-passive-static-kinetic": "static and kinetic friction",
    "compass-pd-impact-slip": "PD control on a reference gait",
    "kneed-passive": "knees that lock",
    "rimless-wheel-slip": "a rimless wheel",
}


def rows() -> list[Row]:
    """Seconds to solve and to verify, the stick-slip gait of the passive compass first."""
    gaits = {name: solve(load_problem(name)) for name in ("compass-passive-a", *NAMES)}
    about = {"compass-passive-a": "one slip each way", **NAMES}
    notes = {
        name: f"{about[name]}; {gait.solver['iterations']:.0f} iterations, period {gait.period:.9f} s"
        for name, gait in gaits.items()
    }
    solved = {name: (partial(solve, load_problem(name)), notes[name]) for name in gaits}
    verified = {name: (partial(verify, gait), "") for name, gait in gaits.items()}
    return [
        *compared("gaits of other kinds: solve", solved, rounds=2),
        *compared("gaits of other kinds: verify", verified, rounds=2),
    ]
