"""Joints that mimic others in Pinocchio, against MuJoCo's mass matrix and bias forces of the robot without its ties."""

import copy
import pickle
import re

import mujoco
import numpy as np
import pytest
from test_inputs import LINK, MIMIC, joint

import mjslq
from mjslq import PinocchioDynamics
from mjslq.dynamics.mujoco.files import urdf_spec

H = 0.004
CHAINED = MIMIC.replace(
    "</robot>",
    joint("last", "l2", "l4", '<mimic joint="finger" multiplier="2"/>') + LINK.format("l4") + "</robot>",
)
FOLLOWERS = {"finger": ("grip", -1.0, 0.1), "last": ("grip", -2.0, 0.2)}


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "mimic.urdf"
    path.write_text(CHAINED)
    return path


def untied(tmp_path):
    """MuJoCo's model of the robot without its ties."""
    path = tmp_path / "free.urdf"
    path.write_text(re.sub("<mimic[^>]*>", "", CHAINED))
    spec = urdf_spec(path, motors=False)
    spec.option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return spec.compile()


def positions(model, q, follow):
    """Positions or velocities of all joints, (grip, j3) -> every joint by name; offsets for positions alone."""
    known = {"grip": q[0], "j3": q[1]}
    for name, (leader, m, o) in FOLLOWERS.items():
        known[name] = m * known[leader] + (o if follow else 0.0)
    return np.array([known[model.joint(j).name] for j in range(model.njnt)])


def motion(dynamics, N=8):
    rng = np.random.default_rng(2)
    x0 = dynamics.initial_state + 0.0
    x0[-dynamics.nv :] = rng.normal(size=dynamics.nv)
    x0[-dynamics.nv - 2 : -dynamics.nv] = 0.4, -0.3
    return dynamics.rollout(x0, rng.normal(size=(N, dynamics.nu)))


def test_steps_are_those_of_the_projected_equations_of_mujoco(file, tmp_path):
    armature, damping = {"grip": 0.02, "last": 0.01}, {"grip": 0.1, "finger": 0.3, "j3": 0.2}
    dynamics = PinocchioDynamics.from_path(file, H, armature=armature, damping=damping)
    trajectory = motion(dynamics)
    model = untied(tmp_path)
    names = [model.joint(j).name for j in range(model.njnt)]
    model.dof_armature[:] = [armature.get(name, 0.0) for name in names]
    data, D = mujoco.MjData(model), np.diag([damping.get(name, 0.0) for name in names])
    G = np.stack([positions(model, column, False) for column in np.eye(2)], axis=1)
    for n, u in enumerate(trajectory.U):
        q, v = trajectory.X[n, :2], trajectory.X[n, 2:]
        data.qpos, data.qvel = positions(model, q, True), G @ v
        mujoco.mj_forward(model, data)
        M = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, M)
        force = u - G.T @ (data.qfrc_bias + D @ G @ v)
        v_next = v + H * np.linalg.solve(G.T @ (M + H * D) @ G, force)
        np.testing.assert_allclose(trajectory.X[n + 1], np.concatenate([q + H * v_next, v_next]), rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("floating", [False, True])
@pytest.mark.parametrize("integrator", ["semi-implicit-euler", "rk4"])
def test_derivatives(file, integrator, floating):
    dynamics = PinocchioDynamics.from_path(
        file, H, outputs=["l4", "l3", "l2.orientation"], integrator=integrator, damping=0.1, floating_base=floating
    )
    assert dynamics.nv == (8 if floating else 2) and dynamics.control_names == ("grip", "j3")
    assert dynamics.check_derivatives(motion(dynamics)).worst_error < 1e-8
    again = motion(dynamics)
    ends, outputs = dynamics.step_each(again.X, again.U)
    np.testing.assert_allclose(ends, again.X[1:], rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(outputs, again.Y, rtol=1e-12, atol=1e-13)
    carried = pickle.loads(pickle.dumps(copy.deepcopy(dynamics)))
    np.testing.assert_array_equal(carried.rollout(again.X[0], again.U).X, again.X)


def test_followers_are_drawn_where_they_are(file, tmp_path):
    dynamics = PinocchioDynamics.from_path(file, H, outputs=["l4"])
    problem = mjslq.Problem(
        dynamics,
        20,
        np.zeros(4),
        [mjslq.costs.Control(1e-3), mjslq.costs.Sensor("l4", [0.2, 0.0, -0.6], 10.0, "terminal")],
    )
    result = mjslq.solve(problem)
    assert result.success
    result.save(tmp_path / "r.npz")
    scene, X = mjslq.load(tmp_path / "r.npz").scene, result.trajectory.X
    model = mujoco.MjModel.from_binary_path(_written(tmp_path, scene.model))
    expected = np.stack([positions(model, x[:2], True) for x in X])
    np.testing.assert_allclose(scene.poses(X), expected, rtol=1e-14, atol=1e-15)


def _written(tmp_path, data):
    path = tmp_path / "scene.mjb"
    path.write_bytes(data)
    return str(path)


@pytest.mark.parametrize(
    "change, sentence",
    [
        (('joint="grip"', 'joint="nobody"'), "joint 'finger' mimics 'nobody', but 'nobody' is not in the model"),
        (('joint="grip"', 'joint="last"'), "joint 'finger' mimics itself, by way of "),
        (('joint="grip"', 'joint="j3"'), "'finger' mimics 'j3', which .* exchange .* multiplier -1 and offset 0.1"),
    ],
)
def test_ties_that_cannot_be(file, change, sentence):
    file.write_text(CHAINED.replace(*change))
    with pytest.raises(ValueError, match=sentence):
        PinocchioDynamics.from_path(file, H)


def test_fixed_joints_follow_none_and_lead_to_their_place(file):
    """As in Talos, whose reduced files keep the <mimic> of joints that they have fixed."""
    tied = CHAINED.replace('type="revolute"', 'type="fixed"', 1)
    file.write_text(tied)
    led = PinocchioDynamics.from_path(file, H, outputs=["l4"])
    assert led.state_names == ("j3", "j3.vel")
    file.write_text(CHAINED)
    locked = PinocchioDynamics.from_path(file, H, ["grip"], outputs=["l4"])
    np.testing.assert_allclose(*(d.rollout(np.zeros(2), np.zeros((1, 1))).Y for d in (led, locked)), atol=1e-15)
    file.write_text(CHAINED.replace('name="finger" type="revolute"', 'name="finger" type="fixed"'))
    assert PinocchioDynamics.from_path(file, H, ["last"]).control_names == ("grip", "j3")
