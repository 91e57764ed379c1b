"""Jobs that end at a time limit, and jobs that the caller stops."""

import pytest

from gaitopt.callbacks import TimeLimit
from gaitopt.workers.jobs import Job, ResumableJobs, Workers

JOBS = [Job(key=str(number), argument=number) for number in range(3)]


def square(number, _=None, should_stop=None):
    return number**2


def jobs(limit=None, should_stop=None, **options):
    here = Workers(count=1)
    return ResumableJobs(workers=here, should_stop=should_stop, limit=limit or TimeLimit(), **options)


def test_after_the_time_the_results_are_those_that_are_known():
    assert jobs().complete(square, JOBS, 3) == [0, 1, 4]
    assert jobs(TimeLimit(seconds=0.0)).complete(square, JOBS, 3) == []
    known = {"0": "kept"}
    assert jobs(TimeLimit(seconds=0.0), results=known).complete(square, JOBS, 3) == []
    assert jobs(TimeLimit(seconds=60.0), results=known).complete(square, JOBS, 3) == ["kept", 1, 4]


@pytest.mark.parametrize("seconds", [None, 60.0, 0.0])
def test_the_caller_stops_jobs_with_an_error_whether_the_time_is_over_or_not(seconds):
    with pytest.raises(KeyboardInterrupt):
        jobs(TimeLimit(seconds=seconds), lambda: True).complete(square, JOBS, 3)


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
    assert jobs(Limit(seconds=1.0)).complete(ended, JOBS, 3) == [0]
