"""Proofs: a gait, its mode sequence and its multipliers in rigorous bounds, by ball arithmetic (python-flint).

``docs/proof.md`` states the theorem; the modules follow it.

- ``arithmetic``: balls, numbers that depend on a parameter, CasADi's expressions in both
- ``taylor``: validated steps of an ordinary differential equation
- ``orbit``: the equations of a periodic orbit, Krawczyk's test, the return map and its eigenvalues
- ``claims``: what makes an orbit a gait with a given mode sequence
- ``certificate``: the file format, and the statement that is rebuilt from a certificate
- ``theorem``: what all boxes of a certificate prove together
- ``check``: the checker
- ``prove``: the prover, which searches for boxes

A theorem relies on the modules above ``prove``, on the model's equations (``gaitopt.model``), the reading of problems
(``gaitopt.problem``), CasADi's derivatives and simplification, and Arb's arithmetic. Nothing in ``prove``, no gait in
doubles, no approximate inverse and no approximate eigenvector has to be right.
"""

from gaitopt.errors import UnknownNameError

try:
    import flint  # noqa: F401 - an extra of the package
except ModuleNotFoundError as error:
    raise UnknownNameError("proofs need python-flint; install it with: pip install 'gaitopt[proof]'") from error
