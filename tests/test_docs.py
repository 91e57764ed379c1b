"""What README and docs show is true: commands run, library calls run, problem files are problems."""

import re
import runpy
import shlex
import shutil
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles import compass_oracle
from samples import sampled

from gaitopt import load_problem, parse_problem, simulate, solve, verify
from gaitopt.cli import options
from gaitopt.cli.main import main
from gaitopt.model.transitions import Ending

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text()
GUIDE = [*sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs" / "gallery").glob("*.md"))]
PAGES = [ROOT / "README.md", *GUIDE, *sorted((ROOT / "docs" / "developer").glob("*.md"))]
GALLERY = sorted((ROOT / "docs" / "examples" / "gallery").glob("*.py"))


def blocks(language: str, pages: list[Path] = PAGES) -> list[str]:
    pattern = rf"^```{language}\n(.*?)^```$"
    return [block for page in pages for block in re.findall(pattern, page.read_text(), re.MULTILINE | re.DOTALL)]


LONG = re.compile(
    r"--starts|reproduce|find\(|rabbit-optimal|urdf:|my-cheap-walk|go\.atlas|stabilise|continu|nlpsol|go\.replay"
    r"|gaitopt list|plot branch"
)
"""What is shown and takes long: run with ``-m slow``, as before every merge."""
LINES = [line for block in blocks("console") for line in block.splitlines()]
COMMANDS = [*dict.fromkeys(line[2:] for line in LINES if line.startswith("$ "))]
BEFORE = {
    after[2:]: first[2:]
    for block in blocks("console")
    for first, after in pairwise(block.splitlines())
    if (folder := re.search(r"-o (\S+)$", first)) and folder[1] in after.split()
}
"""The command before one that draws its folder."""
FILES = {matched[1]: text for text in blocks("yaml") if (matched := re.match(r"name: (\S+)", text))}


def shown(texts: list[str]) -> list[Any]:
    """A sample of what is shown, and, marked slow, the rest and what takes long."""
    quick = {text for text in texts if not LONG.search(text)}
    sample = {text for text in sampled(sorted(quick), 2) if isinstance(text, str)}
    return [text if text in sample else pytest.param(text, marks=pytest.mark.slow) for text in texts]


@pytest.mark.parametrize("command", shown(COMMANDS))
def test_a_command_that_is_shown_ends_as_it_says(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name, text in FILES.items():
        (tmp_path / f"{name}.yaml").write_text(text)
    words, _, code = command.partition("  # exit code ")
    if command in BEFORE:
        assert main(shlex.split(BEFORE[command])[1:]) == 0
    program, *arguments = shlex.split(words)
    assert program == "gaitopt"
    assert main(arguments) == int(code or 0)
    assert capsys.readouterr().out


@pytest.mark.parametrize("program", shown(blocks("python", PAGES[1:])))
def test_library_calls_that_are_shown_work(program, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "docs" / "examples" / "rabbit.urdf", tmp_path)
    monkeypatch.syspath_prepend(ROOT / "docs" / "examples")
    exec(compile(program, "docs", "exec"), {})  # noqa: S102 - our own pages


def test_the_pushes_of_the_readme_die_out(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(re.findall(r"```python\n(.*?)```", README, re.DOTALL)[0], "README", "exec"), names)  # noqa: S102
    walk, gait = names["walk"], names["gait"]
    assert walk.trajectory.ending == "completed"
    first, last = (abs(z - gait.state).max() for z in (walk.trajectory.start, walk.trajectory.section_states[-1]))
    assert last < 1e-4 < first
    assert simulate(gait, {"theta1": 1.1 * gait.state[0]}, steps=50).trajectory.ending != "completed"
    (line,) = [shlex.split(command) for command in COMMANDS if command.startswith("gaitopt simulate")]
    record = simulate(load_problem(line[2]), options.state([line[4]]), int(line[6])).to_record()
    assert record["status"] == "completed"


def test_the_energy_of_virtual_passive_walking_grows_with_the_position_of_the_mass():
    (program,) = (program for program in blocks("python") if "class VirtualPassive" in program)
    names = {}
    exec(compile(program, "docs", "exec"), names)  # noqa: S102
    gait, oracle = names["gait"], compass_oracle(**dict(names["problem"].walker))
    (arc,) = gait.arcs
    at_rest = np.zeros((len(arc.states), 2))  # the stance foot, at the origin
    shape, rates = (np.hstack([arc.states[:, columns], at_rest]) for columns in ([0, 1], [3, 4]))
    mass = sum(m.mass for m in oracle.masses)
    place = [sum(m.mass * m.point.position(q)[0] for m in oracle.masses) / mass for q in shape]
    energy = [oracle.energy(q, dq) for q, dq in zip(shape, rates, strict=True)]
    growth = mass * 9.81 * np.tan(np.radians(2)) * (np.array(place) - place[0])
    assert growth[-1] > 1
    assert np.array(energy) - energy[0] == pytest.approx(growth, abs=1e-8)


@pytest.mark.portable
@pytest.mark.parametrize("text", shown(blocks("yaml")))
def test_a_problem_file_that_is_shown_has_a_verified_gait(text):
    gait = solve(parse_problem(text, ROOT / "docs" / "examples" / "shown.yaml"))
    assert gait.converged, gait.message
    assert verify(gait).passed


@pytest.mark.slow
def test_the_notebook_runs_from_top_to_bottom(tmp_path):
    nbformat = pytest.importorskip("nbformat")
    NotebookClient = pytest.importorskip("nbclient").NotebookClient
    notebook = nbformat.read(ROOT / "docs" / "notebooks" / "tour.ipynb", as_version=4)
    NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", ())]
    kinds = [kind for output in outputs for kind in output.get("data", ())]
    assert kinds.count("image/png") == 3  # figures appear without any magic
    assert "<iframe" in "".join(output["data"].get("text/html", "") for output in outputs if "data" in output)
    assert not [output for output in outputs if output.get("name") == "stderr"]
    data = [(output["output_type"], output.get("data", {})) for output in outputs]
    tables = [kind for kind, shown in data if "<pre" in shown.get("text/html", "") and shown.get("text/plain")]
    assert set(tables) == {"execute_result"}  # printed once


def test_the_pages_name_every_claim_and_every_ending():
    trouble = (ROOT / "docs" / "troubleshooting.md").read_text()
    claims = trouble.split("## The claims of a verification")[1]
    named = [cell.strip() for row in re.findall(r"^\| ([a-z ,]+) \|", claims, re.MULTILINE) for cell in row.split(",")]
    gait = solve(load_problem("rimless-wheel-slip"))
    assert {claim.name for claim in verify(gait).claims} <= set(named)
    assert all(f"| `{ending}` |" in trouble for ending in Ending if ending is not Ending.COMPLETED)


def test_the_reference_of_the_problem_file_is_that_of_the_schema():
    script = runpy.run_path(str(ROOT / "docs" / "problem_keys.py"))
    page = script["page"]()
    assert script["PAGE"].read_text() == page
    rows = [re.split(r" (?<!\\)\| ", line) for line in page.splitlines() if line[:3] == "| `"]
    assert len(rows) > 200
    assert all(len(row) == 6 and row[1] and "any" not in row[1] and row[5][:-2].endswith(".") for row in rows)


@pytest.mark.slow
@pytest.mark.parametrize("example", GALLERY, ids=lambda path: path.stem)
def test_an_example_of_the_gallery_has_its_numbers_and_draws_its_picture(example, tmp_path, monkeypatch):
    if example.stem == "proof":
        pytest.importorskip("flint", reason="needs pip install '.[proof]'")
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(example), run_name="__main__")  # asserts its numbers
    picture = tmp_path / f"{example.stem}.png"
    assert picture.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["compass", "running"])
