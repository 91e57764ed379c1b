"""Run folders on the disk. A file that is missing, altered or cannot be written is a ``StorageError`` with its place.

- ``files``: whole files, JSON and CSV, typed records, checksums, the lock of the writer
- ``lines``: files of records that grow line by line and survive a kill
- ``run``: the run folder as one object: problem, manifest, files, lines
- ``gaits``: gaits, branch points and special points from their records
"""
