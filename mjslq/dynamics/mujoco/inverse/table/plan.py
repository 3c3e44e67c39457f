"""What the kernel of the inverse Jacobians has to know about a model.

`plan` turns a model that they cover (`cover`) into the arrays that `job` names, in
the kernel's terms: scalar springs, dof dampers with what actuators add to them, tendons and actuators with constant
moment arms, limits that are infinite where there are none.
"""

from __future__ import annotations

import copy
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from mjslq.dynamics.mujoco.inverse.table import columns
from mjslq.dynamics.mujoco.library import collision_functions


def whole(kind: Any) -> SimpleNamespace:
    """Plain integers in place of an enumeration's members, which numpy does not compare with."""
    return SimpleNamespace(**{name: int(value) for name, value in kind.__members__.items()})


JOINT, TRN, DYN = whole(mujoco.mjtJoint), whole(mujoco.mjtTrn), whole(mujoco.mjtDyn)
GAIN, BIAS, INT = whole(mujoco.mjtGain), whole(mujoco.mjtBias), whole(mujoco.mjtIntegrator)
GEOM, SOLVER = whole(mujoco.mjtGeom), whole(mujoco.mjtSolver)
OFF, ON, WRAP, EQ = (
    whole(mujoco.mjtDisableBit), whole(mujoco.mjtEnableBit), whole(mujoco.mjtWrap), whole(mujoco.mjtEq)
)  # fmt: skip
SCALAR = (int(JOINT.mjJNT_SLIDE), int(JOINT.mjJNT_HINGE))
ON_JOINTS = (int(TRN.mjTRN_JOINT), int(TRN.mjTRN_JOINTINPARENT))
_LARGE = 1e300
Table = dict[str, np.ndarray[Any, Any]]


def implicit_level(model: mujoco.MjModel) -> int:
    """What the integrator takes implicitly: 0 nothing, 1 the joints' damping, 2 all damping, 3 stiffness as well."""
    if model.opt.integrator == INT.mjINT_DISCRETE:
        return 3
    if model.opt.integrator != INT.mjINT_EULER:
        return 2
    damped = not disabled(model, OFF.mjDSBL_EULERDAMP) and bool(dampers(model).any())
    return 1 if damped else 0


def plan(model: mujoco.MjModel) -> Table:
    """Arrays and sizes for the kernel: integers as int64, numbers as float64."""
    table: dict[str, Any] = {
        "nq": model.nq, "nv": model.nv, "na": model.na, "nu": model.nu, "ny": model.nsensordata,
        "columns": 2 * model.nv + model.na + model.nu,
        "nbody": model.nbody, "ngeom": model.ngeom, "nsite": model.nsite, "ntendon": model.ntendon,
        "implicit": implicit_level(model), "h": model.opt.timestep,
        "body_parentid": model.body_parentid, "body_rootid": model.body_rootid, "body_dofadr": model.body_dofadr,
        "body_dofnum": model.body_dofnum, "body_lastdof": _last_dofs(model), "dof_bodyid": model.dof_bodyid,
        "dof_parentid": model.dof_parentid, "dof_qadr": _position_addresses(model),
        "dof_force_range": _force_ranges(model), "dof_damping": dampers(model), "dof_armature": _armature(model),
        "site_bodyid": model.site_bodyid, "body_gravcomp": model.body_gravcomp, "dof_treeid": model.dof_treeid,
        "gravity": np.zeros(3) if disabled(model, OFF.mjDSBL_GRAVITY) else model.opt.gravity,
    }  # fmt: skip
    table["compensated"] = int(is_compensated(model))
    table |= _equalities(model)
    table["constrained"], table["sparse"] = int(can_be_constrained(model)), int(mujoco.mj_isSparse(model))
    table |= _geoms(model)
    table |= _groups(model) | _springs(model) | tendons(model) | _gyroscopic(model)
    table["dof_lone"] = lone_dofs(model)
    return arrays(table)


def is_compensated(model: mujoco.MjModel) -> bool:
    """Whether gravity is compensated; without springs and dampers MuJoCo leaves out all passive forces."""
    passive = not (disabled(model, OFF.mjDSBL_SPRING) and disabled(model, OFF.mjDSBL_DAMPER))
    weighs = not disabled(model, OFF.mjDSBL_GRAVITY) and bool(model.opt.gravity.any())
    return passive and weighs and bool(model.body_gravcomp.any())


