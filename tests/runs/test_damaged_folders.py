"""A damaged run folder is refused with its file and not changed: exit code 6, never an internal error, never a pass.

With right checksums, wrong content is refused with file and line, or read as what it was before.
"""

import json
import random
import shutil
from pathlib import Path

import numpy as np
import pytest
from named import named

from gaitopt import load_run
from gaitopt.cli.main import main
from gaitopt.errors import StorageError
from gaitopt.runs.branch import stored_branch
from gaitopt.store.files import lines_text
from gaitopt.store.run import Run

WHEEL, DESIGN = "rimless-wheel-slip", "compass-torque-efficient"
SOLVE = ("solve", WHEEL, "-o", "run")
SWEEP = ("sweep", WHEEL, "--over", "friction=0.40:0.42:2", "--workers", "1", "-o", "run")
BASIN = ("basin", WHEEL, "--over", "dtheta=0.8:1.0:4", "--engine", "scipy", "--workers", "1", "-o", "run")
BRANCH = ("continue", "run", "--param", "friction", "--to", "0.41", "--max-points", "4", "-o", "branch")
WALK = ("simulate", "run", "--steps", "2", "-o", "walk")
FRONT = ("front", DESIGN, "--over", "constraints.speed.min=0.35:0.36:2", "-o", "front")
STARTS = ("solve", WHEEL, "--starts", "2", "--workers", "1", "-o", "starts")
FIND = ("find", WHEEL, "--starts", "1", "-o", "find")
MAKERS = {
    "walk": WALK, "branch": BRANCH, "front": FRONT, "starts": STARTS, "find": FIND,
    "SWEEP": SWEEP, "BASIN": BASIN, "jobs.jsonl": SWEEP,
}  # fmt: skip
"""Commands that make a folder or a file; the gait of `run` is made first."""
READERS = {
    "run/gait.json": (("verify", "run"), ("plot", "run", "--what", "multipliers"), ("report", "run"), BRANCH),
    "run/trajectory.csv": (("verify", "run"), ("solve", WHEEL, "--start", "run", "-o", "other")),
    "run/resolved.json": (("verify", "run"), ("simulate", "run")),
    "run/problem.yaml": (("verify", "run"),),
    "run/manifest.json": (("verify", "run"), SWEEP, BASIN),
    "run/jobs.jsonl": (SWEEP,),
    "run/SWEEP/sweep.json": (("plot", "run/SWEEP"),),
    "run/SWEEP/table.csv": (("plot", "run/SWEEP"),),
    "run/BASIN/basin.json": (("plot", "run/BASIN"),),
    "run/BASIN/tile-000000.npz": (("plot", "run/BASIN"),),
    "branch/branch.jsonl": (("plot", "branch"), ("report", "branch"), BRANCH),
    "branch/resolved.json": (("plot", "branch"),),
}
"""The commands that read each file."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folders that a file needs, each made once."""
    place, done = tmp_path_factory.mktemp("whole"), set()

    def make(name):
        maker = next((MAKERS[part] for part in name.split("/") if part in MAKERS), None)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(place)
            for command in (SOLVE, maker):
                if command and command not in done:
                    assert main([*command, "--quiet"]) == 0, command
                    done.add(command)
        return place

    return make


@pytest.fixture
def copy(made, name, tmp_path, monkeypatch):
    shutil.copytree(made(name), tmp_path / "copy")
    monkeypatch.chdir(tmp_path / "copy")
    return tmp_path / "copy"


def placed(word):
    """A word with the names of the folders of sweep and basin."""
    for kind in ("sweep", "basin"):
        if kind.upper() in word:
            word = word.replace(kind.upper(), next(Path("run").glob(f"{kind}-*")).name)
    return word


