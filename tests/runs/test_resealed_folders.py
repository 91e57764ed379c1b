"""Run folders with right checksums and wrong content: refused with file and line, or read as what they were before."""

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
SWEEP = ("sweep", WHEEL, "--over", "friction=0.40:0.42:2", "--workers", "1", "-o", "run")
BASIN = ("basin", WHEEL, "--over", "dtheta=0.8:1.0:4", "--engine", "scipy", "--workers", "1", "-o", "run")
BRANCH = ("continue", "run", "--param", "friction", "--to", "0.41", "-o", "branch")
WALK = ("simulate", "run", "--steps", "2", "-o", "walk")
FRONT = ("front", DESIGN, "--over", "constraints.speed.min=0.35:0.36:2", "-o", "front")
STARTS = ("solve", WHEEL, "--starts", "2", "--workers", "1", "-o", "starts")
FIND = ("find", WHEEL, "--starts", "1", "-o", "find")

DROPPED = object()
VALUES = (
    DROPPED, None, True, "text", "\x1b[31m", "9" * 200_000, [], {}, [0.0] * 100_000, [{"re": 0.0, "im": 0.0}] * 100_000,
    1e300, -1e300, 10**400, -(10**400),
)  # fmt: skip
FREE = {"message", "note", "reason", "name", "solver", "start", "problem", "about"}
"""Entries under which any text or number is right; ``name`` is that of a claim."""
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
MAKERS = {
    "walk": WALK, "branch": BRANCH, "front": FRONT, "starts": STARTS, "find": FIND,
    "SWEEP": SWEEP, "BASIN": BASIN, "jobs.jsonl": SWEEP,
}  # fmt: skip
"""Commands that make a folder or a file; the gait of `run` is made first."""
QUICK = ("run/gait.json", "walk/walk.json", "branch/branch.jsonl", "run/jobs.jsonl")
SAMPLE = [pytest.param(name, marks=() if name in QUICK else pytest.mark.slow) for name in DOORS]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The folders that a file needs, each made once."""
    place, done = tmp_path_factory.mktemp("whole"), set()

    def make(name):
        maker = next((MAKERS[part] for part in name.split("/") if part in MAKERS), None)
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(place)
            for command in (("solve", WHEEL, "-o", "run"), maker):
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


def places(record, path=()):
    """Every entry of nested objects and lists; of a list the first and the last."""
    items = list(record.items() if isinstance(record, dict) else enumerate(record))
    for key, value in items if isinstance(record, dict) else [*items[:1], *items[1:][-1:]]:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


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


def spoiled(file):
    """Every change of every entry of a file: number of its line, place, value, and the text of the file."""
    lines = [json.loads(line) for line in file.read_text().splitlines()] if file.suffix == ".jsonl" else None
    records = [json.loads(file.read_text())] if lines is None else lines
    for line in sorted({0, 1, len(records) - 1} & {*range(len(records))}):
        body = {key: value for key, value in records[line].items() if key != "crc"}
        for path in places(body):
            for value in VALUES:
                record = changed(body, path, value)
                yield line + 1, path, value, record, (None if lines is None else records)


def rewrite(file, line, record, records):
    """Write the file with one record changed, and its checksums."""
    folder = Path(file.parts[0])
    name = file.relative_to(folder).as_posix()
    if records is None:
        file.write_text(json.dumps(record) + "\n")
        Run(folder).seal(name)
        return
    bodies = [{key: value for key, value in own.items() if key != "crc"} for own in records]
    bodies[line - 1] = record
    Run(folder).write({name: lines_text(bodies)})


def shown(result):
    """What a result says, without what may be any text."""
    if hasattr(result, "to_records"):
        said = result.to_records()
    elif hasattr(result, "to_record"):
        said = result.to_record()
    else:
        said = [dict(record) for record in result.records]
    return json.dumps(freed(said), sort_keys=True, default=lambda value: np.asarray(value).tolist())


def freed(record):
    if isinstance(record, dict):
        return {key: freed(value) for key, value in record.items() if key not in FREE}
    return [freed(value) for value in record] if isinstance(record, list | tuple) else record


def quick(folder, file):
    """What is read of a file without integrating the gaits of a branch."""
    return (
        (lambda: freed(list(stored_branch(folder)[2])))
        if file.endswith(".jsonl")
        else (lambda: shown(load_run(folder)))
    )


NULLABLE = {
    "apex_height",
    "gravity_cost",
    "required_friction",
    "impulse_ratio",
    "min_normal_force",
    "foot_clearance",
} | {"cost_of_transport", "absolute_cost_of_transport"}
"""Scalars that some gaits do not have; that one is missing cannot be seen in a record alone."""


LOOSE = {
    "damping_loss",
    "tangent",
    "length",
    "bound",
    "verification",
    "parameters",
    "gait_states",
    "walk",
    "multipliers",
    "candidates",
}
"""Entries that may be missing, be empty lists, or be lists of any length: the candidates of a search are guesses, which
are solved and verified before they are listed."""


def is_free(path):
    """A special point may have no gait, and its type is any name that a user has given an event."""
    return path in (("gait",), ("type",)) or bool((FREE | NULLABLE | LOOSE) & {*path})


def outcome(read):
    """What is read, and the words of a refusal."""
    try:
        return read(), ""
    except StorageError as error:
        return None, str(error)


def check_reading(name, share):
    """What is read is refused with its file, or is as before, for a share of all changes of a file."""
    file, folder = Path(placed(name)), Path(placed(DOORS[name][0]))
    read = quick(folder, name)
    before, content, manifest = read(), file.read_bytes(), (Path(file.parts[0]) / "manifest.json").read_bytes()
    chance, wrong = random.Random(1), []
    for line, path, value, record, records in spoiled(file):
        if chance.random() > share:
            continue
        rewrite(file, line, record, records)
        said, error = outcome(read)
        named = file.name in error or folder.name in error
        if error and not (named and (records is None or f"{file.name}:{line} " in error)):
            wrong.append((line, path, str(value)[:20], error))
        if not error and said != before and not is_free(path):
            wrong.append((line, path, str(value)[:20]))
    assert wrong == []
    file.write_bytes(content)
    (Path(file.parts[0]) / "manifest.json").write_bytes(manifest)


READ = [param for param in SAMPLE if DOORS[param.values[0]][0]]


@pytest.mark.usefixtures("copy")
@pytest.mark.parametrize("name", READ)
def test_what_is_read_is_refused_with_its_file_or_as_before(name):
    check_reading(name, 0.004 if name.endswith(".jsonl") else 0.01)


@pytest.mark.slow
@pytest.mark.usefixtures("copy")
@pytest.mark.parametrize("name", READ)
def test_many_changes_are_refused_or_as_before(name):
    check_reading(name, 0.03 if name.endswith(".jsonl") or "front" in name else 0.3)  # whose gaits take long


def check_commands(copy, run, name, share):
    """No command ends in an internal error or in another result, for a share of all changes of a file."""
    file, commands = Path(placed(name)), [[placed(word) for word in command] for command in DOORS[name][1:]]
    shutil.copytree(".", copy.parent / "before", dirs_exist_ok=True)
    results = [run(*command, "--quiet")[1] for command in commands]
    chance, wrong = random.Random(2), []
    for line, path, value, record, records in spoiled(Path(copy.parent / "before") / file):
        if chance.random() > share:
            continue
        for command, result in zip(commands, results, strict=True):
            shutil.rmtree(copy / file.parts[0])
            shutil.copytree(copy.parent / "before" / file.parts[0], copy / file.parts[0])
            rewrite(file, line, record, records)
            code, out, err = run(*command, "--quiet")
            if "internal error" in err or "Traceback" in err:
                wrong.append((command[0], line, path, str(value)[:20], err))
            elif code == 6:
                if file.parts[0] not in err:
                    wrong.append((command[0], line, path, str(value)[:20], err))
            elif out != result and not is_free(path):
                wrong.append((command[0], line, path, str(value)[:20], code, err))
    assert wrong == []


@pytest.mark.parametrize("name", [param for param in SAMPLE if param.values[0] != "branch/branch.jsonl"])
def test_no_command_ends_in_an_internal_error_or_another_result(copy, run, name):
    check_commands(copy, run, name, 0.001)


@pytest.mark.slow
@pytest.mark.parametrize("name", DOORS)
def test_many_changes_are_no_internal_error_and_no_other_result(copy, run, name):
    check_commands(copy, run, name, 0.1)


def test_values_that_are_not_those_of_the_manifest_are_refused(tmp_path):
    run = Run(named(WHEEL).save(tmp_path / "run"))
    run.write({"resolved.json": json.dumps(run.read_object("resolved.json") | {"friction": 0.5})})
    with pytest.raises(StorageError, match=r"resolved\.json does not have the hash of the manifest"):
        load_run(run.folder)
