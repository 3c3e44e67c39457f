"""MujocoDynamics against plain loops over mj_step, and its Jacobians against a fine reference."""

import mujoco
import numpy as np
import pytest

from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.trajectory import Trajectory

ARM = """
<mujoco model="arm">
  <option timestep="0.01" integrator="implicitfast"/>
  <worldbody>
    <body><joint name="shoulder" axis="0 1 0" damping="0.2"/>
      <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.03" mass="1"/>
      <body pos="0.4 0 0"><joint name="elbow" axis="0 1 0" damping="0.2" stiffness="1"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="0.5"/><site name="hand" pos="0.3 0 0"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="shoulder" joint="shoulder" ctrlrange="-5 5" ctrllimited="true"/>
    <general name="muscle" joint="elbow" dyntype="filter" dynprm="0.05" gainprm="2"/>
  </actuator>
  <sensor>
    <framepos name="hand" objtype="site" objname="hand"/>
    <jointvel name="rate" joint="elbow"/>
    <actuatorfrc name="force" actuator="shoulder"/>
    <accelerometer site="hand"/>
  </sensor>
  <keyframe><key name="home" qpos="0.3 -0.5" qvel="0.1 0.2" act="0.4" ctrl="1 2"/></keyframe>
</mujoco>"""

FLOATER = """
<mujoco>
  <option timestep="0.005" gravity="0 0 -1"/>
  <worldbody>
    <body pos="0 0 1"><freejoint name="root"/><geom type="box" size="0.2 0.1 0.05" mass="2"/>
      <body pos="0.2 0 0"><joint name="ball" type="ball" damping="0.02"/>
        <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="0.4"/>
        <body pos="0.3 0 0"><joint type="slide" axis="1 0 0" damping="0.3" stiffness="20"/>
          <geom size="0.04" mass="0.2"/><site name="tip"/></body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="slide" joint="joint2"/>
    <motor name="turn" joint="ball" gear="0 0 1"/>
    <motor name="push" site="tip" gear="0 1 0 0 0 0"/>
  </actuator>
  <sensor><framepos name="tip" objtype="site" objname="tip"/><ballquat name="q" joint="ball"/></sensor>
</mujoco>""".replace('<joint type="slide"', '<joint name="joint2" type="slide"')

BOX = """
<mujoco>
  <option timestep="0.005" integrator="implicitfast" tolerance="1e-12"/>
  <worldbody>
    <geom type="plane" size="5 5 0.1" solref="0.02 1" solimp="0 0.99 0.02"/>
    <body pos="0 0 0.1"><freejoint name="root"/><geom type="box" size="0.2 0.1 0.1" mass="2"
      solref="0.02 1" solimp="0 0.99 0.02"/><site name="center"/></body>
  </worldbody>
  <actuator><motor name="pull" site="center" gear="1 0 0 0 0 0"/></actuator>
  <sensor><framelinvel name="velocity" objtype="body" objname="body1"/></sensor>
</mujoco>""".replace('<body pos="0 0 0.1">', '<body name="body1" pos="0 0 0.1">')

MODELS = {"arm": ARM, "floater": FLOATER, "box": BOX}


def controls(dynamics: MujocoDynamics, N: int, size: float = 1.0) -> np.ndarray:
    return size * np.random.default_rng(3).normal(size=(N, dynamics.nu))


def start(dynamics: MujocoDynamics) -> np.ndarray:
    """A state in motion; the box slides on the floor, into which its soft contacts have let it sink."""
    dx = 0.2 * np.random.default_rng(4).normal(size=dynamics.ndx)
    if dynamics.control_names == ("pull",):
        dx *= np.array([1, 1, 0, 0, 0, 1, 1, 1, 0, 0, 0, 1])
        return dynamics.integrate(dynamics.rollout(dynamics.initial_state, np.zeros((200, 1))).X[-1], dx)
    return dynamics.integrate(dynamics.initial_state, dx)


