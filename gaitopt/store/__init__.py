"""Runs on disk: files that appear whole or not at all, and lines that survive being cut off.

What cannot be written, is missing, unfinished or not as it was written raises a ``StorageError`` that names the place;
what was there before is unchanged. Functions state it only where they decide it.
"""

from gaitopt.store.branch import BRANCH_FILE
from gaitopt.store.files import write_whole
from gaitopt.store.folder import adding, check_folder, check_writable, growing, stored_lines, writing
from gaitopt.store.manifest import read_sealed, write_files
from gaitopt.store.run import (
    GAIT_FILE,
    WALK_FILE,
    begin_run,
    find_run,
    is_complete,
    read_object,
    read_problem,
    run_folder,
)
from gaitopt.store.text import Table, json_file, json_text

__all__ = [
    "BRANCH_FILE",
    "GAIT_FILE",
    "WALK_FILE",
    "Table",
    "adding",
    "begin_run",
    "check_folder",
    "check_writable",
    "find_run",
    "growing",
    "is_complete",
    "json_file",
    "json_text",
    "read_object",
    "read_problem",
    "read_sealed",
    "run_folder",
    "stored_lines",
    "write_files",
    "write_whole",
    "writing",
]
