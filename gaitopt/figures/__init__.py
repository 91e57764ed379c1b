"""Figures and animations: functions from gaits and branches to matplotlib figures and to a moving walker."""
