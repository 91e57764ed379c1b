"""Run folders on the disk. A file that is missing, altered or cannot be written is a ``StorageError`` with its place.

- ``formats``: JSON, CSV and typed records as text, and checksums
- ``files``: whole files that appear whole or not at all; files of records that grow line by line and survive a kill
- ``lock``: one writer at a time
- ``run``: the run folder as one object: problem, manifest, files, lines
- ``gaits``: gaits, branch points and special points from their records
- ``branch``: a stored branch as far as it got, from which its continuation goes on
"""