def test_the_programs_of_the_atlases_check_their_numbers(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found = runpy.run_path(str(ROOT / "docs" / "examples" / f"{name}_atlas.py"), run_name="__main__")
    assert found["atlas"].unexplained == ()


def test_the_gallery_shows_every_example_on_a_page_with_its_picture_and_a_moving_walker():
    page = (ROOT / "docs" / "gallery.md").read_text()
    cards = re.findall(r"^- \[!\[[^\]]+\]\(gallery/(\w+)\.gif\)\]\(gallery/\1\.md\)$", page, re.MULTILINE)
    assert sorted(cards) == [example.stem for example in GALLERY]
    assert len(cards) >= 8
    for name in cards:
        text = (ROOT / "docs" / "gallery" / f"{name}.md").read_text()
        assert f"literalinclude}} ../examples/gallery/{name}.py" in text
        assert f"]({name}.png)" in text


@pytest.mark.slow
def test_the_pages_build_without_a_warning(tmp_path):
    sphinx = pytest.importorskip("sphinx.cmd.build", reason="needs pip install '.[docs]'")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # those of Sphinx's own dependencies; -W counts the pages'
        assert sphinx.build_main(["-q", "-W", "--keep-going", str(ROOT / "docs"), str(tmp_path)]) == 0
    frame = re.search(r'<iframe[^>]* src="([^"#]+)', (tmp_path / "index.html").read_text(encoding="utf-8"))
    live = (tmp_path / frame[1]).read_text(encoding="utf-8")
    assert "<style>header, .scroll" in live  # the diagram and the walker, without the tables
    tutorial = (tmp_path / "tutorial.html").read_text(encoding="utf-8")
    assert "converged, stable" in tutorial  # what the commands print
    assert "reached friction = 0.14" in tutorial
    assert all((tmp_path / "_images" / f"{name}.svg").exists() for name in ("portrait", "force"))
    assert "Floquet multipliers" in (tmp_path / "notebooks" / "tour.html").read_text(encoding="utf-8")
    for page in tmp_path.glob("*.html"):  # of the site, its former pages, and those in frames
        for target in re.findall(
            r'<meta http-equiv="refresh" content="0; url=([^#"]+)', page.read_text(encoding="utf-8")
        ):
            assert (tmp_path / target).exists(), page
    frames = re.findall(r'<iframe[^>]* src="([^"#]+)', "".join(page.read_text() for page in tmp_path.glob("*.html")))
    assert len(frames) >= 4
    assert all((tmp_path / frame).exists() for frame in frames)


def test_the_sidebar_has_four_groups_of_at_most_seven_and_every_page_is_listed_once():
    groups = re.findall(r":caption: ([^\n]+)\n\n(.*?)\n```", (ROOT / "docs" / "index.md").read_text(), re.DOTALL)
    assert [name for name, _ in groups] == ["Start", "Do", "Understand", "Look up"]
    assert all(len(pages.split()) <= 7 for _, pages in groups)
    hidden = re.compile(r"toctree}\n:hidden:\n\n(.*?)\n```", re.DOTALL)
    below = [entries for page in PAGES for entries in hidden.findall(page.read_text())]
    listed = [page for pages in (*(pages for _, pages in groups), *below) for page in pages.split()]
    pages = {page.relative_to(ROOT / "docs").with_suffix("").as_posix() for page in GUIDE}
    assert sorted(listed) == sorted(pages - {"index", "changelog"} | {"notebooks/tour"})


def test_the_glossary_explains_each_term_once_and_names_no_unknown_gait():
    terms = re.findall(r"^\*\*(.+?)\*\*\n: ", (ROOT / "docs" / "glossary.md").read_text(), re.MULTILINE)
    assert len(terms) == len(set(terms)) > 25


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page):
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text()):
        assert (page.parent / target).exists(), target
