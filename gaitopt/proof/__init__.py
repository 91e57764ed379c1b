"""Proofs: a gait, its mode sequence and its multipliers in rigorous bounds, by ball arithmetic (python-flint)."""

from gaitopt.errors import UnknownNameError

try:
    import flint  # noqa: F401 - an extra of the package
except ModuleNotFoundError as error:
    raise UnknownNameError("proofs need python-flint; install it with: pip install 'gaitopt[proof]'") from error

from gaitopt.proof.check import check as check
from gaitopt.proof.prove import prove as prove
from gaitopt.proof.prove import prove_special as prove_special
from gaitopt.proof.theorem import Proof as Proof
