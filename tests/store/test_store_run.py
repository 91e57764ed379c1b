"""A run folder holds one problem, is complete or says that it is not, and is never taken from anyone else."""

import dataclasses
import errno
import hashlib
import json
import os
import platform
from pathlib import Path

import pytest

from gaitopt.errors import StorageError
from gaitopt.store.files import write_whole
from gaitopt.store.formats import Table
from gaitopt.store.run import GAIT_FILES, Run

GAIT = {"problem": "walk", "status": "converged", "period": 1 / 3, "required_friction": None}
TRAJECTORY = Table(header=("t", "mode", "theta"), rows=((0.0, "stick", -0.1), (1 / 3, "stick", 0.1)))
FILES = ["gait.json", "manifest.json", "problem.yaml", "resolved.json", "trajectory.csv"]


@dataclasses.dataclass(frozen=True)
class SomeProblem:
    """The part of a Problem that the store reads."""

    name: str = "walk"
    friction: float = 0.2
    text: str = "name: walk  # verbatim\r\n"

    def resolved(self):
        return {"name": self.name, "friction": self.friction}

    @property
    def digest(self):
        return hashlib.sha256(json.dumps(self.resolved()).encode()).hexdigest()


def written(folder, problem=None, record=GAIT):
    """A run folder with a gait."""
    Run(folder).write_result(problem or SomeProblem(), record, TRAJECTORY)
    return folder


@pytest.fixture
def folder(tmp_path):
    return written(tmp_path / "run")


def reader(name):
    """What reads a file of a run."""
    return Run.problem if name in ("problem.yaml", "resolved.json") else Run.read_result


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_run_is_read_back_as_it_was_written(folder):
    assert sorted(contents(folder)) == FILES
    assert Run(folder).read_result() == (GAIT, TRAJECTORY)
    assert (folder / "problem.yaml").read_bytes().decode() == SomeProblem().text
    assert Run(folder).read_object("resolved.json") == SomeProblem().resolved()
    assert Run(folder).manifest().hash == SomeProblem().digest


def test_the_manifest_names_versions_and_platform_but_no_host(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest["schema"] == 2
    assert {"gaitopt", "python", "casadi", "numpy", "scipy"} <= manifest["versions"].keys()
    assert manifest["platform"]["system"] == platform.system()
    assert platform.node() not in (folder / "manifest.json").read_text()


def test_the_same_problem_replaces_its_run_and_another_is_refused_and_changes_nothing(folder):
    written(folder, record=GAIT | {"period": 2.0})
    assert Run(folder).read_result()[0]["period"] == 2.0
    assert sorted(contents(folder)) == FILES
    before = contents(folder)
    with pytest.raises(StorageError, match="contains another problem"):
        written(folder, SomeProblem(friction=0.3))
    assert contents(folder) == before


def test_the_problem_of_a_run_stays_readable_while_another_result_is_written(folder, monkeypatch):
    def killed_at_the_gait(path, content):
        if path.name == "gait.json":
            raise KeyboardInterrupt
        write_whole(path, content)

    monkeypatch.setattr("gaitopt.store.run.write_whole", killed_at_the_gait)
    with pytest.raises(KeyboardInterrupt):
        written(folder, record=GAIT | {"period": 2.0})
    assert Run(folder).holds("problem.yaml", "resolved.json", "trajectory.csv")
    assert not Run(folder).holds("gait.json")
    assert Run(folder).read_object("resolved.json") == SomeProblem().resolved()


def test_a_foreign_folder_is_refused_and_left_alone(tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(StorageError, match="not a run of gaitopt"):
        written(tmp_path)
    assert contents(tmp_path) == {"thesis.tex": b"precious"}
    (tmp_path / "manifest.json").write_text('{"format": "web app", "schema": 99}')
    with pytest.raises(StorageError, match="not the manifest of a gaitopt run"):
        Run(tmp_path).read_result()


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"schema": 3, "hash": {"sha3": "0"}}, r"newer gaitopt \(schema 3"),
        ({"schema": 1, "files": None, "checksum": None}, r"older gaitopt, without checksums \(schema 1\)"),
    ],
)
def test_a_newer_or_older_run_is_named_and_left_alone(folder, changes, words):
    manifest = json.loads((folder / "manifest.json").read_text()) | changes
    manifest = {key: value for key, value in manifest.items() if value is not None}
    (folder / "manifest.json").write_text(json.dumps(manifest))
    before = contents(folder)
    for use in (Run.read_result, lambda run: written(run.folder)):
        with pytest.raises(StorageError, match=words):
            use(Run(folder))
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"format": "gaitopt r', "not JSON"),
        ("[" * 100_000, "nested too deeply"),
        ("[]", "not a JSON object"),
        ('{"format": "gaitopt run"}', "altered"),
        ('{"format": "gaitopt run", "schema": null}', "altered"),
        ('{"format": "gaitopt run", "schema": 2, "files": {}}', "altered"),
        ('{"format": "gaitopt run", "schema": 2, "hash": NaN}', "not a JSON number"),
    ],
)
def test_a_broken_manifest_is_named_and_left_alone(folder, text, words):
    (folder / "manifest.json").write_text(text)
    before = contents(folder)
    with pytest.raises(StorageError, match=rf"manifest\.json: .*{words}.*not changed"):
        Run(folder).read_result()
    assert contents(folder) == before


