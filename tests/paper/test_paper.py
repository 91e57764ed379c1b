"""The reproduction of the paper: what is committed is what is computed, and every difference has its reason."""

import json
import signal
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from named import named

import gaitopt
from gaitopt import Gait
from gaitopt.cli.main import main
from gaitopt.cli.terminal import interruptible
from gaitopt.errors import UnknownNameError
from gaitopt.paper import reproduction
from gaitopt.paper.figures import FIGURES
from gaitopt.paper.gaits import FAMILIES, SOURCES, Archive, copied_torques, family_of, mean_torques, problem_of
from gaitopt.paper.reproduction import Kind, needs, outputs, prepared, write
from gaitopt.paper.table import EXPLANATIONS, NUMBERS, SENTENCES, Reason, markdown, record, row

COMMITTED = Path(__file__).parents[2] / "results" / "gamus-or-2013"
RECOMPUTED = ("A: |λ| at μ = 0.14", "B: |λ| at μ = 0.14", "μ_c", "impulse ratio", "θ1* [rad]", "I: τ1, mean [N m]")
"""Numbers that need a gait, but no family."""
SAME = 1e-7


@cache
def committed() -> dict:
    return json.loads((COMMITTED / "table.json").read_text(encoding="utf-8"))


@cache
def passive() -> Gait:
    return named("compass-passive-stick")


@pytest.fixture(scope="module")
def archive(tmp_path_factory):
    return Archive(tmp_path_factory.mktemp("results"))


def test_the_committed_table_and_figures_are_complete_and_every_difference_has_a_reason():
    numbers = [(entry["where"], entry["quantity"], entry["printed"]) for entry in committed()["numbers"]]
    assert numbers == [(number.where, number.quantity, number.printed) for number in NUMBERS]
    assert [entry["sentence"] for entry in committed()["sentences"]] == [sentence.text for sentence in SENTENCES]
    assert all(entry["agrees"] or entry["reason"] for entry in committed()["numbers"])
    assert set(EXPLANATIONS) == set(Reason)
    assert {path.stem for path in COMMITTED.glob("*.svg")} == set(FIGURES)
    assert (COMMITTED / "table.md").read_text(encoding="utf-8") == markdown(committed())
    page = (COMMITTED.parents[1] / "docs" / "reproduction.md").read_text(encoding="utf-8")
    agreeing = sum(entry["agrees"] for entry in committed()["numbers"])
    assert f"Of {len(numbers)} printed numbers, {agreeing} agree" in page


def test_rounding_is_a_reason_only_where_the_rounding_of_the_torques_reaches_the_printed_number():
    for entry, number in zip(committed()["numbers"], NUMBERS, strict=True):
        if number.reason is Reason.ROUNDING:
            least, most = entry["otherwise"].values()
            printed = float(entry["printed"])
            assert least - number.half_digit <= printed <= most + number.half_digit, entry["quantity"]


def test_a_part_of_the_table_computed_again_is_what_is_committed(archive):
    stored = {(entry["where"], entry["quantity"]): entry for entry in committed()["numbers"]}
    for number in NUMBERS:
        if number.quantity in RECOMPUTED:
            entry = stored[number.where, number.quantity]
            assert row(archive, number)["computed"] == pytest.approx(entry["computed"], abs=SAME), number.quantity


def test_every_source_is_a_problem_that_is_computed_once():
    everything = set().union(*needs(outputs()).values())
    digests = [problem_of(name).digest for kind, name in everything if kind is not Kind.ROUNDED]
    assert len(digests) == len(set(digests)) == len({problem_of(name).digest for name in SOURCES})


def test_a_figure_needs_families_or_gaits():
    assert needs(["fig4"])["fig4"] == {(Kind.FAMILY, "wheel")}
    assert needs(["fig3"])["fig3"] == {(Kind.GAIT, "wheel")}
    assert needs(["fig3", "fig4"])["fig3"] == {(Kind.FAMILY, "wheel")}  # which holds its gait


def test_progress_counts_what_parts_need_too(tmp_path, archive):
    counts = []
    write(archive, tmp_path, ("fig3", "fig6"), lambda done, total: counts.append((done, total)))
    assert counts == [(0, 100), (50, 100), (100, 100)]


def test_the_remaining_time_is_told_from_the_first_family_on(tmp_path, monkeypatch):
    monkeypatch.setattr(reproduction, "prepared", lambda archive, needed, workers: iter(needed))
    monkeypatch.setattr(reproduction, "_figure", lambda *_: [])
    monkeypatch.setattr(reproduction, "_table", lambda *_: [])
    counts: list[int] = []
    write(Archive(tmp_path), tmp_path, (), lambda done, total: counts.append(done), workers=2)
    assert counts[0] == 0
    assert 15 < counts[1] < 35  # the first of sixteen needs is the longest by far
    assert counts[-1] == 100
    assert np.all(np.diff(counts) >= 0)


