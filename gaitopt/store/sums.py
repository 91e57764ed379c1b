"""Checksums of files: SHA-256 of the whole, and a short code of every line, which locates a change.

code(line) = the last 16 bits of its CRC-32
"""

import hashlib
import zlib
from dataclasses import dataclass
from pathlib import Path

from gaitopt.errors import StorageError

TEXTS = (".csv", ".json", ".yaml")
"""Files of lines that are written whole."""
GROWING = ".jsonl"
"""Files of lines that grow; each line has a checksum of its own."""
CODE = 4
"""Hexadecimal digits of the code of a line."""
MOST_CODES = 20_000
"""Lines that have a code: beyond that the manifest would be larger than its worth."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FileSum:
    """What is known of a file.

    Attributes
    ----------
    sha256 : of its first ``size`` bytes; only a file of records may have more of them.
    lines : number of its lines; 0 where it is no text.
    codes : of its lines, one after the other.
    """

    sha256: str
    size: int
    lines: int
    codes: str


def file_sum(path: Path, content: bytes) -> FileSum:
    """The checksum of a file that holds ``content``."""
    lines = content.splitlines(keepends=True) if path.suffix in (*TEXTS, GROWING) else []
    codes = "".join(map(_code, lines[:MOST_CODES])) if path.suffix in TEXTS else ""
    return FileSum(sha256=hashlib.sha256(content).hexdigest(), size=len(content), lines=len(lines), codes=codes)


def check_content(path: Path, content: bytes, known: FileSum) -> None:
    """Refuse a file that is not the one that was written."""
    if hashlib.sha256(content).hexdigest() != known.sha256:
        line = _first_difference(content, known)
        place = f"{path}:{line}" if line else f"{path}"
        raise StorageError(f"{place}: altered since it was written (SHA-256 differs); the run was left alone")


def _first_difference(content: bytes, known: FileSum) -> int | None:
    """Number of the first line with another code, where lines have codes."""
    codes = [_code(line) for line in content.splitlines(keepends=True)]
    written = [known.codes[k : k + CODE] for k in range(0, len(known.codes), CODE)]
    pairs = zip(codes, written, strict=False)
    differing = next((number for number, (a, b) in enumerate(pairs, start=1) if a != b), None)
    return differing or (min(len(codes), len(written)) + 1 if written else None)


def _code(line: bytes) -> str:
    return f"{zlib.crc32(line):08x}"[-CODE:]
