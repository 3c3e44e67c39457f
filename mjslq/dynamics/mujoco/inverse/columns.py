"""Columns of the tables of parameters that the plan writes and the kernel of the inverse Jacobians reads."""

GAIN, BIAS, TIME_CONSTANT, CTRL_RANGE, FORCE_RANGE, ACT_RANGE, ACTUATOR_NUMBERS = 0, 3, 6, 7, 9, 11, 13
"""Columns of act_prm."""
LENGTH_RANGE, MUSCLE_GAIN, MUSCLE_BIAS, MUSCLE_TIMES, MUSCLE_NUMBERS = 0, 2, 11, 20, 23
"""Columns of act_muscle; gain and bias each: range (2), peak force, scale, lmin, lmax, vmax, fpmax, fvmax."""
FLUID_SHADOW, FLUID_MASS, FLUID_INERTIA, FLUID_ANGULAR, FLUID_REST, FLUID_NUMBERS = 0, 3, 6, 9, 12, 19
"""Columns of fluid_prm for ellipsoids; boxes have six linear and six quadratic coefficients."""
BAND, STIFFNESS, DAMPING, ARMATURE, TENDON_NUMBERS = 0, 2, 5, 8, 9
"""Columns of ten_prm."""
OTHER, PLANE, MESH, SPHERE, CAPSULE, BOX = range(6)
"""Kinds of geoms: a static plane, shapes that contacts have closed forms for, any other."""
(
    BY_DIFFERENCES, JOINT_POS, JOINT_VEL, TENDON_POS, TENDON_VEL, ACTUATOR_POS, ACTUATOR_VEL, ACTUATOR_FORCE,
    JOINT_FORCE, BALL_QUAT, BALL_VEL, FRAME_POS, FRAME_QUAT, FRAME_AXIS, FRAME_VEL, FRAME_TURN, LOCAL_VEL, LOCAL_TURN,
    SUBTREE_COM, SUBTREE_VEL, SUBTREE_TURN,
) = range(21)  # fmt: skip
"""Kinds of sensors, by the formula of their derivative."""
FRAME_NUMBERS = 14
"""Columns of sen_prm: place (3) and orientation (4) of the object in its body, the same of the reference."""
FORCE_NUMBERS = 8
"""Columns of act_force, which `forces` fills: force, its slopes by length, velocity, u and act, and changes of those."""
