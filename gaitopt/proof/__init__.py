"""Proofs: a gait, its mode sequence and its multipliers in rigorous bounds, by ball arithmetic (python-flint).

docs/developer/theorem.md states the theorem and names the function that checks each of its lines.

- ``arithmetic``: balls, numbers that depend on a parameter, CasADi's expressions in both
- ``taylor``: validated steps of an ordinary differential equation
- ``law``: breakpoints and segment data of a control law in balls, from the decimals of its problem
- ``orbit``: the equations of a periodic orbit, Krawczyk's test, the return map and its eigenvalues
- ``claims``: the claims that make an orbit a gait with its mode sequence; bounds of its measures
- ``certificate``: the file format
- ``identities``: exact zeros, and constraints that depend on others
- ``statement``: the hypotheses of a theorem, derived from the texts of a certificate; its boxes
- ``law_data``: the claim that data of a control law fit a proved gait
- ``check``: the checker, and what the boxes of a certificate prove together
- ``prove``: the prover, which searches for boxes

A theorem relies on all modules but ``prove``, on the model's equations (``gaitopt.model``), the reading of problems
(``gaitopt.problem``), CasADi's derivatives, and the arithmetic of Arb and FLINT. Nothing in ``prove``, no gait in
doubles, no approximate inverse and no approximate eigenvector has to be right.
"""

from gaitopt.errors import UnknownNameError

try:
    import flint  # noqa: F401 - an extra of the package
except ModuleNotFoundError as error:
    raise UnknownNameError("proofs need python-flint; install it with: pip install 'gaitopt[proof]'") from error