def arrays(table: dict[str, Any]) -> Table:
    """Numbers and arrays as the kernel wants them."""
    return {name: _array(value) for name, value in table.items()}


def _array(value: Any) -> np.ndarray[Any, Any]:
    value = np.asarray(value)
    return np.array(value, np.float64 if value.dtype.kind == "f" else np.int64, order="C")


def disabled(model: mujoco.MjModel, flag: Any) -> bool:
    """Whether a part of the simulation is switched off."""
    return bool(model.opt.disableflags & flag)


def _last_dofs(model: mujoco.MjModel) -> Any:
    """Last dof on the way from the world to each body; -1 for bodies that cannot move."""
    last = np.full(model.nbody, -1)
    for b in range(1, model.nbody):
        last[b] = last[model.body_parentid[b]]
        if model.body_dofnum[b]:
            last[b] = model.body_dofadr[b] + model.body_dofnum[b] - 1
    return last


def _position_addresses(model: mujoco.MjModel) -> Any:
    """Where in qpos the position of a hinge's or slide's dof is; of other dofs -2 minus where their quaternion is."""
    joints = model.dof_jntid
    rotation = model.jnt_qposadr + 3 * (model.jnt_type == JOINT.mjJNT_FREE)
    return np.where(np.isin(model.jnt_type[joints], SCALAR), model.jnt_qposadr[joints], -2 - rotation[joints])


def _groups(model: mujoco.MjModel) -> dict[str, Any]:
    """First dof of each dof's group and the one behind its last; first rotational dofs of quaternions."""
    first, end, quaternions = np.arange(model.nv), np.arange(model.nv) + 1, []
    for kind, adr in zip(model.jnt_type, model.jnt_dofadr, strict=True):
        if kind in (JOINT.mjJNT_FREE, JOINT.mjJNT_BALL):
            start = adr + (3 if kind == JOINT.mjJNT_FREE else 0)
            first[start : start + 3], end[start : start + 3] = start, start + 3
            quaternions.append(start)
    return {
        "dof_group": first, "dof_groupend": end,
        "quat_dof": np.array(quaternions, dtype=np.int64), "nquat": len(quaternions),
    }  # fmt: skip


def joint_of(model: mujoco.MjModel, i: int) -> int:
    """Scalar joint that actuator i drives directly, or -1."""
    joint = int(model.actuator_trnid[i, 0])
    return joint if model.actuator_trntype[i] in ON_JOINTS and model.jnt_type[joint] in SCALAR else -1


def dampers(model: mujoco.MjModel) -> Any:
    """Coefficients of the dofs' damping, with what actuators add to their joints. Shape (nv, 3)."""
    if disabled(model, OFF.mjDSBL_DAMPER):
        return np.zeros((model.nv, 3))
    dampers = np.column_stack([model.dof_damping, model.dof_dampingpoly])
    for i in range(model.nactuator):
        if (joint := joint_of(model, i)) >= 0:
            own = np.append(model.actuator_damping[i], model.actuator_dampingpoly[i])
            dampers[model.jnt_dofadr[joint]] += gear_of(model, i)[0] ** 2 * own
    return dampers


def _armature(model: mujoco.MjModel) -> Any:
    armature = np.array(model.dof_armature)
    for i in range(model.nactuator):
        if (joint := joint_of(model, i)) >= 0:
            armature[model.jnt_dofadr[joint]] += gear_of(model, i)[0] ** 2 * model.actuator_armature[i]
    return armature


def gear_of(model: mujoco.MjModel, i: int) -> Any:
    """Gear of actuator i, of its first output if it has several. Shape (6,)."""
    return model.actuator_gear[model.actuator_outadr[i]]


def _force_ranges(model: mujoco.MjModel) -> Any:
    """Limits of the actuators' total force on each dof. Shape (nv, 2)."""
    limited = np.asarray(model.jnt_actfrclimited, bool) & np.isin(model.jnt_type, SCALAR)
    return ranges(limited, model.jnt_actfrcrange)[model.dof_jntid]


