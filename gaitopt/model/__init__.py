"""Walkers, contact modes, friction, impacts, control laws, and the hybrid system compiled from them."""