def plain_loop(dynamics: MujocoDynamics, x0, policy, N: int):
    """Simulate with MuJoCo's own bindings."""
    model = dynamics.model
    data = mujoco.MjData(model)
    data.qpos, data.qvel, data.act = np.split(x0, [model.nq, model.nq + model.nv])
    X, U, Y = [x0], [], []
    for n in range(N):
        data.ctrl = policy(n, X[-1])
        U.append(data.ctrl.copy())
        mujoco.mj_step(model, data)
        Y.append(data.sensordata.copy())
        X.append(np.concatenate([data.qpos, data.qvel, data.act]))
    data.ctrl = 0.0
    mujoco.mj_forward(model, data)
    return np.array(X), np.array(U), np.array([*Y, data.sensordata.copy()])


@pytest.mark.parametrize("name", MODELS)
def test_rollout_is_a_plain_loop(name):
    dynamics = MujocoDynamics.from_xml(MODELS[name])
    x0, U = start(dynamics), controls(dynamics, 50)
    trajectory = dynamics.rollout(x0, U)
    X, _, Y = plain_loop(dynamics, x0, lambda n, x: U[n], 50)
    np.testing.assert_array_equal(trajectory.X, X)
    np.testing.assert_array_equal(trajectory.Y, Y)
    assert not trajectory.diverged
    again = dynamics.rollout(x0, U)
    np.testing.assert_array_equal(again.X, trajectory.X)


