"""A search for gaits whose parts are kept in a run folder, so that the same search resumes where it stopped.

A part is known by all that it depends on. What an earlier version has kept under another key is searched again, and a
line without the entries of ``PartRecord`` is refused with file and line.
"""

from pathlib import Path

from gaitopt.callbacks import Counted, Stop
from gaitopt.gait.records import PartRecord
from gaitopt.runs.kept import ResultFile, kept_results
from gaitopt.search.distinct import Gaits
from gaitopt.search.find import Part, SearchPlan, Task, search
from gaitopt.store import begin_run, writing
from gaitopt.workers.jobs import Job, Workers

PARTS = ResultFile(name="find.jsonl", key="part", model=PartRecord)


def find_durably(
    plan: SearchPlan, folder: Path, workers: Workers, *, progress: Counted = None, should_stop: Stop = None
) -> Gaits:
    """The search of a plan, with its parts kept in a run folder of its problem; errors as of ``kept_results``."""
    states = plan.problem.walker.state_names()

    def run(task: Task, jobs: list[Job]) -> list[Part]:
        results = kept_results(
            task, jobs, workers, folder, PARTS, progress=progress, should_stop=should_stop, states=states
        )
        return [results[job.key] for job in jobs]

    with writing(folder, plan.problem):
        begin_run(folder, plan.problem)
        return search(plan, run, should_stop=should_stop)
