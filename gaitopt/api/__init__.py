"""The public functions, each once; the command line prints what they return.

- ``verbs``: everything that is computed, from ``solve`` to ``multistart``, and ``run_parallel``.
- ``stored``: results saved in a run folder, and loaded again, whole or in part.
- ``pictures``: figures, animations and pages of results.
- ``progress``: progress bars, and the types of the argument ``progress``.
"""
