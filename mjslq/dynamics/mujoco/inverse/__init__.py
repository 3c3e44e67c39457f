"""Jacobians of the MuJoCo step through its inverse dynamics: no constraint solver runs, and little is differenced.

acceleration        the equations: derivatives of the step's acceleration at a knot
kernel              the loop over knots: rows of A, B, C, D
rigid               the rigid bodies' inverse dynamics and their derivatives
spatial, algebra    spatial vectors, small dense matrices
cover               which models are covered, and which way a model is linearized
jacobians           the engine's side

forces/             smooth forces
    laws, muscles           springs, dampers, actuators
    arms                    tendons and actuators whose moment arms move
    fluid                   drag, lift, added mass
    unmodelled_forces, differences    forces without a closed form, and their differences

rows/               constraint rows
    constraints, equalities  limits, friction, equality constraints
    contacts, wrenches       forces of a contact, and what they do to the dofs
    geometry, pairs          how contacts move: in closed form, or by differences in the relative pose of two geoms
    differences              the few rows left, by differences of positions
    metric, impedance, weights    what the discrete integrator does to the inertia and to the rows

readings/           sensors
    motions, frames     of positions, velocities, forces of actuators
    accelerations, limits    of accelerations, of limits
    pressures, contact_sensors    of what contacts exert, and of contacts themselves
    rays                of rangefinders
    stages, outputs     by differences of their own stage; which sensor is served how

curvature/          second derivatives, contracted with costates

table/              what the kernel is told about a model
    plan, actuator_plan, arm_plan, fluid_plan    from the model to arrays
    job, columns, layout          records and columns; where MuJoCo keeps what
"""