@pytest.mark.parametrize("name", ["gait.json", "resolved.json", "trajectory.csv", "problem.yaml"])
@pytest.mark.parametrize("change", ["digit", "row", "swap", "torn", "empty", "bytes"])
def test_an_altered_file_is_named_with_its_line_and_left_alone(folder, name, change):
    (folder / "problem.yaml").write_text("name: walk\nfriction: 0.2\nlast: 3\n")
    Run(folder).seal("problem.yaml")
    lines = (folder / name).read_bytes().splitlines(keepends=True)
    damaged, line = {
        "digit": ([*lines[:-1], lines[-1].replace(b"\n", b" \n")], len(lines)),
        "row": ([lines[0], *lines[2:]], 2),
        "swap": ([lines[1], lines[0], *lines[2:]], 1),
        "torn": ([*lines[:-1], lines[-1][:-1]], len(lines)),
        "empty": ([], 1),
        "bytes": ([b"\xff\xfe", *lines[1:]], 1),
    }[change]
    (folder / name).write_bytes(b"".join(damaged))
    before = contents(folder)
    with pytest.raises(StorageError, match=rf"{name}:{line}: altered since it was written .*not changed"):
        reader(name)(Run(folder))
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("gait.json", '{"status": "conv', "not JSON"),
        ("gait.json", "[]", "not a JSON object"),
        ("gait.json", "[" * 100_000, "nested too deeply"),
        ("resolved.json", "\0", "not JSON"),
        ("gait.json", '{"a": %s}' % ("1" * 5000), "not JSON"),
        ("trajectory.csv", "t,mode,theta\n0.0,stick,0\n2", "line 3 has 1 cells"),
        ("trajectory.csv", "t,mode,theta\n0.0,stick,l\n", "line 2: .*'l'"),
        ("trajectory.csv", "t,mode,theta\n0.0,stick,nan\n", "line 2: .*finite"),
        ("trajectory.csv", b"\xff\n", "not UTF-8 text"),
    ],
)
def test_a_broken_file_that_has_its_checksum_is_named_all_the_same(folder, name, text, words):
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    Run(folder).seal(name)
    with pytest.raises(StorageError, match=rf"{name}.*{words}.*damaged and was not changed"):
        reader(name)(Run(folder))


def test_lines_may_grow_after_they_were_finished_and_rows_missing_from_their_end_are_noticed(folder):
    for k in range(3):
        with Run(folder).appending("jobs.jsonl") as lines:
            lines.append({"job": k})
    assert [record["job"] for record in Run(folder).lines("jobs.jsonl")] == [0, 1, 2]
    text = (folder / "jobs.jsonl").read_bytes()
    (folder / "jobs.jsonl").write_bytes(b"".join(text.splitlines(keepends=True)[:-1]))
    with pytest.raises(StorageError, match=r"jobs\.jsonl:3: missing or cut off, 3 lines were written"):
        list(Run(folder).lines("jobs.jsonl"))
    (folder / "jobs.jsonl").write_bytes(text[:-5])  # no crash cuts a line that the manifest counts
    with pytest.raises(StorageError, match=r"jobs\.jsonl:3: missing or cut off"):
        list(Run(folder).lines("jobs.jsonl"))
    (folder / "jobs.jsonl").write_bytes(text + text[:5])  # but one that came after
    assert len(list(Run(folder).lines("jobs.jsonl"))) == 3
    (folder / "jobs.jsonl").unlink()
    with pytest.raises(StorageError, match=r"cannot read .*jobs\.jsonl"):
        list(Run(folder).lines("jobs.jsonl"))


@pytest.mark.parametrize("name", ["problem.yaml", "resolved.json", "trajectory.csv"])
def test_a_missing_file_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(StorageError, match=rf"{name} is missing"):
        reader(name)(Run(folder))


def test_a_full_disk_names_the_file_and_what_was_kept(tmp_path, monkeypatch):
    replace = Path.replace

    def full_at_trajectory(path, target):
        if target.name == "trajectory.csv":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return replace(path, target)

    monkeypatch.setattr(Path, "replace", full_at_trajectory)
    kept = r"trajectory\.csv: No space left on device; kept whole in .*: manifest.json, problem.yaml, resolved.json$"
    with pytest.raises(StorageError, match=kept) as caught:
        written(tmp_path / "run")
    assert caught.value.exit_code == 6
    assert sorted(contents(tmp_path / "run")) == ["manifest.json", "problem.yaml", "resolved.json"]


def test_leftovers_of_a_killed_writer_do_not_make_a_folder_foreign(tmp_path):
    (tmp_path / ".manifest.json.4711.tmp").write_text('{"for')
    Run(tmp_path).check(SomeProblem())


@pytest.mark.parametrize(
    "name", ["../evil", "..", "/etc", "a/b\\c", "", ".hidden", "x" * 300, "ñandú läuft", "a\nb\0c"]
)
def test_no_name_leads_out_of_the_results(tmp_path, name):
    run = Run.of(SomeProblem(name=name), results=tmp_path)
    folder = run.folder
    assert folder.resolve().parent == tmp_path.resolve()
    written(folder, SomeProblem(name=name))
    assert run.holds(*GAIT_FILES)


def test_a_folder_is_named_after_problem_and_hash_and_has_no_run_before_it_is_written(tmp_path):
    assert Run.of(SomeProblem()).folder == Path("results") / f"walk-{SomeProblem().digest[:8]}"
    assert not Run.of(SomeProblem(), results=tmp_path / "results").holds(*GAIT_FILES)


@pytest.mark.parametrize(
    ("name", "words"),
    [("file", "Not a directory; choose another"), ("file/deeper/run", "file"), ("x" * 300, "File name too long")],
)
def test_a_folder_that_cannot_be_made_is_named(tmp_path, name, words):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match=words) as refused:
        written(tmp_path / name)
    assert refused.value.argument == "output"
