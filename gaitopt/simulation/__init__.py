"""The forward hybrid simulator, which finds the contact modes itself, on scipy or heyoka.

events            when a margin counts as fallen, and where; one set of rules for all engines
natural           the hybrid system in natural units
engine            what an engine is: arcs from event to event; the choice of an engine
scipy_stepper     Runge-Kutta steps
heyoka_stepper    Taylor series (needs heyoka)
heyoka_code       functions of CasADi compiled by heyoka (needs heyoka)
contact_resolver  what the foot does at rest and after an impact
simulator         the hybrid loop: steps and walks
outcomes          outcomes of steps, as records and as arrays
heyoka_batch      steps of many states at once (needs heyoka)
"""
