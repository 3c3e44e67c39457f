"""The two engines agree: one URDF, the same accelerations, steps, Jacobians and frames.

MuJoCo's free joint has its linear velocity in the world's frame and its quaternion (w, x, y, z), Pinocchio's in the
body's frame and (x, y, z, w); `to_mujoco` translates.
"""

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import mjslq
from mjslq.dynamics.locked_joints import lock_spec
from mjslq.robots import robot_path, robot_spec

FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
ROBOTS = {"panda": (False, FINGERS), "ur5": (False, ()), "solo12": (True, ()), "g1": (True, ())}
H, ARMATURE, DAMPING = 0.002, 0.01, 0.05


def spec_of(name, damping):
    floating, locked = ROBOTS[name]
    spec = robot_spec(name, floating=floating, armature=ARMATURE)
    lock_spec(spec, locked)
    for joint in spec.joints:
        if joint.type != mujoco.mjtJoint.mjJNT_FREE:
            joint.damping[:] = [damping, 0.0, 0.0]
    for motor in spec.actuators:
        motor.ctrllimited = False
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return spec


def engines(name, damping=DAMPING):
    floating, locked = ROBOTS[name]
    ours = mjslq.PinocchioDynamics.from_path(
        robot_path(name), H, locked, floating_base=floating, armature=ARMATURE, damping=damping
    )
    return ours, mjslq.MujocoDynamics.from_spec(spec_of(name, damping), timestep=H)


def joint_order(ours, theirs):
    """Indices of Pinocchio's q, v and u of MuJoCo's joints with one axis, in MuJoCo's order."""
    names = [theirs.model.joint(j).name for j in range(theirs.model.njnt)]
    indices = [ours.model.getJointId(name) for name in names if name != "root"]
    q, v = ([int(table[j]) for j in indices] for table in (ours.model.idx_qs, ours.model.idx_vs))
    return q, v, [ours.control_names.index(name) for name in theirs.control_names]


def to_mujoco(ours, theirs, x):
    """The state of MuJoCo's model that is `x` on Pinocchio's."""
    q, v, _ = joint_order(ours, theirs)
    nq = ours.model.nq
    position, velocity = x[:nq], x[nq:]
    if nq == ours.model.nv:
        return np.concatenate([position[q], velocity[v]])
    linear = pin.Quaternion(position[3:7]).matrix() @ velocity[:3]
    return np.concatenate([position[[0, 1, 2, 6, 3, 4, 5]], position[q], linear, velocity[3:6], velocity[v]])


def mujoco_acceleration(ours, theirs, x, u):
    """MuJoCo's accelerations in Pinocchio's order and frames; dv/dt of a base in its own frame is R'dV/dt - w x v."""
    _, v, controls = joint_order(ours, theirs)
    model, nq = theirs.model, ours.model.nq
    data = mujoco.MjData(model)
    data.qpos, data.qvel = np.split(to_mujoco(ours, theirs, x), [model.nq])
    data.ctrl = u[controls]
    mujoco.mj_forward(model, data)
    a = np.zeros(ours.model.nv)
    a[v] = data.qacc[-len(v) :]
    if nq > ours.model.nv:
        R, linear, angular = pin.Quaternion(x[3:7]).matrix(), x[nq : nq + 3], x[nq + 3 : nq + 6]
        a[:3] = R.T @ data.qacc[:3] - np.cross(angular, linear)
        a[3:6] = data.qacc[3:6]
    return a


def state_and_control(ours, seed):
    rng = np.random.default_rng(seed)
    return ours.integrate(ours.initial_state, 0.5 * rng.normal(size=ours.ndx)), rng.normal(size=ours.nu)


@pytest.mark.parametrize("name", ROBOTS)
def test_accelerations(name):
    ours, theirs = engines(name, damping=0.0)
    for seed in range(5):
        x, u = state_and_control(ours, seed)
        expected = mujoco_acceleration(ours, theirs, x, u)
        a = (ours.rollout(x, u[None]).X[1] - x)[ours.model.nq :] / H
        np.testing.assert_allclose(a, expected, rtol=0, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_steps_and_jacobians_of_arms(name):
    """Damping included, which both engines treat implicitly."""
    ours, theirs = engines(name)
    x, u = state_and_control(ours, 0)
    assert ours.state_names == theirs.state_names and ours.control_names == theirs.control_names
    U = np.tile(u, (5, 1))
    mine, other = ours.rollout(x, U), theirs.rollout(x, U)
    np.testing.assert_allclose(mine.X, other.X, rtol=0, atol=1e-9 * np.abs(other.X).max())
    A, B, _, _ = ours.linearize(mine)
    A2, B2, _, _ = theirs.linearize(mine)
    np.testing.assert_allclose(A, A2, rtol=0, atol=1e-6 * np.abs(A).max())
    np.testing.assert_allclose(B, B2, rtol=0, atol=1e-6 * np.abs(B).max())


@pytest.mark.parametrize("name", ["solo12", "g1"])
def test_derivatives_of_floating_bases(name):
    """Five-point differences of MuJoCo's accelerations are Pinocchio's derivatives of them."""
    ours, theirs = engines(name, damping=0.0)
    x, u = state_and_control(ours, 1)
    nv, e = ours.model.nv, 1e-3
    A, B, _, _ = ours.linearize(ours.rollout(x, u[None]))
    analytic = np.hstack([A[0, nv:] - np.eye(2 * nv)[nv:], B[0, nv:]]) / H
    scale = np.abs(analytic).max()

    def at(d):
        return mujoco_acceleration(ours, theirs, ours.integrate(x, d[: 2 * nv]), u + d[2 * nv :])

    for i in range(0, analytic.shape[1], 3 if name == "solo12" else 8):
        d = e * np.eye(analytic.shape[1])[i]
        difference = (8.0 * (at(d) - at(-d)) - (at(2 * d) - at(-2 * d))) / (12.0 * e)
        np.testing.assert_allclose(analytic[:, i], difference, rtol=0, atol=1e-7 * scale)


@pytest.mark.parametrize("name", ["panda", "solo12"])
def test_a_viewer_draws_the_same_pose(name):
    """The scene's columns put every link of MuJoCo's model where Pinocchio has its frame."""
    floating, locked = ROBOTS[name]
    at = {joint: 0.02 for joint in locked}
    ours = mjslq.PinocchioDynamics.from_path(robot_path(name), H, at, floating_base=floating)
    scene, x = ours.scene(), state_and_control(ours, 2)[0]
    model = mujoco.MjModel.from_binary_path("m.mjb", {"m.mjb": scene.model})
    data = mujoco.MjData(model)
    data.qpos = scene.poses(x[None])[0]
    mujoco.mj_kinematics(model, data)
    for b in range(1, model.nbody):
        body = model.body(b).name
        seen = mjslq.PinocchioDynamics.from_model(ours.model, H, outputs=(body,)).step(x, np.zeros(ours.nu))[1]
        np.testing.assert_allclose(data.xpos[b], seen, atol=1e-9, err_msg=body)