def ranges(limited: Any, given: Any) -> Any:
    """Limits as given, as good as infinite where there are none. Shape (n, 2)."""
    return np.where(np.asarray(limited, bool)[:, None], given, [-_LARGE, _LARGE])


_SHAPES = {
    GEOM.mjGEOM_MESH: columns.MESH, GEOM.mjGEOM_BOX: columns.BOX, GEOM.mjGEOM_SPHERE: columns.SPHERE,
    GEOM.mjGEOM_CAPSULE: columns.CAPSULE, GEOM.mjGEOM_ELLIPSOID: columns.ELLIPSOID,
    GEOM.mjGEOM_CYLINDER: columns.CYLINDER, GEOM.mjGEOM_PLANE: columns.PLANE, GEOM.mjGEOM_SDF: columns.FIELD,
}  # fmt: skip


def _geoms(model: mujoco.MjModel) -> dict[str, Any]:
    """Kinds of geoms as `contacts` tells them apart, their sizes, and what the narrow phase wants to know."""
    return {
        "geom_kind": np.array([_SHAPES.get(int(t), columns.OTHER) for t in model.geom_type], np.int64),
        "geom_type": model.geom_type, "geom_size": model.geom_size, "geom_bodyid": model.geom_bodyid,
        "geom_gap": model.geom_gap, "npair": model.npair, "pair_gap": model.pair_gap,
        "pair_geoms": np.column_stack([model.pair_geom1, model.pair_geom2]),
        "geom_types": GEOM.mjGEOM_SDF + 1, "collision_functions": collision_functions(),
    }  # fmt: skip


def _equalities(model: mujoco.MjModel) -> dict[str, Any]:
    """Equality constraints: their kinds; the second length with polynomial and rest; bodies and places in them."""
    kind = np.zeros(model.neq, np.int64)
    paths, rest, bodies = [], np.zeros(model.neq), np.zeros((model.neq, 2), np.int64)
    places = np.zeros((model.neq, columns.TIE_NUMBERS))
    for e, (what, *objects) in enumerate(zip(model.eq_type, model.eq_obj1id, model.eq_obj2id, strict=True)):
        path = _no_path()
        if what in (EQ.mjEQ_CONNECT, EQ.mjEQ_WELD):
            kind[e] = columns.WELD if what == EQ.mjEQ_WELD else columns.CONNECT
            bodies[e], places[e] = _places(model, e)
        elif what == EQ.mjEQ_JOINT:
            kind[e] = columns.BY_LENGTHS
            if objects[1] >= 0:
                path = model.jnt_dofadr[objects[1:]], np.ones(1)
                rest[e] = model.qpos0[model.jnt_qposadr[objects[1]]]
        elif what == EQ.mjEQ_TENDON and all(len(tendon_dofs(model, t)[0]) for t in objects if t >= 0):
            kind[e] = columns.BY_LENGTHS
            if objects[1] >= 0:
                path, rest[e] = tendon_dofs(model, objects[1]), model.tendon_length0[objects[1]]
        paths.append(path)
    tied = np.isin(kind, [columns.CONNECT, columns.WELD])
    if implicit_level(model) == 3:  # whose references fold dJ/dt v differently
        kind[tied] = columns.UNKNOWN
    return {
        "neq": model.neq, "bodies_tied": int(tied.any()), "eq_kind": kind, "eq_body": bodies, "tie_prm": places,
        "eq_prm": np.column_stack([model.eq_data[:, :5], rest]),
    } | lists("eq", paths)  # fmt: skip


def tied_bodies(model: mujoco.MjModel, e: int) -> Any:
    """Bodies that a connect or weld constraint holds on to."""
    return _places(model, e)[0]


def _places(model: mujoco.MjModel, e: int) -> tuple[Any, Any]:
    """Bodies that a connect or weld constraint holds on to, and its columns of tie_prm."""
    objects, data = [model.eq_obj1id[e], model.eq_obj2id[e]], model.eq_data[e]
    here = np.array([1.0, 0.0, 0.0, 0.0])
    if model.eq_objtype[e] == int(mujoco.mjtObj.mjOBJ_SITE):
        places = [np.append(model.site_pos[s], model.site_quat[s]) for s in objects]
        return model.site_bodyid[objects], np.concatenate([*places, data[10:11]])
    if model.eq_type[e] == EQ.mjEQ_WELD:
        return objects, np.concatenate([data[3:6], data[6:10], data[:3], here, data[10:11]])
    return objects, np.concatenate([data[:3], here, data[3:6], here, [0.0]])