@pytest.mark.parametrize("name", MODELS)
def test_step_is_a_step_of_the_rollout(name):
    dynamics = MujocoDynamics.from_xml(MODELS[name])
    trajectory = dynamics.rollout(start(dynamics), controls(dynamics, 5))
    for n in range(5):
        x, y = dynamics.step(trajectory.X[n], trajectory.U[n], n)
        np.testing.assert_allclose(x, trajectory.X[n + 1], rtol=0, atol=1e-9)
        np.testing.assert_allclose(y, trajectory.Y[n], rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", MODELS)
def test_feedback_rollout_is_a_plain_loop(name):
    dynamics = MujocoDynamics.from_xml(MODELS[name])
    rng = np.random.default_rng(0)
    reference = dynamics.rollout(start(dynamics), controls(dynamics, 40))
    K = 0.3 * rng.normal(size=(40, dynamics.nu, dynamics.ndx))
    k = rng.normal(size=(40, dynamics.nu))
    x0 = dynamics.integrate(reference.X[0], 1e-2 * rng.normal(size=dynamics.ndx))

    def policy(n, x):
        return reference.U[n] + 0.7 * k[n] - K[n] @ dynamics.difference(reference.X[n], x)

    trajectory = dynamics.rollout_feedback(reference, K, k, 0.7, x0)
    X, U, Y = plain_loop(dynamics, x0, policy, 40)
    np.testing.assert_allclose(trajectory.X, X, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(trajectory.U, U, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(trajectory.Y, Y, rtol=1e-7, atol=1e-7)
    same = dynamics.rollout_feedback(reference, K, 0 * k)
    np.testing.assert_array_equal(same.X, reference.X)


@pytest.mark.parametrize("name, tolerance", [("arm", 1e-8), ("floater", 1e-8), ("box", 1e-6)])
def test_linearization_is_right(name, tolerance):
    dynamics = MujocoDynamics.from_xml(MODELS[name], threads=2)
    check = dynamics.check_derivatives(dynamics.rollout(start(dynamics), controls(dynamics, 12)))
    assert check.worst_error < tolerance, check


def test_linearization_does_not_depend_on_threads():
    U = controls(MujocoDynamics.from_xml(BOX), 30)
    results = []
    for threads in (1, 2, 3):
        dynamics = MujocoDynamics.from_xml(BOX, threads=threads)
        results.append(dynamics.linearize(dynamics.rollout(start(dynamics), U)))
    for other in results[1:]:
        for ours, theirs in zip(results[0], other, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_sides_and_size_of_the_differences_can_be_chosen():
    ways = {"jacobian": "transition"}
    fine, coarse = (MujocoDynamics.from_xml(ARM, **ways, **way) for way in ({}, {"eps": 1e-4, "centered": False}))
    trajectory = fine.rollout(fine.keyframe("home"), controls(fine, 5))
    error = np.abs(fine.linearize(trajectory).A - coarse.linearize(trajectory).A).max()
    assert 1e-8 < error < 1e-2


def test_control_limits_are_mujocos_own():
    dynamics = MujocoDynamics.from_xml(ARM)
    np.testing.assert_array_equal(dynamics.control_limits, [[-5, 5], [-np.inf, np.inf]])
    x0 = dynamics.initial_state
    over, at = np.array([[9.0, 1.0]]), np.array([[5.0, 1.0]])
    np.testing.assert_array_equal(dynamics.rollout(x0, over).X, dynamics.rollout(x0, at).X)
    B = dynamics.linearize(dynamics.rollout(x0, over)).B
    assert np.all(B[0, :, 0] == 0.0) and np.abs(B[0, :, 1]).max() > 0.0


def test_names():
    arm, floater = MujocoDynamics.from_xml(ARM), MujocoDynamics.from_xml(FLOATER)
    assert arm.state_names == ("shoulder", "elbow", "shoulder.vel", "elbow.vel", "muscle.act")
    assert arm.control_names == ("shoulder", "muscle")
    assert arm.output_names[:5] == ("hand[0]", "hand[1]", "hand[2]", "rate", "force")
    assert arm.output_names[5] == "sensor3[0]"
    assert floater.state_names[:8] == (
        "root.x", "root.y", "root.z", "root.qw", "root.qx", "root.qy", "root.qz", "ball.qw"
    )  # fmt: skip
    assert len(floater.state_names) == floater.nx and len(floater.output_names) == floater.ny
    assert arm.name == "arm" and floater.name == "model"


def test_keyframes():
    dynamics = MujocoDynamics.from_xml(ARM)
    np.testing.assert_allclose(dynamics.keyframe("home"), [0.3, -0.5, 0.1, 0.2, 0.4])
    np.testing.assert_allclose(dynamics.keyframe_control("home"), [1, 2])
    with pytest.raises(ValueError, match=r"unknown keyframe 'hme'; there are: home; did you mean 'home'\?"):
        dynamics.keyframe("hme")


def test_constructors_agree_and_leave_the_callers_model_alone(tmp_path):
    spec, model = mujoco.MjSpec.from_string(ARM), mujoco.MjModel.from_xml_string(ARM)
    (tmp_path / "arm.xml").write_text(ARM)
    mujoco.mj_saveModel(model, str(tmp_path / "arm.mjb"), None)
    engines = [
        MujocoDynamics.from_xml(ARM, timestep=0.002),
        MujocoDynamics.from_spec(spec, timestep=0.002),
        MujocoDynamics.from_model(model, timestep=0.002),
        MujocoDynamics.from_path(tmp_path / "arm.xml", timestep=0.002),
        MujocoDynamics.from_path(str(tmp_path / "arm.mjb"), timestep=0.002),
    ]
    assert model.opt.timestep == spec.option.timestep == 0.01
    U = controls(engines[0], 10)
    expected = engines[0].rollout(engines[0].keyframe("home"), U)
    assert engines[0].dt == 0.002 and np.allclose(expected.dt, 0.002)
    for engine in engines[1:]:
        np.testing.assert_array_equal(engine.rollout(engine.keyframe("home"), U).X, expected.X)


def test_scene_holds_the_model(tmp_path):
    dynamics = MujocoDynamics.from_xml(FLOATER)
    scene = dynamics.scene()
    (tmp_path / "model.mjb").write_bytes(scene.model)
    model = mujoco.MjModel.from_binary_path(str(tmp_path / "model.mjb"))
    X = dynamics.rollout(start(dynamics), controls(dynamics, 3)).X
    assert scene.poses(X).shape == (4, model.nq) and scene.name == "model"


def test_scene_leaves_out_what_only_collisions_need():
    spec = mujoco.MjSpec()
    mesh = spec.add_mesh(name="ball")
    mesh.make_sphere(subdivision=3)
    body = spec.worldbody.add_body()
    body.add_joint(name="turn")
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="ball")
    spec.add_actuator(trntype=mujoco.mjtTrn.mjTRN_JOINT, target="turn").set_to_motor()
    dynamics = MujocoDynamics.from_spec(spec)
    before = dynamics.model.bvh_aabb.copy()
    kept = mujoco.MjModel.from_binary_path("scene.mjb", {"scene.mjb": dynamics.scene().model})
    assert before.any() and not kept.bvh_aabb.any() and (kept.mesh_vert == dynamics.model.mesh_vert).all()
    np.testing.assert_array_equal(dynamics.model.bvh_aabb, before)


def test_empty_horizon_and_no_sensors():
    dynamics = MujocoDynamics.from_xml(ARM[: ARM.index("<sensor>")] + "</mujoco>")
    trajectory = dynamics.rollout(dynamics.initial_state, np.zeros((0, 2)))
    assert trajectory.X.shape == (1, 5) and trajectory.Y.shape == (1, 0)
    assert dynamics.linearize(trajectory).A.shape == (0, 5, 5)
    trajectory = dynamics.rollout(dynamics.initial_state, np.zeros((2, 2)))
    assert dynamics.linearize(trajectory).C.shape == (3, 0, 5)


def test_report_names_the_parts():
    parts = [part for part, _ in MujocoDynamics.from_xml(FLOATER).support_report()]
    assert {"integrator Euler", "1 free joints", "1 ball joints", "3 actuators", "2 sensors"} <= set(parts)


@pytest.mark.parametrize("jacobian", ["inverse", "transition"])
def test_report_warns_of_a_constraint_solver_cut_short(jacobian):
    model = mujoco.MjModel.from_xml_string(FLOATER)
    model.opt.iterations = 5
    model.geom_contype[:] = model.geom_conaffinity[:] = 1

    def rows():
        report = MujocoDynamics.from_model(model, jacobian=jacobian).support_report()
        return [row for row in report if "solver" in row[0]]

    assert len(rows()) == 1 and rows()[0][0] == "constraint solver Newton, 5 iterations"
    assert "too few" in rows()[0][1] and "iterations=100" in rows()[0][1]
    model.opt.iterations = 100
    assert not rows()
    model.opt.iterations, model.opt.disableflags = 1, int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    assert not rows()


def test_wrong_shapes_are_named():
    dynamics = MujocoDynamics.from_xml(ARM)
    with pytest.raises(ValueError, match=r"x0 must have shape \(5,\), got \(4,\)"):
        dynamics.rollout(np.zeros(4), np.zeros((3, 2)))
    with pytest.raises(ValueError, match=r"U must have shape \(N, 2\), got \(3, 1\)"):
        dynamics.rollout(np.zeros(5), np.zeros((3, 1)))
    with pytest.raises(ValueError, match="the trajectory has 4 states"):
        dynamics.linearize(Trajectory(np.zeros((3, 4)), np.zeros((2, 2))))


def test_a_kink_at_one_knot_is_no_wrong_derivative():
    """Dropped onto the floor, the ball touches down between two knots; elsewhere all is right to many digits."""
    drop = MujocoDynamics.from_xml(
        '<mujoco><option timestep="0.01"/><worldbody><geom type="plane" size="5 5 1"/>'
        '<body pos="0 0 0.16"><joint name="z" type="slide" axis="0 0 1"/><geom size="0.1" mass="1"/></body></worldbody>'
        '<actuator><motor joint="z"/></actuator></mujoco>'
    )
    check = drop.check_derivatives(drop.rollout(np.zeros(2), np.zeros((30, 1))))
    assert check.suspects == [] and check.typical["A"] < 1e-6
    assert set(check.share) == set(check.errors) == {"A", "B"}
