"""The forward hybrid simulator, which finds the contact modes itself, on scipy or heyoka.

events            when a margin counts as fallen, and where; one set of rules for all engines
natural           the hybrid system in natural units
engine            what an engine is: arcs from event to event; the choice of an engine
scipy_stepper     Runge-Kutta steps
heyoka_stepper    Taylor series (needs heyoka)
heyoka_code       functions of CasADi compiled by heyoka (needs heyoka)
contact_forces    forces and impulses in all modes at once
clear_cases       decisions about a lone foot that no rounding changes, for one state or many
contact_resolver  what the contacts do at rest and after an impact
ground            the parameters of a walker on tiles, step by step
simulator         the hybrid loop: steps and walks
outcomes          outcomes of steps, as records and as arrays
heyoka_batch      steps of many states at once (needs heyoka)
"""
