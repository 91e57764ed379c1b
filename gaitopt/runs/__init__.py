"""Long work that is kept in a run folder: sweeps, fronts, basins, many starts, searches; and runs read back.

Every function raises a ``StorageError`` where the folder cannot be used or does not hold what it should, and a
``KeyboardInterrupt`` where ``should_stop`` became true; what is finished is kept, and the same call resumes from there.
"""
