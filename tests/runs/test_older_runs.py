"""Run folders that an earlier version has written: read with what they lack, searched again, or refused by name."""

import json
from pathlib import Path

import pytest

import gaitopt as go
from gaitopt.errors import StorageError
from gaitopt.runs import jobs as kept
from gaitopt.runs.branch import BRANCH_FILE
from gaitopt.runs.jobs import SEARCHED, FindPlan
from gaitopt.search.find import SearchPlan, with_open_modes
from gaitopt.show.catalogue import folder_figures
from gaitopt.store.files import lines_text
from gaitopt.store.run import Run
from gaitopt.workers.jobs import Workers

WALK = ("continue", "rimless-wheel-stick", "--param", "friction", "--to", "0.95", "-o", "branch", "--quiet")


def rewritten(folder: Path, file: str, change) -> None:
    """Every line of a file of records as ``change`` makes it, with the checksums of a finished run."""
    run = Run(folder)
    run.write({file: lines_text([change(line) for line in run.lines(file)])})


@pytest.mark.usefixtures("empty_folder")
def test_an_end_at_a_bound_of_the_request_is_one_in_a_file_that_does_not_say_so_and_no_other_end_is(run):
    assert run(*WALK)[0] == 0
    folder = Path("branch")
    rewritten(folder, BRANCH_FILE, lambda line: {key: value for key, value in line.items() if key != "bound"})
    assert '"bound"' not in (folder / BRANCH_FILE).read_text()
    assert [special.bound for special in go.load_run(folder).specials] == [True]
    (figures,) = folder_figures(Path("branch"))
    legend = [text.get_text() for text in figures.draw("spectral_radius").legends[0].get_texts()]
    assert "branch ends" not in legend
    code, out, _ = run(*WALK, "--json")
    assert (code, json.loads(out.splitlines()[-1])["bound"]) == (0, True)

    def ended_before(line):
        line = {key: value for key, value in line.items() if key != "bound"}
        return line | {"value": 0.96} if line.get("type") == "end" else line

    rewritten(folder, BRANCH_FILE, ended_before)
    assert [special.bound for special in go.load_run(folder).specials] == [False]


def part(argument, parent=None):
    """One part of a search without candidates."""
    return {"method": argument.method, "starts": 1, "candidates": []}


@pytest.fixture
def plan(monkeypatch):
    """A search of two parts that takes no time."""

    def search(plan, jobs, found):
        return jobs.complete(part, [plan.job(plan.problem, "simulation", number) for number in range(2)], 2)

    monkeypatch.setattr(kept, "search", search)
    return SearchPlan(problem=with_open_modes(go.load_problem("rimless-wheel-stick")))


def find(plan, folder):
    """How many parts are searched now."""
    done = []
    FindPlan(**vars(plan), folder=folder).complete(Workers(count=1), progress=lambda count, total: done.append(count))
    return len(done)


def test_parts_of_a_search_under_other_keys_are_searched_again(plan, tmp_path):
    assert find(plan, tmp_path / "run") == 2
    rewritten(tmp_path / "run", SEARCHED.name, lambda line: line | {SEARCHED.key: f"older-{line[SEARCHED.key]}"})
    assert find(plan, tmp_path / "run") == 2
    assert find(plan, tmp_path / "run") == 0


def test_parts_of_another_form_are_refused_with_file_line_and_entry(plan, tmp_path):
    run = Run(tmp_path / "run")
    with run.begun(plan.problem):
        run.write({SEARCHED.name: lines_text([{"part": "0", "method": "simulation", "gaits": []}])})
    with pytest.raises(StorageError, match=r"find\.jsonl:1 starts: Field required; .* not changed"):
        find(plan, tmp_path / "run")
