"""Second derivatives of the step, contracted with costates, at about the price of its Jacobians.

multipliers     the equations: from costates to the multipliers of the step's equations of motion
kernel          the loop over knots
rigid           second derivatives of the rigid bodies' inverse dynamics
laws            those of springs, dampers, tendons, actuators
readings        those of sensors
hessians        the engine's side: from the kernel's blocks to the Hessians
cover           which models are covered
"""