def digit(content, chance):
    numbers = [k for k, byte in enumerate(content) if chr(byte).isdigit()] or [len(content) // 2]
    k = chance.choice(numbers)
    return content[:k] + (b"1" if content[k : k + 1] != b"1" else b"2") + content[k + 1 :]


def without_row(content, chance):
    lines = content.splitlines(keepends=True)
    lines.pop(chance.randrange(max(len(lines) - 1, 1)))
    return b"".join(lines)


def with_swapped_rows(content, chance):
    lines = content.splitlines(keepends=True)
    k = chance.randrange(max(len(lines) - 1, 1))
    if len(lines) > k + 1 and lines[k] != lines[k + 1]:
        lines[k], lines[k + 1] = lines[k + 1], lines[k]
    else:
        lines.append(b"\n")
    return b"".join(lines)


DAMAGES = {
    "digit": digit,
    "deleted row": without_row,
    "swapped rows": with_swapped_rows,
    "nested": lambda content, chance: b"[" * 100_000,
    "empty object": lambda content, chance: b"{}\n",
    "empty": lambda content, chance: b"",
    "cut": lambda content, chance: content[: len(content) // 2],
    "random bytes": lambda content, chance: bytes(chance.randrange(256) for _ in range(300)),
}


@pytest.mark.usefixtures("copy")
@pytest.mark.parametrize("name", READERS)
def test_damage_of_any_kind_is_noticed_by_every_command_that_reads_the_file(run, name):
    path = Path(placed(name))
    if path.name != "manifest.json":
        assert path.relative_to(path.parts[0]).as_posix() in Run(Path(path.parts[0])).manifest().files
    content = path.read_bytes()
    for kind, change in DAMAGES.items():
        damaged = change(content, random.Random(1))
        assert damaged != content
        path.write_bytes(damaged)
        for command in READERS[name]:
            code, out, err = run(*map(placed, command))
            assert code == 6, (kind, command, code, err)
            assert path.name in err, (kind, command, err)
            assert "passed" not in out
            assert path.read_bytes() == damaged


@pytest.mark.usefixtures("copy")
@pytest.mark.parametrize("name", ["run/gait.json"])
def test_manifest_that_lost_a_file_says_unfinished(run, name):
    Path(name).unlink()
    code, _, err = run("verify", "run")
    assert (code, "unfinished" in err) == (6, True)


DROPPED = object()
VALUES = (
    DROPPED, None, True, "text", "\x1b[31m", "9" * 200_000, [], {}, [0.0] * 100_000, [{"re": 0.0, "im": 0.0}] * 100_000,
    1e300, -1e300, 10**400, -(10**400),
)  # fmt: skip
FREE = {"message", "note", "reason", "name", "solver", "start", "problem", "about"}
"""Entries under which any text or number is right; ``name`` is that of a claim."""
NULLABLE = {"apex_height", "gravity_cost", "required_friction", "impulse_ratio", "min_normal_force", "foot_clearance"}
NULLABLE |= {"cost_of_transport", "absolute_cost_of_transport"}
"""Scalars that some gaits do not have; that one is missing cannot be seen in a record alone."""
LOOSE = {"damping_loss", "tangent", "length", "bound", "verification", "parameters", "gait_states", "walk"}
LOOSE |= {"multipliers", "candidates"}
"""Entries that may be missing, be empty lists, or be lists of any length: the candidates of a search are guesses, which
are solved and verified before they are listed."""
DOORS = {
    "run/gait.json": ("run", ("verify", "run"), ("plot", "run"), ("report", "run"), BRANCH),
    "walk/walk.json": ("walk", ("plot", "walk"), ("report", "walk")),
    "branch/branch.jsonl": ("branch", ("plot", "branch"), ("report", "branch"), BRANCH),
    "front/front-constraints.speed.min.json": ("front", ("plot", "front")),
    "run/SWEEP/sweep.json": ("run/SWEEP", ("plot", "run/SWEEP"), SWEEP),
    "run/BASIN/basin.json": ("run/BASIN", ("plot", "run/BASIN"), BASIN),
    "run/resolved.json": ("run", ("verify", "run")),
    "run/jobs.jsonl": ("", SWEEP),
    "front/jobs.jsonl": ("", FRONT),
    "starts/jobs.jsonl": ("", STARTS),
    "find/find.jsonl": ("", FIND),
}
"""Files with the folder that `load_run` takes, and the commands that read them."""
QUICK = ("run/gait.json", "walk/walk.json", "branch/branch.jsonl", "run/jobs.jsonl")


def cases(few, many):
    """Files with the share of their changes that is tried: few changes of these, and, as slow tests, many of those."""
    quick = [pytest.param(name, share, marks=() if name in QUICK else pytest.mark.slow) for name, share in few.items()]
    return [*quick, *(pytest.param(name, share, marks=pytest.mark.slow) for name, share in many.items())]


def entries(record, path=()):
    """Every entry of nested objects and lists; of a list the first and the last."""
    items = list(record.items() if isinstance(record, dict) else enumerate(record))
    for key, value in items if isinstance(record, dict) else [*items[:1], *items[1:][-1:]]:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from entries(value, (*path, key))


def changed(record, path, value):
    """The record with another value at a place."""
    record = json.loads(json.dumps(record))
    owner = record
    for key in path[:-1]:
        owner = owner[key]
    if value is DROPPED:
        del owner[path[-1]]
    else:
        owner[path[-1]] = value
    return record


def spoiled(file, chance, share):
    """A share of all changes of a file: line, path and value of the entry, the new record, and all records of lines."""
    lines = [json.loads(line) for line in file.read_text().splitlines()] if file.suffix == ".jsonl" else None
    records = [json.loads(file.read_text())] if lines is None else lines
    for line in sorted({0, 1, len(records) - 1} & {*range(len(records))}):
        body = {key: value for key, value in records[line].items() if key != "crc"}
        for path in entries(body):
            for value in VALUES:
                if chance.random() <= share:
                    yield line + 1, path, value, changed(body, path, value), lines


def rewrite(file, line, record, records):
    """Write the file with one record changed, and its checksums."""
    folder = Path(file.parts[0])
    name = file.relative_to(folder).as_posix()
    if records is None:
        file.write_text(json.dumps(record) + "\n")
        Run(folder).seal(name)
        return
    bodies = [{key: value for key, value in each.items() if key != "crc"} for each in records]
    bodies[line - 1] = record
    Run(folder).write({name: lines_text(bodies)})


def freed(record):
    """A record without what may be any text."""
    if isinstance(record, dict):
        return {key: freed(value) for key, value in record.items() if key not in FREE}
    return [freed(value) for value in record] if isinstance(record, list | tuple) else record


def content_of(folder, name):
    """What is read of a file, without integrating the gaits of a branch."""
    if name.endswith(".jsonl"):
        return freed(list(stored_branch(folder)[2]))
    result = load_run(folder)
    if hasattr(result, "to_records"):
        said = result.to_records()
    elif hasattr(result, "to_record"):
        said = result.to_record()
    else:
        said = [dict(record) for record in result.records]
    return json.dumps(freed(said), sort_keys=True, default=lambda value: np.asarray(value).tolist())


def is_free(path):
    """A special point may have no gait, and its type is any name that a user has given an event."""
    return path in (("gait",), ("type",)) or bool((FREE | NULLABLE | LOOSE) & {*path})


READ = [name for name, (folder, *_) in DOORS.items() if folder]


@pytest.mark.usefixtures("copy")
@pytest.mark.parametrize(
    ("name", "share"),
    cases(
        {name: 0.004 if name.endswith(".jsonl") else 0.01 for name in READ},
        {name: 0.03 if name.endswith(".jsonl") or "front" in name else 0.3 for name in READ},  # whose gaits take long
    ),
)
def test_what_is_read_is_refused_with_its_file_or_as_before(name, share):
    file, folder = Path(placed(name)), Path(placed(DOORS[name][0]))
    before, wrong = content_of(folder, name), []
    for line, path, value, record, records in spoiled(file, random.Random(1), share):
        rewrite(file, line, record, records)
        try:
            if content_of(folder, name) != before and not is_free(path):
                wrong.append((line, path, str(value)[:20]))
        except StorageError as error:
            at_line = records is None or f"{file.name}:{line} " in str(error)
            if not (at_line and (file.name in str(error) or folder.name in str(error))):
                wrong.append((line, path, str(value)[:20], str(error)))
    assert wrong == []


@pytest.mark.parametrize(
    ("name", "share"),
    cases(dict.fromkeys([name for name in DOORS if name != "branch/branch.jsonl"], 0.0006), dict.fromkeys(DOORS, 0.1)),
)
def test_no_command_ends_in_an_internal_error_or_another_result(copy, run, name, share):
    file, commands = Path(placed(name)), [[placed(word) for word in command] for command in DOORS[name][1:]]
    before = copy.parent / "before"
    shutil.copytree(".", before)
    results, wrong = [run(*command, "--quiet")[1] for command in commands], []
    for line, path, value, record, records in spoiled(before / file, random.Random(2), share):
        for command, result in zip(commands, results, strict=True):
            shutil.rmtree(copy / file.parts[0])
            shutil.copytree(before / file.parts[0], copy / file.parts[0])
            rewrite(file, line, record, records)
            code, out, err = run(*command, "--quiet")
            fails = "internal error" in err or "Traceback" in err
            differs = file.parts[0] not in err if code == 6 else out != result and not is_free(path)
            if fails or differs:
                wrong.append((command[0], line, path, str(value)[:20], code, err))
    assert wrong == []


def test_values_that_are_not_those_of_the_manifest_are_refused(tmp_path):
    run = Run(named(WHEEL).save(tmp_path / "run"))
    run.write({"resolved.json": json.dumps(run.read_object("resolved.json") | {"friction": 0.5})})
    with pytest.raises(StorageError, match=r"resolved\.json does not have the hash of the manifest"):
        load_run(run.folder)
