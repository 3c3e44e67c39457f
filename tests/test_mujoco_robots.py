"""URDF files: robots by name, and what a URDF lacks."""

import mujoco
import numpy as np
import pytest

from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.robots import robot_names, robot_path, robot_spec

URDF = """
<robot name="one">
  <link name="base"/>
  <link name="arm">
    <visual name="twice"><geometry><mesh filename="package://nowhere/arm.dae"/></geometry></visual>
    <collision name="twice"><geometry><box size="0.1 0.1 0.4"/></geometry></collision>
    <inertial><origin xyz="0 0 0.2"/><mass value="2"/>
      <inertia ixx="0.02" iyy="0.02" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="tool"><collision><geometry><sphere radius="0.1"/></geometry></collision></link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="7" velocity="1"/></joint>
  <joint name="fixed" type="fixed"><parent link="arm"/><child link="tool"/></joint>
</robot>"""


@pytest.mark.filterwarnings("ignore:.*the visual mesh:UserWarning")  # .dae, which MuJoCo cannot read
@pytest.mark.parametrize("name, joints", [("panda", 9), ("solo12", 12), ("g1", 29), ("ur5", 6)])
def test_robots_load(name, joints):
    dynamics = MujocoDynamics.from_path(robot_path(name), timestep=0.005)
    followers = 1 if name == "panda" else 0  # the second finger mimics the first and has no motor
    assert dynamics.nx == 2 * joints and dynamics.nu == joints - followers
    assert not dynamics.rollout(dynamics.initial_state, np.zeros((3, dynamics.nu))).diverged


def test_names():
    assert {"panda", "ur5", "solo12", "g1", "talos", "go2", "anymal_c"} <= set(robot_names())
    assert robot_path("panda").is_file()
    with pytest.raises(ValueError, match=r"unknown robot 'pand'; there are: .*panda.*did you mean 'panda'\?"):
        robot_path("pand")


def test_floating_base_floor_and_armature():
    dynamics = MujocoDynamics.from_spec(robot_spec("solo12", floating=True, floor=True, armature=0.01))
    assert (dynamics.nx, dynamics.ndx, dynamics.nu) == (37, 36, 12)
    assert dynamics.state_names[:4] == ("root.x", "root.y", "root.z", "root.qw")
    assert np.all(dynamics.model.dof_armature[6:] == 0.01) and dynamics.model.dof_armature[0] == 0.0


def test_a_urdf_gets_motors_limited_by_effort_and_loses_unreadable_meshes(tmp_path):
    (tmp_path / "one.urdf").write_text(URDF)
    with pytest.warns(UserWarning, match=r"^one.urdf: the visual mesh 'package://nowhere/arm.dae' .*packages"):
        dynamics = MujocoDynamics.from_path(tmp_path / "one.urdf")
    assert dynamics.control_names == ("hinge",) and dynamics.name == "one"
    np.testing.assert_array_equal(dynamics.control_limits, [[-7, 7]])
    model = dynamics.model
    assert model.nmesh == 0 and not model.jnt_actfrclimited.any()
    assert model.body("arm").mass == 2.0 and model.body("tool").mass < 1e-8


def test_meshes_are_found_by_package(tmp_path):
    folder = tmp_path / "bot" / "urdf"
    folder.mkdir(parents=True)
    (tmp_path / "bot" / "arm.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    (folder / "one.urdf").write_text(URDF.replace("nowhere/arm.dae", "bot/arm.obj"))
    assert MujocoDynamics.from_path(folder / "one.urdf").model.nmesh == 1


def test_other_xml_is_no_urdf(tmp_path):
    from mjslq.dynamics.mujoco.files import urdf_spec

    (tmp_path / "a.urdf").write_text("<mujoco/>")
    with pytest.raises(ValueError, match="outermost element is <mujoco>, not <robot>"):
        urdf_spec(tmp_path / "a.urdf")


def test_masses_are_those_of_the_file():
    model = robot_spec("panda").compile()
    assert isinstance(model, mujoco.MjModel)
    assert 15.0 < model.body_mass.sum() < 25.0


@pytest.mark.filterwarnings("ignore:.*the visual mesh:UserWarning")  # .dae, which MuJoCo cannot read
@pytest.mark.parametrize("name", ["ur5", "solo12", "g1", "z1"])
def test_accelerations_are_pinocchios(name):
    pin = pytest.importorskip("pinocchio")
    other = pin.buildModelFromUrdf(str(robot_path(name)))
    model = MujocoDynamics.from_path(robot_path(name)).model
    off = mujoco.mjtDisableBit
    model.opt.disableflags |= int(off.mjDSBL_CONSTRAINT | off.mjDSBL_DAMPER)
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    q, v, tau = 0.3 * rng.normal(size=(3, model.nq))
    data.qpos, data.qvel, data.qfrc_applied = q, v, tau
    mujoco.mj_forward(model, data)
    order = [other.idx_vs[other.getJointId(model.joint(i).name)] for i in range(model.njnt)]
    Q, V, T = np.zeros((3, other.nq))
    Q[order], V[order], T[order] = q, v, tau
    expected = pin.aba(other, other.createData(), Q, V, T)[order]
    np.testing.assert_allclose(data.qacc, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