def can_be_constrained(model: mujoco.MjModel) -> bool:
    """Whether the model can have any constraint row."""
    if disabled(model, OFF.mjDSBL_CONSTRAINT):
        return False
    limits = (model.jnt_limited.any() or model.tendon_limited.any()) and not disabled(model, OFF.mjDSBL_LIMIT)
    friction = model.dof_frictionloss.any() or model.tendon_frictionloss.any()
    friction = friction and not disabled(model, OFF.mjDSBL_FRICTIONLOSS)
    equality = model.neq > 0 and not disabled(model, OFF.mjDSBL_EQUALITY)
    return bool(limits or friction or equality or has_contacts(model))


def has_contacts(model: mujoco.MjModel) -> bool:
    """Whether any pair of geoms could touch, as far as bit masks tell."""
    if disabled(model, OFF.mjDSBL_CONTACT) or disabled(model, OFF.mjDSBL_CONSTRAINT):
        return False
    kinds, affinities = set(model.geom_contype.tolist()), set(model.geom_conaffinity.tolist())
    return model.npair > 0 or model.nflex > 0 or any(t & a for t in kinds for a in affinities)


def can_rub(model: mujoco.MjModel) -> bool:
    """Whether the model can have dry friction: of joints, of tendons, or of contacts in more than one dimension."""
    if disabled(model, OFF.mjDSBL_CONSTRAINT):
        return False
    dry = model.dof_frictionloss.any() or model.tendon_frictionloss.any()
    colliding = (model.geom_contype | model.geom_conaffinity) != 0
    tangential = has_contacts(model) and ((model.geom_condim[colliding] > 1).any() or (model.pair_dim > 1).any())
    return bool((dry and not disabled(model, OFF.mjDSBL_FRICTIONLOSS)) or tangential)


def _springs(model: mujoco.MjModel) -> dict[str, Any]:
    """Springs of scalar dofs (rest, three coefficients) and of quaternions (rest, three coefficients)."""
    dofs, positions, parameters = [], [], []
    ball_dofs, ball_positions, ball_parameters = [], [], []
    stiffness = np.column_stack([model.jnt_stiffness, model.jnt_stiffnesspoly])
    if disabled(model, OFF.mjDSBL_SPRING):
        stiffness[:] = 0.0
    for j in np.flatnonzero(stiffness.any(axis=1)):
        dof, adr, kind = model.jnt_dofadr[j], model.jnt_qposadr[j], model.jnt_type[j]
        for k in range({JOINT.mjJNT_FREE: 3, JOINT.mjJNT_BALL: 0}.get(kind, 1)):
            dofs.append(dof + k)
            positions.append(adr + k)
            parameters.append([model.qpos_spring[adr + k], *stiffness[j]])
        if kind not in SCALAR:
            skip = 3 if kind == JOINT.mjJNT_FREE else 0
            ball_dofs.append(dof + skip)
            ball_positions.append(adr + skip)
            ball_parameters.append([*model.qpos_spring[adr + skip : adr + skip + 4], *stiffness[j]])
    return {
        "nspring": len(dofs), "spring_dof": np.array(dofs, np.int64), "spring_qadr": np.array(positions, np.int64),
        "spring_prm": np.array(parameters).reshape(-1, 4),
        "nball": len(ball_dofs), "ball_dof": np.array(ball_dofs, np.int64),
        "ball_qadr": np.array(ball_positions, np.int64), "ball_prm": np.array(ball_parameters).reshape(-1, 7),
    }  # fmt: skip


def _no_path() -> tuple[Any, Any]:
    return np.zeros(0, np.int64), np.zeros(0)


def tendon_dofs(model: mujoco.MjModel, t: int) -> tuple[Any, Any]:
    """Dofs and coefficients of a fixed tendon; empty for a spatial one."""
    path = slice(model.tendon_adr[t], model.tendon_adr[t] + model.tendon_num[t])
    if model.wrap_type[path][0] != WRAP.mjWRAP_JOINT:
        return _no_path()
    return model.jnt_dofadr[model.wrap_objid[path]], model.wrap_prm[path]


