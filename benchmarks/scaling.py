"""Jobs on one worker and on several: what the machinery costs beyond the jobs themselves."""

import time

from timing import Row

from gaitopt.study.jobs import Job, Workers, run_jobs

JOB_SECONDS = 0.3
"""A small job: the gait of a wheel; that of a compass takes about a second."""


def busy(argument: float, parent: object) -> float:
    """Use the processor for so long, and say how long it was."""
    began = time.perf_counter()
    while time.perf_counter() - began < argument:
        pass
    return time.perf_counter() - began


def rows(jobs: int, workers: int) -> list[Row]:
    """Overhead of a sweep of small jobs, and its gain from workers."""
    found, alone = [], 0.0
    for count in (1, workers):
        todo = [Job(key=f"{count}-{k}", argument=JOB_SECONDS) for k in range(jobs)]
        began, first, spent = time.perf_counter(), 0.0, 0.0
        for _, seconds in run_jobs(busy, todo, Workers(count=count)):
            first = first or time.perf_counter() - began
            spent += seconds
        took = time.perf_counter() - began
        alone = alone or took
        overhead = took * count / spent - 1
        start = max(first - JOB_SECONDS, 0.0)
        going = (took - start) * count / spent - 1
        note = f"{overhead:.1%} beyond the jobs, {going:.1%} without the start of {start:.1f} s"
        way = f"{count} worker{'s' if count > 1 else ', this process'}"
        found.append(Row(what=f"{jobs} jobs of {JOB_SECONDS} s", way=way, seconds=took, ratio=alone / took, note=note))
    return found
