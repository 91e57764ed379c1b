"""Results that are kept line by line: no job is done twice, whatever ended the call before."""

from dataclasses import dataclass

import pytest

from gaitopt import load_problem
from gaitopt.callbacks import TimeLimit
from gaitopt.errors import StorageError
from gaitopt.runs.jobs import ResultFile
from gaitopt.store.run import Run
from gaitopt.workers.jobs import Job, ResumableJobs, Workers

HERE = Workers(count=1)


@dataclass
class Line:
    name: str
    square: int


FILE = ResultFile(name="squares.jsonl", key="name", model=Line)
PROBLEM = load_problem("rimless-wheel-stick")
JOBS = [Job(key=str(number), argument=number) for number in range(4)]


@pytest.fixture
def kept_run(tmp_path):
    run = Run(tmp_path)
    with run.begun(PROBLEM):
        yield run


def squares(kept_run, done, jobs=JOBS, **arguments):
    def square(number, parent=None, should_stop=None):
        done.append(number)
        return {"square": number**2}

    with FILE.opened(kept_run, PROBLEM) as (results, store):
        kept = ResumableJobs(workers=HERE, results=results, store=store, **arguments)
        return kept.complete(square, jobs(results) if callable(jobs) else jobs, len(JOBS))


def test_a_stopped_call_resumes_where_it_stopped(kept_run):
    done = []
    with pytest.raises(KeyboardInterrupt):
        squares(kept_run, done, should_stop=lambda: len(done) == 3)
    reported = []
    results = squares(kept_run, done, progress=lambda k, n: reported.append((k, n)))
    assert done == [0, 1, 2, 3]
    assert reported == [(4, 4)]
    assert [(result["name"], result["square"]) for result in results] == [("0", 0), ("1", 1), ("2", 4), ("3", 9)]


def test_results_of_other_jobs_in_the_file_are_left_out(kept_run):
    with kept_run.appending(FILE.name) as log:
        log.append({"name": "of another sweep", "square": 100})
    assert [result["name"] for result in squares(kept_run, [])] == ["0", "1", "2", "3"]


def test_a_line_that_is_no_result_is_named(kept_run):
    with kept_run.appending(FILE.name) as log:
        log.append({"name": "0", "square": "four"})
    with pytest.raises(StorageError, match=r"squares.jsonl:1 square"):
        squares(kept_run, [])


def test_a_job_is_made_when_it_is_drawn_and_may_depend_on_earlier_results(kept_run):
    done = []

    def chain(results):
        for job in JOBS:
            assert len(done) == len(results) == int(job.key)
            yield job

    squares(kept_run, done, chain)
    assert done == [0, 1, 2, 3]
    assert squares(kept_run, done, lambda results: iter(JOBS)) == squares(kept_run, done)
    assert done == [0, 1, 2, 3]


def test_a_job_that_occurs_twice_is_done_once(kept_run):
    done = []
    assert [result["square"] for result in squares(kept_run, done, [*JOBS[:3], JOBS[0]])] == [0, 1, 4, 0]
    assert done == [0, 1, 2]


def square(number, parent=None, should_stop=None):
    return number**2


def jobs(limit, should_stop=None, **options):
    return ResumableJobs(workers=HERE, should_stop=should_stop, limit=limit, **options)


def test_after_the_time_the_results_are_those_that_are_known():
    assert jobs(TimeLimit()).complete(square, JOBS[:3], 3) == [0, 1, 4]
    assert jobs(TimeLimit(seconds=0.0)).complete(square, JOBS[:3], 3) == []
    known = {"0": "kept"}
    assert jobs(TimeLimit(seconds=0.0), results=known).complete(square, JOBS[:3], 3) == []
    assert jobs(TimeLimit(seconds=60.0), results=known).complete(square, JOBS[:3], 3) == ["kept", 1, 4]


@pytest.mark.parametrize("seconds", [None, 60.0, 0.0])
def test_the_caller_stops_jobs_with_an_error_whether_the_time_is_over_or_not(seconds):
    with pytest.raises(KeyboardInterrupt):
        jobs(TimeLimit(seconds=seconds), lambda: True).complete(square, JOBS[:3], 3)


def test_a_job_that_the_time_limit_ends_has_no_result():
    def ended(number, _=None, should_stop=None):
        if number == 1:
            limit[0] = TimeLimit(seconds=0.0)
            raise KeyboardInterrupt
        return number

    class Limit(TimeLimit):
        """One that is over when the second job says so."""

        @property
        def is_over(self):
            return limit[0].is_over

    limit = [TimeLimit()]
    assert jobs(Limit(seconds=1.0)).complete(ended, JOBS[:3], 3) == [0]
