"""Results that are kept line by line: no job is done twice, whatever ended the call before."""

from dataclasses import dataclass

import pytest

from gaitopt.errors import StorageError
from gaitopt.problem.problem import load_problem
from gaitopt.runs.jobs import ResultFile, kept_results
from gaitopt.store.folder import begin_run, growing, writing
from gaitopt.workers.jobs import Job, Workers

HERE = Workers(count=1)


@dataclass
class Line:
    name: str
    square: int


FILE = ResultFile(name="squares.jsonl", key="name", model=Line)
JOBS = [Job(key=str(number), argument=number) for number in range(4)]


@pytest.fixture
def folder(tmp_path):
    problem = load_problem("rimless-wheel-stick")
    with writing(tmp_path, problem):
        begin_run(tmp_path, problem)
        yield tmp_path


def squares(folder, done, **arguments):
    def square(number, parent=None, should_stop=None):
        done.append(number)
        return {"square": number**2}

    return kept_results(square, JOBS, HERE, folder, FILE, **arguments)


def test_a_stopped_call_resumes_where_it_stopped(folder):
    done = []
    with pytest.raises(KeyboardInterrupt):
        squares(folder, done, should_stop=lambda: len(done) == 3)
    reported = []
    results = squares(folder, done, progress=lambda k, n: reported.append((k, n)))
    assert done == [0, 1, 2, 3]
    assert reported == [(4, 4)]
    assert {key: result["square"] for key, result in results.items()} == {"0": 0, "1": 1, "2": 4, "3": 9}


def test_results_of_other_jobs_in_the_file_are_left_out(folder):
    with growing(folder, FILE.name) as log:
        log.append({"name": "of another sweep", "square": 100})
    assert squares(folder, []).keys() == {"0", "1", "2", "3"}


def test_a_line_that_is_no_result_is_named(folder):
    with growing(folder, FILE.name) as log:
        log.append({"name": "0", "square": "four"})
    with pytest.raises(StorageError, match=r"squares.jsonl:1 square"):
        squares(folder, [])
