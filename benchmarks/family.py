"""Gaits per second along a family, with multipliers, on one core; and the plain way.

The plain way is simulation, ``fsolve`` and finite differences from one value of the friction to the next. Times are
those of the process, so that whatever else the machine does counts little.
"""

import time
import tracemalloc
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from plain import PlainCompass
from timing import Row

import gaitopt as go
from gaitopt import Gait
from gaitopt.branches.continuation import follow_family
from gaitopt.branches.request import Request
from gaitopt.gait.branch import BranchPoint

NAME, START, END = "compass-passive-a", 0.165, 0.125
"""The family between these frictions has three phases, is stable and has no special point."""
POINTS = 10
"""Number of gaits that are also computed the plain way."""


def rows() -> list[Row]:
    """Seconds per gait: the plain way, with multipliers and all that is watched, and every tenth simulated."""
    gait = go.solve(go.load_problem(NAME).replace({"friction": START}))
    family(gait, 0)  # compile, fill caches
    points, seconds = timed(lambda: family(gait, 0))
    checked, seconds_checked = timed(lambda: family(gait, 10))
    worst, seconds_plain = timed(lambda: plain_family(points))
    what, plain = "a gait of a family", seconds_plain / POINTS
    each, each_checked = seconds / len(points), seconds_checked / len(checked)
    note = f"{1 / each:.0f} a second; multipliers within {worst:.0e}; {memory(gait):.0f} bytes a point"
    return [
        Row(what=what, way="plain: fsolve, differences", seconds=plain, ratio=1.0, note=f"{1 / plain:.1f} a second"),
        Row(what=what, way="continuation, special points watched", seconds=each, ratio=plain / each, note=note),
        Row(what=what, way="every tenth simulated", seconds=each_checked, ratio=plain / each_checked,
            note=f"{1 / each_checked:.0f} a second"),
    ]  # fmt: skip


def family(gait: Gait, verify_every: int) -> list[BranchPoint]:
    """All gaits of the family from start to end."""
    request = Request(parameter="friction", to=(END,), verify_every=verify_every)
    return [record for record in follow_family(gait, request) if isinstance(record, BranchPoint)]


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """The result of a call and its process time [s]."""
    began = time.process_time()
    result = call()
    return result, time.process_time() - began


def plain_family(points: list[BranchPoint]) -> float:
    """Compute ``POINTS`` of the same gaits with multipliers the plain way; the largest difference of spectral radii."""
    walker = points[0].gait.problem.walker
    names = ("leg_length", "leg_mass", "leg_com", "hip_mass", "gravity", "slope")
    xi, worst = points[0].gait.state[[0, 3, 4]], 0.0
    for k in np.linspace(0, len(points) - 1, POINTS).astype(int):
        plain = PlainCompass(**{name: getattr(walker, name) for name in names}, friction=points[k].value)
        xi = plain.gait(xi)
        radius = float(np.abs(plain.multipliers(xi)).max())
        worst = max(worst, abs(radius - points[k].gait.spectral_radius))
    return worst


def memory(gait: Gait) -> float:
    """Bytes that every further point keeps when records are streamed, over the second half of a family."""
    request = Request(parameter="friction", to=(END,), verify_every=0)
    tracemalloc.start()
    allocated, last = [], deque(maxlen=1)
    for record in follow_family(gait, request):
        last.append(record)
        allocated.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    half = allocated[len(allocated) // 2 :]
    return float(np.polyfit(np.arange(len(half)), half, 1)[0])
