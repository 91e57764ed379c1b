"""The walkers that come with gaitopt, one class each.

- ``rimless_wheel``: a rigid star of spokes.
- ``compass_biped``: two straight legs joined at the hip.
- ``push_off``: the compass with an impulsive push-off.
- ``unequal_compass``: the compass with legs that differ.
- ``round_feet``: the compass on arc feet.
- ``torso``: the compass with a torso.
- ``rabbit``: a torso on two legs with knees, which is declared by its links only.
- ``kneed``: the compass with a knee that locks.
- ``telescopic``: the compass with a swing leg that a spring shortens.
- ``slip_runner``: the spring-loaded inverted pendulum.
- ``slip_runner_foot``: the spring-loaded inverted pendulum with an unsprung foot that may slide.
- ``hopper``: a body on a springy leg, driven by a thrust.

Walkers with several contacts:

- ``flat_foot``: the compass on feet with mass and springy ankles, which stay flat for a while.
- ``heel_toe``: the compass on flat feet, which rolls over heel and toe.
- ``slip_walker``: a point mass that walks on the legs of slip_runner.
- ``bounder``: a trunk that bounds on two springy legs.
- ``crawler``: two masses on a line, with a motor between them.
- ``inchworm``: two links with a hinge, both ends on the ground.
"""
