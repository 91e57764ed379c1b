"""Long work that is kept in a run folder, and results read back from it.

Finished work is kept; the same call resumes. Every function raises a ``StorageError`` if the folder cannot be used, and
``KeyboardInterrupt`` when ``should_stop`` returns True.

- ``results``: the kinds of results in a run folder, with their readers; gaits and walks
- ``jobs``: the mechanism that keeps and resumes jobs; problems solved and verified; the search of ``find``
- ``grid``: axes and grids, and whether they fit on the machine
- ``sweep``, ``front``, ``multistart``: grids, chains and random starts of problems
- ``basin``: states walked until they settle
- ``branch``: a continuation, record by record
"""
