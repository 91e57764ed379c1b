"""Proofs: a gait, its mode sequence and its multipliers in rigorous bounds, by ball arithmetic (python-flint)."""

from gaitopt.errors import UnknownNameError

try:
    import flint  # noqa: F401 - an extra of the package
except ModuleNotFoundError as error:
    raise UnknownNameError("proofs need python-flint; install it with: pip install 'gaitopt[proof]'") from error
