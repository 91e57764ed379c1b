"""Control laws: joint torques as functions of time since impact, angles and rates."""
