"""Proofs: a gait, its mode sequence and its multipliers in rigorous bounds, by ball arithmetic (python-flint)."""

from gaitopt.proof.check import Proof, check
from gaitopt.proof.prove import make_certificate, prove

__all__ = ["Proof", "check", "make_certificate", "prove"]
