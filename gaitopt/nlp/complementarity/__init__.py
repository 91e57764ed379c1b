"""Gaits with open modes: friction as complementarity constraints, solved by a homotopy."""
