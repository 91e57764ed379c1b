"""The Runge-Kutta method of order 8 that all here step with: its coefficients, and steps of controlled size."""
