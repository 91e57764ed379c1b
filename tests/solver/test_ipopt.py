"""A small nonlinear program with a known optimum: blocks and bounds, sizes, multipliers, and requests to stop."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from casadi import MX, sumsqr, vertcat

from gaitopt import Status
from gaitopt.solver.ipopt import Block, Ipopt, Program


def nearest_point(p0, sizes=(1.0, 1.0), row_size=1.0, start=(0.3, 0.2)):
    """The point of x + y <= p, y >= 0 that is nearest to (2, 1)."""
    x, y, p = MX.sym("x"), MX.sym("y"), MX.sym("p")
    return Program(
        unknowns=(
            Block(name="x", expression=x, size=sizes[0]),
            Block(name="y", expression=y, lower=0.0, size=sizes[1]),
        ),
        rows=(Block(name="sum", expression=x + y - p, upper=0.0, size=row_size),),
        p=p,
        f=sumsqr(vertcat(x, y) - np.array([2.0, 1.0])),
        x0=np.array(start),
        p0=np.array([p0]),
    )


def ipopt(program, **options):
    return Ipopt(program, options={"tol": 1e-10}, **options)


@pytest.mark.portable
@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize(
    ("p", "optimum", "multiplier", "of_bound"),
    [(2.0, [1.5, 0.5], 1.0, 0.0), (0.0, [0.0, 0.0], 4.0, -2.0), (5.0, [2.0, 1.0], 0.0, 0.0)],
)
def test_optimum_and_multipliers_are_those_of_the_closed_form(exact, p, optimum, multiplier, of_bound):
    end = ipopt(nearest_point(p), exact=exact).solve()
    assert end.status is Status.CONVERGED
    np.testing.assert_allclose(end.w, optimum, rtol=0, atol=1e-6)
    np.testing.assert_allclose(end.multipliers, [multiplier], rtol=0, atol=1e-5)
    np.testing.assert_allclose(end.bound_multipliers, [0.0, of_bound], rtol=0, atol=1e-5)
    assert end.objective == pytest.approx((optimum[0] - 2) ** 2 + (optimum[1] - 1) ** 2, abs=1e-5)


def test_sizes_of_unknowns_and_rows_change_neither_optimum_nor_multipliers():
    end = ipopt(nearest_point(2.0, sizes=(100.0, 0.01), row_size=30.0)).solve()
    np.testing.assert_allclose(end.w, [1.5, 0.5], rtol=0, atol=1e-5)
    np.testing.assert_allclose(end.multipliers, [1.0], rtol=0, atol=1e-4)


def test_progress_reports_the_violation_of_the_rows_and_a_request_stops_it():
    seen = []
    program = nearest_point(2.0, start=(3.0, 2.0))
    end = ipopt(program).solve(progress=lambda *report: seen.append(report), should_stop=lambda: len(seen) >= 3)
    assert end.status is Status.INTERRUPTED
    assert [iteration for iteration, _ in seen] == [0, 1, 2]
    assert seen[0][1] == pytest.approx(3.0)


THREADS = """
import json, os
import gaitopt as go
import numpy  # with threads of its own
def count():
    return len(os.listdir("/proc/self/task"))
before = count()
go.solve("rimless-wheel-slip", method="ipopt", progress=False)
print(json.dumps([count() - before, os.environ.get("OPENBLAS_NUM_THREADS")]))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="counts threads in /proc")
@pytest.mark.parametrize(("stated", "more"), [(None, 0), ("2", 1)])
def test_the_linear_algebra_of_ipopt_has_one_thread_unless_the_environment_states_more(stated, more):
    environment = {key: value for key, value in os.environ.items() if key != "OPENBLAS_NUM_THREADS"}
    environment |= {} if stated is None else {"OPENBLAS_NUM_THREADS": stated}
    done = subprocess.run([sys.executable, "-c", THREADS], env=environment, capture_output=True, check=True, text=True)
    threads, left = json.loads(done.stdout)
    assert left == stated
    assert threads == min(more, (os.cpu_count() or 1) - 1)
