"""Runs on disk: files that appear whole or not at all, and lines that survive being cut off.

What cannot be written, is missing, unfinished or not as it was written raises a ``StorageError`` that names the place;
what was there before is unchanged. Functions state it only where they decide it.
"""

from gaitopt.store.branch import BRANCH_FILE, begin_branch, branch_folder, stored_records, write_branch_table
from gaitopt.store.files import write_whole
from gaitopt.store.folder import adding, check_folder, check_writable, growing, stored_lines, writing
from gaitopt.store.lines import LineWriter, read_lines
from gaitopt.store.manifest import Manifest, read_manifest, read_sealed, seal, write_files
from gaitopt.store.run import (
    GAIT_FILE,
    WALK_FILE,
    begin_run,
    find_run,
    is_complete,
    read_object,
    read_problem,
    read_run,
    read_walk,
    run_folder,
    write_run,
    write_walk,
)
from gaitopt.store.text import Table, csv_text, json_file, json_text
from gaitopt.store.tiles import has_tile, read_tile, write_tile

__all__ = [
    "BRANCH_FILE",
    "GAIT_FILE",
    "WALK_FILE",
    "LineWriter",
    "Manifest",
    "Table",
    "adding",
    "begin_branch",
    "begin_run",
    "branch_folder",
    "check_folder",
    "check_writable",
    "csv_text",
    "find_run",
    "growing",
    "has_tile",
    "is_complete",
    "json_file",
    "json_text",
    "read_lines",
    "read_manifest",
    "read_object",
    "read_problem",
    "read_run",
    "read_sealed",
    "read_tile",
    "read_walk",
    "run_folder",
    "seal",
    "stored_lines",
    "stored_records",
    "write_branch_table",
    "write_files",
    "write_run",
    "write_tile",
    "write_walk",
    "write_whole",
    "writing",
]
