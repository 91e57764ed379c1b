"""Gaits per second along a family, with multipliers, on one core; and the plain way: ``continuation.py [--json FILE]``.

The plain way is simulation, ``fsolve`` and finite differences from one value of the friction to the next. Times are
those of the process, so that whatever else the machine does counts little.
"""

import argparse
import json
import platform
import time
import tracemalloc
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from plain import PlainCompass

import gaitopt as go
from gaitopt.families import Request, follow_family
from gaitopt.gait import BranchPoint, Gait

NAME, START, END = "compass-passive-a", 0.165, 0.125
"""Three phases all the way, stable, no special point between."""
POINTS = 10
"""Of the plain way."""


def main() -> None:
    """Measure, print, write JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="where to write the figures")
    asked = parser.parse_args()
    gait = go.solve(go.load_problem(NAME).replace({"friction": START}))
    family(gait, 0)  # compile, fill caches
    points, seconds = timed(lambda: family(gait, 0))
    checked, seconds_checked = timed(lambda: family(gait, 10))
    plain, seconds_plain = timed(lambda: plain_family(points))
    record = {
        "gaits_per_second": len(points) / seconds,
        "gaits_per_second_every_tenth_simulated": len(checked) / seconds_checked,
        "plain_gaits_per_second": POINTS / seconds_plain,
        "ratio": len(points) / seconds * seconds_plain / POINTS,
        "largest_difference_of_multipliers": plain,
        "memory_growth_per_point_bytes": memory(gait),
        "points": len(points),
        "machine": {"machine": platform.machine(), "python": platform.python_version()},
    }
    for key, value in record.items():
        print(f"{key:42} {value:.4g}" if isinstance(value, float | int) else f"{key:42} {value}")
    if asked.json is not None:
        asked.json.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")


def family(gait: Gait, verify_every: int) -> list[BranchPoint]:
    """All gaits on the way."""
    request = Request(parameter="friction", to=(END,), verify_every=verify_every)
    return [record for record in follow_family(gait, request) if isinstance(record, BranchPoint)]


def timed(call: Callable[[], Any]) -> tuple[Any, float]:
    """Result and process time [s]."""
    began = time.process_time()
    result = call()
    return result, time.process_time() - began


def plain_family(points: list[BranchPoint]) -> float:
    """Every few of the same gaits and their multipliers, the plain way; how far the multipliers are off."""
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
    held, last = [], deque(maxlen=1)
    for record in follow_family(gait, request):
        last.append(record)
        held.append(tracemalloc.get_traced_memory()[0])
    tracemalloc.stop()
    half = held[len(held) // 2 :]
    return float(np.polyfit(np.arange(len(half)), half, 1)[0])


if __name__ == "__main__":
    main()