def tendons(model: mujoco.MjModel) -> dict[str, Any]:
    """Dofs and coefficients of the fixed tendons, their springs' dead band and coefficients, dampers, armature."""
    paths = [tendon_dofs(model, t) for t in range(model.ntendon)]
    prm = np.zeros((model.ntendon, columns.TENDON_NUMBERS))
    if model.ntendon:
        prm[:, columns.BAND : columns.BAND + 2] = model.tendon_lengthspring
        prm[:, columns.ARMATURE] = model.tendon_armature
        if not disabled(model, OFF.mjDSBL_SPRING):
            prm[:, columns.STIFFNESS] = model.tendon_stiffness
            prm[:, columns.STIFFNESS + 1 : columns.STIFFNESS + 3] = model.tendon_stiffnesspoly
        if not disabled(model, OFF.mjDSBL_DAMPER):
            prm[:, columns.DAMPING] = model.tendon_damping
            prm[:, columns.DAMPING + 1 : columns.DAMPING + 3] = model.tendon_dampingpoly
    for i in range(model.nactuator):
        if model.actuator_trntype[i] == TRN.mjTRN_TENDON:
            tendon, square = model.actuator_trnid[i, 0], gear_of(model, i)[0] ** 2
            prm[tendon, columns.ARMATURE] += square * model.actuator_armature[i]
            own = np.append(model.actuator_damping[i], model.actuator_dampingpoly[i])
            if disabled(model, OFF.mjDSBL_DAMPER):
                own = np.zeros(3)
            prm[tendon, columns.DAMPING : columns.DAMPING + 3] += square * own
    constant = np.array([len(dofs) > 0 for dofs, _ in paths], bool)
    return {"ten_prm": prm, "ten_constant": constant} | lists("ten", paths)


def lists(name: str, paths: list[tuple[Any, Any]]) -> dict[str, Any]:
    """Lists of dofs and coefficients, one after the other."""
    lengths = [len(dofs) for dofs, _ in paths]
    return {
        f"{name}_first": np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64), f"n{name}_coef": sum(lengths),
        f"{name}_dof": np.concatenate([np.zeros(0, np.int64), *[dofs for dofs, _ in paths]]).astype(np.int64),
        f"{name}_coef": np.concatenate([np.zeros(0), *[coefficients for _, coefficients in paths]]),
    }  # fmt: skip


def row_model(model: mujoco.MjModel) -> mujoco.MjModel:
    """Model to make constraint rows with.

    Under the discrete integrator MuJoCo leaves the rows' weights open until late in the step; so there they are made
    as for another integrator, and completed by `weights`.
    """
    if model.opt.integrator != INT.mjINT_DISCRETE:
        return model
    plain = copy.copy(model)
    plain.opt.integrator = INT.mjINT_EULER
    plain.opt.disableflags |= OFF.mjDSBL_REFSAFE
    return plain


def _gyroscopic(model: mujoco.MjModel) -> dict[str, Any]:
    """Dofs whose bias forces the integrator takes implicitly."""
    marked = np.zeros(model.nv, np.int64)
    if model.opt.integrator == INT.mjINT_IMPLICIT:
        marked[:] = 1
    elif model.opt.integrator in (INT.mjINT_IMPLICITFAST, INT.mjINT_DISCRETE):
        for j in np.flatnonzero(model.jnt_type == JOINT.mjJNT_FREE):
            first = model.jnt_dofadr[j]
            if not (model.dof_parentid[first + 6 :] == first + 5).any():
                marked[first : first + 6] = 1
    return {"dof_gyroscopic": marked, "gyroscopic": int(marked.any())}


def lone_dofs(model: mujoco.MjModel) -> Any:
    """Dofs that implicitfast couples with no others of their branch.

    It keeps of df/dv what fits into the pattern of M, which is diagonal for bodies that MuJoCo calls simple; those of
    free bodies it treats like implicit.
    """
    if model.opt.integrator != INT.mjINT_IMPLICITFAST:
        return np.zeros(model.nv, bool)
    return (model.dof_simplenum > 0) & (_gyroscopic(model)["dof_gyroscopic"] == 0)
