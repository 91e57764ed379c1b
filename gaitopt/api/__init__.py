"""The public functions, each once; the command line prints what they return.

- ``verbs``: what is computed about the gaits of one problem, from ``solve`` to ``replay``.
- ``families``: what is computed about many gaits or walks, from ``continuation`` to ``multistart``; ``run_parallel``.
- ``stored``: results saved in a run folder, and loaded again, whole or in part.
- ``pictures``: figures, animations and pages of results.
- ``progress``: progress bars, and the types of the argument ``progress``.
"""