def test_copied_torques_are_the_closed_form_difference_of_gravity():
    walker = passive().problem.walker
    moment = walker.gravity * (
        walker.leg_mass * walker.leg_com + (walker.leg_mass + walker.hip_mass) * walker.leg_length
    )
    swing = walker.leg_mass * walker.gravity * (walker.leg_length - walker.leg_com)
    for arc, (_, torques) in zip(passive().arcs, copied_torques(passive()), strict=True):
        theta1, theta2 = arc.states[:, 0], arc.states[:, 1]
        hip = swing * (np.sin(theta2) - np.sin(theta2 - walker.slope))
        ankle = moment * (np.sin(theta1 + walker.slope) - np.sin(theta1)) - hip
        np.testing.assert_allclose(torques, np.column_stack([ankle, hip]), rtol=0, atol=1e-12)
    torques = np.vstack([values for _, values in copied_torques(passive())])
    assert np.all(torques.min(axis=0) < mean_torques(passive()))
    assert np.all(mean_torques(passive()) < torques.max(axis=0))


def test_a_second_reproduction_computes_nothing(tmp_path):
    said: list[str] = []
    for _ in range(2):
        archive = Archive(tmp_path, narrate=said.append)
        records = archive.family(problem_of("B"), (0.13,))
        assert [record["record"] for record in records[:2]] == ["continuation", "point"]
    assert len(said) == 2  # solved once, continued once


@pytest.mark.slow
def test_an_interrupted_family_resumes_and_ends_the_same(tmp_path):
    problem, polls = problem_of("B"), iter(range(1000))
    whole = Archive(tmp_path / "whole").family(problem, (0.13,))
    Archive(tmp_path / "torn").gait(problem)
    with pytest.raises(KeyboardInterrupt):
        Archive(tmp_path / "torn", should_stop=lambda: next(polls) > 4).family(problem, (0.13,))
    taken_up = Archive(tmp_path / "torn").family(problem, (0.13,))
    assert [record["value"] for record in taken_up[1:]] == pytest.approx(
        [record["value"] for record in whole[1:]], abs=SAME
    )


@pytest.mark.parametrize("interrupted", [True, False])
def test_an_interrupt_that_casadi_turns_into_another_error_is_still_an_interrupt(interrupted):
    def call() -> None:
        try:
            if interrupted:
                signal.raise_signal(signal.SIGINT)
        finally:
            raise NotImplementedError("wrong arguments")

    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt if interrupted else NotImplementedError), interruptible():
        call()
    assert signal.getsignal(signal.SIGINT) is before


def test_one_figure_alone_is_written_to_its_folder_by_the_command_and_the_library(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    (svg, _) = gaitopt.reproduce(only=["fig3"], output="library", workers=1, narrate=said.append)
    assert said == ["solving rimless-wheel-stick (friction 1.0, coulomb impact)"]
    assert main(["reproduce", "gamus-or-2013", "--only", "fig3", "-o", "command", "--quiet"]) == 0
    assert sorted(path.name for path in Path("command").iterdir()) == ["fig3.png", "fig3.svg"]
    assert capsys.readouterr().out.split() == ["command/fig3.svg", "command/fig3.png"]
    assert svg.read_bytes() == Path("command/fig3.svg").read_bytes()
    with pytest.raises(UnknownNameError, match="has no 'fig5'; choose from fig2"):
        gaitopt.reproduce(only=["fig5"])


def test_the_table_is_written_as_markdown_and_json(monkeypatch, tmp_path):
    monkeypatch.setattr(reproduction.table, "record", lambda archive: committed())
    written = reproduction._table(None, tmp_path / "folder")
    assert [path.name for path in written] == ["table.md", "table.json"]
    assert [path.read_text(encoding="utf-8") for path in written] == [
        (COMMITTED / path.name).read_text(encoding="utf-8") for path in written
    ]
    assert not [*(tmp_path / "folder").glob("*.part")]


@pytest.mark.slow
def test_the_whole_table_computed_from_nothing_is_what_is_committed(archive):
    computed_table = record(archive)
    assert computed_table["sentences"] == committed()["sentences"]
    for entry, stored in zip(computed_table["numbers"], committed()["numbers"], strict=True):
        assert entry["computed"] == pytest.approx(stored["computed"], abs=SAME), entry["quantity"]
        assert entry["otherwise"] == pytest.approx(stored["otherwise"], abs=SAME), entry["quantity"]


@pytest.mark.slow
def test_families_that_two_processes_follow_are_those_of_one(tmp_path: Path) -> None:
    names, values = ("wheel", "I"), []
    needed = [(Kind.FAMILY, name) for name in names]
    assert set(prepared(Archive(tmp_path / "both"), needed, 2)) == set(needed)
    assert all(Archive(tmp_path / "both").has_family(problem_of(name), FAMILIES[name]) for name in names)
    for folder in ("both", "one"):
        archive = Archive(tmp_path / folder)
        values.append([record["value"] for name in names for record in family_of(archive, name)[1:]])
    assert values[0] == pytest.approx(values[1], rel=0, abs=1e-12)
