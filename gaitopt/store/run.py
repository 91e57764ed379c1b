"""A run folder: one problem, and the results that were computed for it.

The manifest states format, schema, versions, platform, the hash of the problem, and the SHA-256 of every finished file.
A file is written in three steps: its checksum is removed from the manifest, the file is replaced, and its new checksum
is entered. A file without a checksum is therefore unfinished. The manifest is written first, so that every folder
states its problem; the record of a gait is written last, so that a folder with a gait is complete. After a crash the
same command completes the folder. One process at a time writes it.
"""

import hashlib
import platform
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self, TypeVar

from gaitopt.errors import GaitoptError, ProblemError, StorageError
from gaitopt.problem.problem import RESOLVED_FILE, Problem, check_installed, restore_problem
from gaitopt.problem.statement import digest_of
from gaitopt.store.files import (
    TEMPORARY_SUFFIX,
    LineWriter,
    check_writable,
    clear_leftovers,
    entries,
    make_folder,
    read_bytes,
    read_lines,
    write_whole,
)
from gaitopt.store.formats import (
    FileSum,
    Table,
    check_content,
    csv_text,
    file_sum,
    json_file,
    json_text,
    parse_csv,
    parse_object,
    parsed,
    validated,
)
from gaitopt.store.lock import LOCK_FILE, WRITER_FILE, only_writer, wait_for_writer, written_elsewhere

