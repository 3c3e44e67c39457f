"""Jacobians of the MuJoCo step through its inverse dynamics: no constraint solver runs, and little is differenced.

kernel              the equations, and the loop over knots
spatial, algebra    spatial vectors, small dense matrices
rigid               the rigid bodies' inverse dynamics and their derivatives
forces              springs, dampers, actuators
constraints, equalities, contacts, wrenches    constraint rows in closed form
geometry, pairs     how contacts move: in closed form, or by differences in the relative pose of two geoms
differences         the few rows left, by differences of positions
metric, impedance, weights    what the discrete integrator does to the inertia and to the rows
sensors, frames, accelerations, pressures       C and D: what moves with frames, feels accelerations, feels contacts
stages, outputs     sensors by differences of their own stage; which sensor is served how
cover, plan, layout, job, columns    which models are covered; what the kernel is told about one
jacobians           the engine's side
"""
