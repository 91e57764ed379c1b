"""Run folders on the disk. A file that is missing, altered or not writable raises a ``StorageError`` that names it.

- ``formats``: JSON, CSV and typed records as text, and checksums
- ``files``: files that appear whole or not at all; files of records that grow line by line and survive a kill
- ``lock``: the lock that lets one process at a time write a folder
- ``run``: the run folder as one object: problem, manifest, files, lines
- ``gaits``: gaits, branch points and special points from their records
- ``branch``: an unfinished branch, or trace in two parameters, read back so that it can be resumed
"""
