"""Long work whose results are stored in a run folder, and results read back from it.

Finished work is stored; the same call resumes. Every function raises a ``StorageError`` if the folder cannot be used,
and ``KeyboardInterrupt`` when ``should_stop`` returns True.

- ``results``: the kinds of results in a run folder, with their readers; gaits and walks
- ``jobs``: ``Plan``, the common form of all work that consists of jobs, and its file of results; the job that solves a
  problem; the search of ``find``
- ``grid``: axes and grids, and whether they fit on the machine
- ``sweep``, ``front``, ``multistart``: plans of problems on grids, in chains and from random starts
- ``basin``: plan of states walked until they settle
- ``robustness``: plan of the limits and statistics that describe how robust a gait is
- ``attractors``: plan of long walks at many values of a parameter
- ``lines``: ``LinesPlan`` and ``CurveFile``, the common form of curves whose points are stored line by line
- ``branch``, ``trace``: curves of gaits over one parameter, and of special points over two
- ``atlas``: plan of branches and traced curves over two parameters, arranged into regions
"""
