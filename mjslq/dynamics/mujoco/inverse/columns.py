"""Columns of the tables of parameters that the plan writes and the kernel of the inverse Jacobians reads."""

GAIN, BIAS, TIME_CONSTANT, CTRL_RANGE, FORCE_RANGE, ACT_RANGE, ACTUATOR_NUMBERS = 0, 3, 6, 7, 9, 11, 13
"""Columns of act_prm."""
BAND, STIFFNESS, DAMPING, ARMATURE, TENDON_NUMBERS = 0, 2, 5, 8, 9
"""Columns of ten_prm."""
OTHER, PLANE, MESH, SPHERE, CAPSULE, BOX, ELLIPSOID, CYLINDER, FIELD = range(9)
"""Kinds of geoms: shapes that some contacts have closed forms for, signed distance fields, any other."""
UNKNOWN, BY_LENGTHS, CONNECT, WELD = range(4)
"""Kinds of equality constraints: of joints' positions or fixed tendons' lengths, of bodies, any other."""
TIE_NUMBERS = 15
"""Columns of tie_prm: place (3) and orientation (4) of the first object in its body, of the second, torquescale."""
(
    BY_DIFFERENCES, JOINT_POS, JOINT_VEL, TENDON_POS, TENDON_VEL, ACTUATOR_POS, ACTUATOR_VEL, ACTUATOR_FORCE,
    JOINT_FORCE, BALL_QUAT, BALL_VEL, FRAME_POS, FRAME_QUAT, FRAME_AXIS, FRAME_VEL, FRAME_TURN, LOCAL_VEL, LOCAL_TURN,
    SUBTREE_COM, SUBTREE_VEL, SUBTREE_TURN,
) = range(21)  # fmt: skip
"""Kinds of sensors, by the formula of their derivative."""
FRAME_NUMBERS = 14
"""Columns of sen_prm: place (3) and orientation (4) of the object in its body, the same of the reference."""
