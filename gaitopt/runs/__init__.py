"""Long work that is kept in a run folder: sweeps, fronts, basins, many starts, searches; and runs read back.

Every function raises a ``StorageError`` if the folder cannot be used, and ``KeyboardInterrupt`` when ``should_stop``
returns True; finished parts are kept, and the same call resumes.
"""
