"""Jobs on one worker and on more: what the machinery costs beyond the jobs themselves."""

import time

from timing import Row

from gaitopt.workers.jobs import Job, Workers, run_jobs

JOB_SECONDS = 0.3
"""A small job: the gait of a wheel; that of a compass takes about a second."""


def busy(argument: float, parent: object) -> float:
    """Use the processor for so long, and say how long it was."""
    began = time.perf_counter()
    while time.perf_counter() - began < argument:
        pass
    return time.perf_counter() - began


def rows(jobs: int, workers: int) -> list[Row]:
    """Overhead of a sweep of small jobs, and its gain from workers; the process itself does a tenth of them."""
    ways = {"1 worker, this process": (1, max(jobs // 10, 1)), f"{workers} workers": (workers, jobs)}
    found: list[Row] = []
    for way, (count, number) in ways.items():
        todo = [Job(key=f"{count}-{k}", argument=JOB_SECONDS) for k in range(number)]
        began, first, spent = time.perf_counter(), 0.0, 0.0
        for _, seconds in run_jobs(busy, todo, Workers(count=count)):
            first = first or time.perf_counter() - began
            spent += seconds
        took = time.perf_counter() - began
        start = max(first - JOB_SECONDS, 0.0)
        beyond, going = took * count / spent - 1, (took - start) * count / spent - 1
        note = f"{number} of them, {beyond:.1%} beyond the jobs, {going:.1%} without the start of {start:.1f} s"
        ratio = found[0].seconds * number / took if found else 1.0
        found.append(Row(what=f"a job of {JOB_SECONDS} s", way=way, seconds=took / number, ratio=ratio, note=note))
    return found
