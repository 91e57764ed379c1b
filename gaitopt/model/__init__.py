"""Walkers, the hybrid automaton, friction, impacts and control laws, and the hybrid system compiled from them.

mechanism     bodies, links, contacts and the mechanism that they form
foreign       code of other packages: calls of its methods, checks of their results
links         a walker as a tree of links
closure       the posture just after an impact, solved for
walker        the definition of a walker: parameters, mechanism, class attributes
declaration   checks of a walker's class and of its mechanism
checks        consistency of a walker where its feet swap roles
registry      walkers and control laws by name, from this package and from plugins
units         natural units, ranges of numbers, types of parameters
modes         states of the foot, the joint stops and the switches
cycle         mode sequences of a step and of a cycle
friction      coefficients of friction, and the tangential law of impacts
transitions   the table of modes: margins, events, resets and next modes
control       the definition of a control law: parameters, torques; laws without a reference
instant       what a law reads at one instant, in symbols
curve         reference curves: piecewise polynomials in time or in a phase variable
reference     what a problem file says about a reference, read as a curve
tracking      PD control
clocked       laws with a clock of their own
controlled_symmetry  torques that act like another slope
open_loop     torques as functions of time
virtual_constraints  outputs that follow curves over a phase variable
contract      checks of a law's class, and of the torques that it gives
lagrangian    equations of motion
section       the section of a gait: what is free where a cycle ends
contacts      motion with a sticking, slipping or lifted foot; impacts
expressions   a walker, its law and the ground in symbols
system        these expressions as compiled CasADi functions
dynamics      the compiled system at fixed parameters, as numbers
buffered      calls of CasADi functions without overhead
urdf          robots in URDF files as walkers
walkers       the walkers that come with gaitopt
"""
