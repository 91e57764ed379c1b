"""Runs on disk: files that appear whole or not at all, and lines that survive being cut off.

What cannot be written, is missing, unfinished or not as it was written raises a ``StorageError`` that names the place;
what was there before is unchanged. Functions state it only where they decide it.
"""

from gaitopt.store.branch import BRANCH_FILE as BRANCH_FILE
from gaitopt.store.files import write_whole as write_whole
from gaitopt.store.folder import adding as adding
from gaitopt.store.folder import check_folder as check_folder
from gaitopt.store.folder import check_writable as check_writable
from gaitopt.store.folder import growing as growing
from gaitopt.store.folder import stored_lines as stored_lines
from gaitopt.store.folder import writing as writing
from gaitopt.store.manifest import read_sealed as read_sealed
from gaitopt.store.manifest import write_files as write_files
from gaitopt.store.run import GAIT_FILE as GAIT_FILE
from gaitopt.store.run import WALK_FILE as WALK_FILE
from gaitopt.store.run import begin_run as begin_run
from gaitopt.store.run import find_run as find_run
from gaitopt.store.run import is_complete as is_complete
from gaitopt.store.run import read_object as read_object
from gaitopt.store.run import read_problem as read_problem
from gaitopt.store.run import run_folder as run_folder
from gaitopt.store.text import Table as Table
from gaitopt.store.text import json_file as json_file
from gaitopt.store.text import json_text as json_text