Model = TypeVar("Model")
RESULTS = Path("results")
"""Folder of all runs, unless the user names another."""
MANIFEST_FILE = "manifest.json"
PROBLEM_FILE = "problem.yaml"
ROBOT_FILE = "robot.urdf"
"""Copy of the URDF file that the problem names; the resolved problem contains its text as well."""
TABLE_FILE = "control.{}.csv"
"""Copy of the table that a key of the control law names; the resolved problem contains its text as well."""
PROBLEM_FILES = PROBLEM_FILE, RESOLVED_FILE
GAIT_FILE, WALK_FILE = "gait.json", "walk.json"
GAIT_FILES, WALK_FILES = (GAIT_FILE, "trajectory.csv"), (WALK_FILE, "walk.csv")
"""Record and table of a gait, and of a simulated walk."""
LONGEST_NAME = 60
"""Largest number of characters of a problem's name in the name of its folder. Even with four bytes each, such a name
fits every file system."""
FORMAT = "gaitopt run"
SCHEMA = 2
"""Version of the layout of a run folder. It is raised if older readers would misread a folder; 2 introduced
checksums."""
CHECKSUM = "checksum"
"""Key of the SHA-256 of the rest of the manifest."""
PACKAGES = ("gaitopt", "casadi", "numpy", "scipy", "pydantic", "ruamel.yaml")
"""Packages on which the numbers of a run depend."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """The contents of ``manifest.json``.

    Attributes
    ----------
    problem, hash : name of the problem, and hash of its resolved values, including those of its references.
    versions, platform : versions of the packages that wrote the run, and kind of machine; the host is not named.
    files : checksums of the finished files, by their paths within the folder.
    """

    problem: str
    hash: str
    versions: dict[str, str]
    platform: dict[str, str]
    files: dict[str, FileSum] = field(default_factory=dict)
    format: str = FORMAT
    schema: int = SCHEMA

    @classmethod
    def of(cls, problem: Problem, files: Mapping[str, FileSum] | None = None) -> Self:
        """The manifest of a run of ``problem``, with the versions and platform of this process."""
        machine = {"system": platform.system(), "machine": platform.machine()}
        return cls(
            problem=problem.name, hash=problem.digest, versions=_versions(), platform=machine, files=dict(files or {})
        )

    def to_record(self) -> dict[str, Any]:
        """The manifest as a JSON object, with its own checksum."""
        record = asdict(self)
        return record | {CHECKSUM: _checksum(record)}


def _checksum(record: dict[str, Any]) -> str:
    return hashlib.sha256(json_text(record).encode()).hexdigest()


@lru_cache(maxsize=1)
def _versions() -> dict[str, str]:
    return {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}


@dataclass(frozen=True, slots=True)
class Run:
    """A run folder: a problem and its results. The folder need not exist yet.

    To write, lock the folder with ``begun``, then ``write`` whole files or append records with ``appending``. To read,
    ``holds`` tells which files are finished, ``problem`` and ``manifest`` tell their origin, and ``read``,
    ``read_object``, ``read_result`` and ``lines`` return their content. Names of files are paths within the folder, or
    within ``subfolder``.

    Reading raises a ``StorageError`` that names file and line if a file is missing, unfinished or altered. It waits
    while another process is about to finish a file.

    Attributes
    ----------
    folder : the folder of the run, with its manifest.
    subfolder : that of a sweep or a basin, whose files the manifest of the run lists; empty for the run itself.
    """

    folder: Path
    subfolder: str = ""

    @classmethod
    def of(cls, problem: Problem, folder: str | Path | None = None, *, results: Path = RESULTS) -> Self:
        """The run of a problem in ``results/NAME-HASH8``, whatever characters its name has, or in ``folder``."""
        if folder is not None:
            return cls(Path(folder))
        name = re.sub(r"[^\w.-]+", "-", problem.name)[:LONGEST_NAME].strip(".-") or "problem"
        return cls(results / f"{name}-{problem.digest[:8]}")

    @classmethod
    def at(cls, path: Path) -> Self:
        """The run in a folder, or the run that has this folder as its subfolder."""
        if (path / MANIFEST_FILE).is_file() or not (path / ".." / MANIFEST_FILE).is_file():
            return cls(path)
        return cls(path.resolve().parent, path.resolve().name)

    @property
    def result_folder(self) -> Path:
        """The folder of the files: that of the run, or its subfolder."""
        return self.folder / self.subfolder

    def path(self, name: str) -> Path:
        """The path of a file."""
        return self.result_folder / name

    def _key(self, name: str) -> str:
        """The path of a file within the run folder, under which the manifest lists it."""
        return f"{self.subfolder}/{name}" if self.subfolder else name

    # writing

    def check(self, problem: Problem, *, write: bool = False) -> None:
        """Refuse a folder that may not be written for this problem, before anything is computed or written.

        Parameters
        ----------
        write : whether to check as well that this process may write into an existing run of the problem.

        Raises
        ------
        StorageError
            If the folder contains the run of another problem, files that are not a run, or a damaged or newer run.
        """
        names = [path.name for path in entries(self.folder)]
        leftovers = [n for n in names if n.startswith(".") and n.endswith(TEMPORARY_SUFFIX)]  # of a killed writer
        if not set(names) - {LOCK_FILE, WRITER_FILE, *leftovers}:
            check_writable(self.folder)
            return
        manifest = self.manifest()
        if manifest.hash != problem.digest:
            raise StorageError(
                f"{self.folder} contains another problem ({manifest.problem}, hash {manifest.hash[:8]}, not "
                f"{problem.name}, hash {problem.digest[:8]}); it was not changed: delete it, or choose another folder"
            ).concerning("output")
        if write:
            check_writable(self.folder)

    @contextmanager
    def writing(self, problem: Problem) -> Iterator[None]:
        """Lock the folder for writing. It is made if necessary, and removed if nothing is written. Blocks may nest.

        Raises
        ------
        StorageError
            If ``check`` refuses the folder, or if another process is writing it.
        """
        self.check(problem)
        made = make_folder(self.folder)
        try:
            with only_writer(self.folder):
                self.check(problem)  # again: another process may have written before the folder was locked
                yield
        finally:
            for folder in made:
                with suppress(OSError):  # only an empty folder can be removed
                    folder.rmdir()

    @contextmanager
    def begun(self, problem: Problem) -> Iterator[None]:
        """Lock the folder like ``writing``, and write the files of every run: manifest and problem."""
        with self.writing(problem):
            files = self.manifest().files if (self.folder / MANIFEST_FILE).exists() else {}
            self._write_manifest(Manifest.of(problem, files))
            run = Run(self.folder)
            resolved = problem.resolved()
            robot = resolved.get("walker", {}).get("urdf")
            named = {ROBOT_FILE: robot["text"]} if robot else {}
            for name, entry in resolved.get("control", {}).items():
                table = entry.get("table") if isinstance(entry, Mapping) else None
                named |= {TABLE_FILE.format(name): table["text"]} if isinstance(table, Mapping) else {}
            run.write({PROBLEM_FILE: problem.text, RESOLVED_FILE: json_file(resolved), **named})
            if self.subfolder:
                make_folder(self.result_folder, parents=False)
            yield

    def write(self, contents: Mapping[str, str]) -> None:
        """Write files by name; they count as unfinished until all of them are written.

        Finished files with the same content are left alone, so that the problem of a run can be read at any time.
        """
        manifest = self.manifest()
        contents = {name: text for name, text in contents.items() if not self._is_finished(name, text, manifest)}
        keys = [self._key(name) for name in contents]
        others = {key: known for key, known in manifest.files.items() if key not in keys}
        if others != manifest.files:
            self._write_manifest(replace(manifest, files=others))
        for name, content in contents.items():
            write_whole(self.path(name), content)
        self.seal(*contents)

    def write_result(
        self, problem: Problem, record: Mapping[str, Any], table: Table, files: tuple[str, str] = GAIT_FILES
    ) -> None:
        """Write record and table of a gait or of a simulated walk, which replace those of an earlier call.

        Parameters
        ----------
        record : the JSON object of the gait or walk.
        table : its states and forces over time.
        files : ``GAIT_FILES`` or ``WALK_FILES``.
        """
        with self.begun(problem):
            self.write({files[1]: csv_text(table), files[0]: json_file(record)})

    def seal(self, *names: str) -> None:
        """Enter the checksums of files, as they are now, into the manifest."""
        manifest = self.manifest()
        sums = {self._key(name): file_sum(self.path(name), read_bytes(self.path(name))) for name in names}
        if not sums.items() <= manifest.files.items():
            self._write_manifest(replace(manifest, files=dict(sorted((manifest.files | sums).items()))))

    @contextmanager
    def appending(self, name: str) -> Iterator[LineWriter]:
        """Append to a file of records; when the block ends or is interrupted, the file's checksum enters the manifest.

        ``LineWriter.records`` contains the records from earlier calls.
        """
        complete = False
        try:
            with LineWriter(self.path(name), self.manifest().files.get(self._key(name))) as lines:
                yield lines
            complete = True
        except (KeyboardInterrupt, GeneratorExit):
            complete = True
            raise
        finally:
            if complete:
                self.seal(name)

    @contextmanager
    def adding(self, folder: Path) -> Iterator[list[Path]]:
        """Add figures or pages to a folder; the block collects their paths in the list.

        Files in the run folder get checksums.

        Parameters
        ----------
        folder : folder of the files, in the run folder or elsewhere; made if necessary.
        """
        added: list[Path] = []
        if not folder.resolve().is_relative_to(self.folder.resolve()):
            make_folder(folder)
            clear_leftovers(folder)
            yield added
            return
        with only_writer(self.folder):
            make_folder(folder)
            yield added
            Run(self.folder).seal(*(path.resolve().relative_to(self.folder.resolve()).as_posix() for path in added))

    def _write_manifest(self, manifest: Manifest) -> None:
        write_whole(self.folder / MANIFEST_FILE, json_file(manifest.to_record()))

    # reading

    def manifest(self) -> Manifest:
        """The manifest.

        Raises
        ------
        StorageError
            If the folder is not a run, is damaged, or was written by a newer gaitopt or by one without checksums.
        """
        path = self.folder / MANIFEST_FILE
        if not path.is_file():
            raise StorageError(f"{self.folder} is not a run of gaitopt (it has no {MANIFEST_FILE}); it was not changed")
        record = parsed(parse_object, read_bytes(path), path)
        if record.get("format") != FORMAT:
            raise StorageError(f"{path} is not the manifest of a gaitopt run; the folder was not changed")
        schema = record.get("schema")
        if isinstance(schema, int) and schema > SCHEMA:
            raise StorageError(
                f"{self.folder} was written by a newer gaitopt (schema {schema}; this one reads up to {SCHEMA}); "
                "it was not changed: update gaitopt to use it"
            )
        if isinstance(schema, int) and schema < SCHEMA:
            raise StorageError(
                f"{self.folder} was written by an older gaitopt, without checksums (schema {schema}); "
                "it was not changed: delete it, or name another folder"
            ).concerning("output")
        checksum = record.pop(CHECKSUM, None)
        if checksum != _checksum(record):
            raise StorageError(f"{path}: altered since it was written (SHA-256 differs); the run was not changed")
        return validated(Manifest, record, path)

    def problem(self) -> Problem:
        """The problem of the run.

        Raises
        ------
        StorageError
            If the resolved values are not those of a problem, or not of the manifest's, or if its walker or control law
            is not installed.
        """
        run = Run(self.folder)
        resolved, path = run.read_object(RESOLVED_FILE), run.path(RESOLVED_FILE)
        text = parsed(str, run.read(PROBLEM_FILE)[0], run.path(PROBLEM_FILE))
        digest = self.manifest().hash
        if digest_of(resolved) != digest:
            raise StorageError(f"{path} does not have the hash of the manifest; the run is damaged")
        try:
            check_installed(resolved)
        except ProblemError as error:
            raise StorageError(f"{self.folder}: {error}") from error
        try:
            problem = replace(restore_problem(resolved), text=text)
        except (GaitoptError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise StorageError(f"{path} contains no problem ({error}); the run is damaged") from error
        if problem.digest != digest:
            raise StorageError(f"{path} does not have the hash of the manifest; the run is damaged")
        return problem

    def holds(self, *names: str) -> bool:
        """Whether files of these names exist and are finished; the folder need not be a run."""
        if not self.path(names[0]).is_file():
            return False
        return {self._key(name) for name in names} <= self.manifest().files.keys()

    def read(self, *names: str) -> list[bytes]:
        """The contents of finished files, all from the same write."""
        keys = [self._key(name) for name in names]
        while True:
            wait_for_writer(self.folder, lambda: self.manifest().files.keys() >= {*keys})
            known = self._checksums(keys)
            missing = next((name for name, stated in zip(names, known, strict=True) if stated is None), None)
            if missing is not None and not written_elsewhere(self.folder):
                unfinished = self.path(missing).exists()
                fault = "the run is unfinished: repeat the command that writes it" if unfinished else "missing"
                raise StorageError(f"{self.path(missing)}: {fault}; it was not changed")
            if missing is not None:
                continue
            try:
                contents = [read_bytes(self.path(name)) for name in names]
                for name, stated, content in zip(names, known, contents, strict=True):
                    check_content(self.path(name), content, stated)
            except StorageError:
                if known == self._checksums(keys):  # no writer has replaced them in the meantime
                    raise
            else:
                if known == self._checksums(keys):
                    return contents

    def _is_finished(self, name: str, content: str, manifest: Manifest) -> bool:
        """Whether a file is finished and has this content."""
        path, known, expected = self.path(name), manifest.files.get(self._key(name)), content.encode()
        return (
            known is not None and known == file_sum(path, expected) and path.is_file() and read_bytes(path) == expected
        )

    def _checksums(self, keys: list[str]) -> list[Any]:
        """Checksums of files in the manifest, None for a file that is not listed."""
        files = self.manifest().files
        return [files.get(key) for key in keys]

    def read_object(self, name: str) -> dict[str, Any]:
        """A finished file that is one JSON object."""
        return parsed(parse_object, self.read(name)[0], self.path(name))

    def read_record(self, name: str, model: type[Model], *, states: Sequence[str] | None = None) -> Model:
        """A finished file that is one JSON object of a type of ``gait.records``; see ``validated``."""
        return validated(model, self.read_object(name), self.path(name), states=states)

    def read_result(self, files: tuple[str, str] = GAIT_FILES) -> tuple[dict[str, Any], Table]:
        """Record and table of the gait, or of the walk."""
        manifest = self.manifest()
        wait_for_writer(self.folder, lambda: self.path(files[0]).is_file())
        if files == GAIT_FILES and not self.path(GAIT_FILE).is_file():
            raise StorageError(
                f"{self.folder} is unfinished (no {GAIT_FILE}): solve {manifest.problem} again to complete it"
            )
        record, table = self.read(*files)
        return parsed(parse_object, record, self.path(files[0])), parsed(parse_csv, table, self.path(files[1]))

    def lines(self, name: str) -> list[dict[str, Any]]:
        """The records of a file in order, all from the same write; none if there is no such file."""
        while True:
            (known,) = self._checksums([self._key(name)])
            try:
                return list(read_lines(self.path(name), known)) if known or self.path(name).exists() else []
            except StorageError:
                if [known] == self._checksums([self._key(name)]):  # no writer has replaced it in the meantime
                    raise
