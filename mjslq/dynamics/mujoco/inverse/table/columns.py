"""Columns of the tables of parameters that the plan writes and the kernel of the inverse Jacobians reads."""

GAIN, BIAS, TIME_CONSTANT, CTRL_RANGE, FORCE_RANGE, ACT_RANGE, ACTUATOR_NUMBERS = 0, 3, 6, 7, 9, 11, 13
"""Columns of act_prm."""
LENGTH_RANGE, MUSCLE_GAIN, MUSCLE_BIAS, MUSCLE_TIMES, MUSCLE_NUMBERS = 0, 2, 11, 20, 23
"""Columns of act_muscle; gain and bias each: range (2), peak force, scale, lmin, lmax, vmax, fpmax, fvmax."""
FLUID_SHADOW, FLUID_MASS, FLUID_INERTIA, FLUID_ANGULAR, FLUID_REST, FLUID_NUMBERS = 0, 3, 6, 9, 12, 19
"""Columns of fluid_prm for ellipsoids; boxes have six linear and six quadratic coefficients."""
BAND, STIFFNESS, DAMPING, ARMATURE, TENDON_NUMBERS = 0, 2, 5, 8, 9
"""Columns of ten_prm."""
OTHER, PLANE, MESH, SPHERE, CAPSULE, BOX, ELLIPSOID, CYLINDER, FIELD = range(9)
"""Kinds of geoms: shapes that some contacts have closed forms for, signed distance fields, any other."""
UNKNOWN, BY_LENGTHS, CONNECT, WELD = range(4)
"""Kinds of equality constraints: of joints' positions or fixed tendons' lengths, of bodies, any other."""
TIE_NUMBERS = 15
"""Columns of tie_prm: place (3) and orientation (4) of the first object in its body, of the second, torquescale."""
(
    BY_DIFFERENCES, CONSTANT, JOINT_POS, JOINT_VEL, TENDON_POS, TENDON_VEL, ACTUATOR_POS, ACTUATOR_VEL, ACTUATOR_FORCE,
    JOINT_FORCE, TENDON_FORCE, KINETIC_ENERGY, BALL_QUAT, BALL_VEL, FRAME_POS, FRAME_QUAT, FRAME_AXIS, FRAME_VEL,
    FRAME_TURN, LOCAL_VEL, LOCAL_TURN, LOCAL_FIELD, SUBTREE_COM, SUBTREE_VEL, SUBTREE_TURN, RANGE, FRAME_ACC,
    FRAME_SPIN, LOCAL_ACC, LIMIT_POS, LIMIT_VEL, LIMIT_FORCE, FORCE, TORQUE, TOUCH, CONTACT,
) = range(36)  # fmt: skip
"""Kinds of sensors, by the formula of their derivative."""
FRAME_NUMBERS = 14
"""Columns of sen_prm: place (3) and orientation (4) of the object in its body, the same of the reference."""
FORCE_NUMBERS = 8
"""Columns of act_force: force, its slopes by length, velocity, u and act, and the changes of the first two."""
ANY, GEOM, BODY, SUBTREE, INSIDE = range(5)
"""What a contact sensor may ask of a contact's side."""
FOUND, CONTACT_FORCE, CONTACT_TORQUE, DISTANCE, POINT, NORMAL, TANGENT, CONTACT_VEL, CONTACT_TURN, FIELDS = range(10)
"""Fields of a contact sensor's slots, in their order; the bits of its specification."""
IN_ORDER, NEAREST, STRONGEST, NET_FORCE = range(4)
"""How a contact sensor chooses among contacts, mjtContactReduce's numbers."""
FLAT, CLOSED, DIFFERENCED, OPEN = range(4)
"""What serves a sensor's second derivatives: nothing, a closed form, differences in position alone, of the whole."""
