"""The public functions, each once; the command line prints what they return.

- ``verbs``: compute: solve, simulate, find, explain, continuation, prove, sweep, basin, front, multistart.
- ``stored``: save a result in a run folder, and load it again.
- ``pictures``: figures, animations and pages of results.
- ``progress``: progress bars, and the types of the argument ``progress``.
"""
