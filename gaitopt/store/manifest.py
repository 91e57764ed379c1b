"""What a run folder says about itself: format, schema, versions, platform, the hash of its problem, and of every file.

A file is written in three steps: its checksum leaves the manifest, it is replaced, its new checksum enters. A file that
has none there is therefore unfinished.
"""

import hashlib
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

from gaitopt.errors import StorageError
from gaitopt.store.files import parsed, read_bytes, write_whole
from gaitopt.store.lock import wait_for_writer, written_elsewhere
from gaitopt.store.records import validated
from gaitopt.store.sums import FileSum, check_content, file_sum
from gaitopt.store.text import json_file, json_text, parse_object

MANIFEST_FILE = "manifest.json"
FORMAT = "gaitopt run"
SCHEMA = 2
"""Raised whenever a reader of the previous schema would misread what is written; 2 has checksums."""
CHECKSUM = "checksum"
"""Key of the SHA-256 of the rest of the manifest."""
PACKAGES = ("gaitopt", "casadi", "numpy", "scipy", "pydantic", "ruamel.yaml")
"""Packages on which the numbers of a run depend."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Manifest:
    """The contents of ``manifest.json``; ``hash`` is that of the resolved problem with its references.

    ``files`` has the checksums of finished files by their paths within the folder.
    """

    problem: str
    hash: str
    versions: dict[str, str]
    platform: dict[str, str]
    files: dict[str, FileSum] = field(default_factory=dict)
    format: str = FORMAT
    schema: int = SCHEMA

    def to_record(self) -> dict[str, Any]:
        """The manifest as a JSON object, with its own checksum."""
        record = asdict(self)
        return record | {CHECKSUM: _checksum(record)}


def new_manifest(problem: str, digest: str) -> Manifest:
    """State who writes a run of the problem named ``problem`` now; the host is not named."""
    return Manifest(
        problem=problem,
        hash=digest,
        versions=dict(_versions()),
        platform={"system": platform.system(), "machine": platform.machine()},
    )


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write the manifest of a run folder."""
    write_whole(folder / MANIFEST_FILE, json_file(manifest.to_record()))


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a run folder.

    Raises
    ------
    StorageError
        If the folder is not a run, is broken, or was written by a newer gaitopt or by one without checksums.
    """
    path = folder / MANIFEST_FILE
    if not path.is_file():
        raise StorageError(f"{folder} is not a run of gaitopt (it has no {MANIFEST_FILE}); it was left alone")
    record = parsed(parse_object, read_bytes(path), path)
    if record.get("format") != FORMAT:
        raise StorageError(f"{path} is not the manifest of a gaitopt run; the folder was left alone")
    schema = record.get("schema")
    if isinstance(schema, int) and schema > SCHEMA:
        raise StorageError(
            f"{folder} was written by a newer gaitopt (schema {schema}; this one reads up to {SCHEMA}); "
            "it was left alone: update gaitopt to use it"
        )
    if isinstance(schema, int) and schema < SCHEMA:
        raise StorageError(
            f"{folder} was written by an older gaitopt, without checksums (schema {schema}); "
            "it was left alone: delete it, or name another folder"
        ).about("output")
    checksum = record.pop(CHECKSUM, None)
    if checksum != _checksum(record):
        raise StorageError(f"{path}: altered since it was written (SHA-256 differs); the run was left alone")
    return validated(Manifest, record, path)


def write_files(folder: Path, contents: Mapping[str, str]) -> None:
    """Write files of a run folder by their paths within it; they count as unfinished until all of them are written."""
    manifest = read_manifest(folder)
    kept = {name: known for name, known in manifest.files.items() if name not in contents}
    if kept != manifest.files:
        write_manifest(folder, replace(manifest, files=kept))
    for name, content in contents.items():
        write_whole(folder / name, content)
    seal(folder, *contents)


def seal(folder: Path, *names: str) -> None:
    """Enter the checksums of files, as they are now, into the manifest."""
    manifest = read_manifest(folder)
    sums = {name: file_sum(folder / name, read_bytes(folder / name)) for name in names}
    if not sums.items() <= manifest.files.items():
        write_manifest(folder, replace(manifest, files=dict(sorted((manifest.files | sums).items()))))


def read_sealed(folder: Path, name: str) -> bytes:
    """Read a file of a run folder that is as it was written; errors as of ``read_together``."""
    (content,) = read_together(folder, name)
    return content


def read_together(folder: Path, *names: str) -> list[bytes]:
    """Read files of a run folder that are as they were written, all by the same writer.

    Where another process is about to finish one of them, it is waited for.

    Raises
    ------
    StorageError
        If a file is missing, unfinished or altered.
    """
    while True:
        wait_for_writer(folder, lambda: read_manifest(folder).files.keys() >= {*names})
        known = _known(folder, names)
        missing = next((name for name in names if known[name] is None), None)
        if missing is not None and not written_elsewhere(folder):
            there = (folder / missing).exists()
            words = "the run is unfinished: repeat the command that writes it" if there else "missing"
            raise StorageError(f"{folder / missing}: {words}; it was left alone")
        if missing is not None:
            continue
        try:
            contents = [read_bytes(folder / name) for name in names]
            for (name, own), content in zip(known.items(), contents, strict=True):
                check_content(folder / name, content, own)
        except StorageError:
            if known == _known(folder, names):  # no writer has replaced them meanwhile
                raise
        else:
            if known == _known(folder, names):
                return contents


def _known(folder: Path, names: tuple[str, ...]) -> dict[str, Any]:
    """What the manifest says of some files, None where it says nothing."""
    files = read_manifest(folder).files
    return {name: files.get(name) for name in names}


def _checksum(record: dict[str, Any]) -> str:
    return hashlib.sha256(json_text(record).encode()).hexdigest()


@lru_cache(maxsize=1)
def _versions() -> tuple[tuple[str, str], ...]:
    return (("python", platform.python_version()), *((name, version(name)) for name in PACKAGES))
