"""`PinocchioDynamics`: steps, Jacobians, outputs and the manifold, against plain twins and differences."""

import numpy as np
import pinocchio as pin
import pytest

import mjslq
from mjslq.dynamics.pinocchio.outputs import quaternions
from mjslq.robots import robot_path

INTEGRATORS = ("semi-implicit-euler", "rk4")
FEET = ("FL_FOOT", "FL_FOOT.orientation", "HR_LOWER_LEG")
ARM = """
<robot name="twolink">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.01" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0.05 0 0.1"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="hand"/>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <dynamics damping="0.3"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/><origin xyz="0 0 0.4"/>
    <axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="7" velocity="1"/></joint>
  <joint name="wrist" type="fixed"><parent link="lower"/><child link="hand"/>
    <origin xyz="0 0 0.3" rpy="0.3 0 1"/></joint>
</robot>"""


@pytest.fixture(scope="module")
def urdf(tmp_path_factory):
    file = tmp_path_factory.mktemp("robots") / "twolink.urdf"
    file.write_text(ARM)
    return file


def solo(integrator="semi-implicit-euler", **options):
    given = {"outputs": FEET, "floating_base": True, "armature": 0.02, "damping": 0.1} | options
    return mjslq.PinocchioDynamics.from_path(robot_path("solo12"), 0.01, integrator=integrator, **given)


def moving(dynamics, N=4, seed=0):
    rng = np.random.default_rng(seed)
    x0 = dynamics.integrate(dynamics.initial_state, 0.4 * rng.normal(size=dynamics.ndx))
    return dynamics.rollout(x0, 0.5 * rng.normal(size=(N, dynamics.nu)))


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("floating", [False, True])
def test_jacobians(urdf, integrator, floating):
    if floating:
        dynamics = solo(integrator)
    else:
        dynamics = mjslq.PinocchioDynamics.from_path(
            urdf, 0.02, outputs=("hand", "hand.orientation"), integrator=integrator, armature={"elbow": 0.1}
        )
    trajectory = moving(dynamics)
    assert dynamics.check_derivatives(trajectory).worst_error < 1e-9


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_rollout_is_the_plain_step(integrator):
    """`step` goes by the mass matrix, the rollout by the articulated-body algorithm."""
    dynamics = solo(integrator)
    trajectory = moving(dynamics)
    for n, u in enumerate(trajectory.U):
        x, y = dynamics.step(trajectory.X[n], u)
        np.testing.assert_allclose(trajectory.X[n + 1], x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(trajectory.Y[n], y, rtol=0, atol=1e-13)
    np.testing.assert_allclose(trajectory.Y[-1], dynamics.step(x, 0.0 * u)[1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_steps_apart_from_each_other(integrator):
    dynamics = solo(integrator)
    X, U = moving(dynamics).X[::-1].copy(), np.ones((4, dynamics.nu))
    F, Y = dynamics.step_each(X, U)
    for n in range(4):
        x, y = dynamics.step(X[n], U[n])
        np.testing.assert_allclose(F[n], x, rtol=0, atol=1e-12)
        np.testing.assert_allclose(Y[n], y, rtol=0, atol=1e-13)
    np.testing.assert_allclose(Y[4], dynamics.step(X[4], U[0])[1], rtol=0, atol=1e-13)
    U[2] = 1e30
    assert np.isnan(dynamics.step_each(X, U)[0]).all(axis=1).tolist() == [False, False, True, False]


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_a_single_joint(tmp_path, integrator):
    """Pinocchio hands out matrices of one row as vectors."""
    file = tmp_path / "pendulum.urdf"
    file.write_text("""<robot name="pendulum"><link name="base"/><link name="pole"><inertial><mass value="1"/>
      <origin xyz="0 0 .3"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="j" type="continuous"><parent link="base"/><child link="pole"/><axis xyz="0 1 0"/></joint></robot>""")
    dynamics = mjslq.PinocchioDynamics.from_path(
        file, 0.01, outputs=("pole", "pole.orientation"), integrator=integrator
    )
    assert dynamics.check_derivatives(moving(dynamics)).worst_error < 1e-9
    model = pin.Model()
    wheel = model.addJoint(0, pin.JointModelRUBX(), pin.SE3.Identity(), "wheel")
    model.appendBodyToJoint(wheel, pin.Inertia(1.0, np.array([0.1, 0.0, 0.2]), 0.1 * np.eye(3)), pin.SE3.Identity())
    turning = mjslq.PinocchioDynamics.from_model(model, 0.01, integrator=integrator)
    assert turning.check_derivatives(moving(turning)).worst_error < 1e-9


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_feedback_law(integrator):
    dynamics, rng = solo(integrator), np.random.default_rng(1)
    plan = moving(dynamics)
    K, k = rng.normal(size=(4, dynamics.nu, dynamics.ndx)), rng.normal(size=(4, dynamics.nu))
    x0 = dynamics.integrate(plan.X[0], 0.01 * rng.normal(size=dynamics.ndx))
    near = dynamics.rollout_feedback(plan, K, k, 0.3, x0=x0)
    for n in range(4):
        law = plan.U[n] + 0.3 * k[n] - K[n] @ dynamics.difference(plan.X[n], near.X[n])
        np.testing.assert_allclose(near.U[n], law, rtol=0, atol=1e-12)
    again = dynamics.rollout(x0, near.U)
    np.testing.assert_allclose(again.X, near.X, rtol=0, atol=1e-11)


def test_no_feedback_repeats_the_plan(urdf):
    dynamics = mjslq.PinocchioDynamics.from_path(urdf, 0.01)
    plan = moving(dynamics, N=20)
    K = np.zeros((20, 2, 4))
    np.testing.assert_array_equal(dynamics.rollout_feedback(plan, K, 0.0 * plan.U).X, plan.X)


def test_damping_is_implicit_under_euler():
    """A damper of 1e4 Nm s/rad would blow up an explicit step; here the velocity just goes away."""
    dynamics = solo(damping=1e4)
    trajectory = moving(dynamics, N=30)
    assert not trajectory.diverged
    assert np.abs(trajectory.X[-1, 25:]).max() < 1e-2
    assert dynamics.check_derivatives(moving(dynamics)).worst_error < 1e-6


def test_runge_kutta_has_fourth_order_on_the_manifold():
    """Halving the step divides the error by 16, floating base included, against a far finer rollout."""
    ends = {}
    for steps in (20, 40, 640):
        dynamics = solo("rk4", damping=0.01)
        dynamics = mjslq.PinocchioDynamics.from_model(dynamics.model, 0.4 / steps, integrator="rk4", damping=0.01)
        rng = np.random.default_rng(3)
        x0 = dynamics.integrate(dynamics.initial_state, np.r_[0.4 * rng.normal(size=18), rng.normal(size=18)])
        ends[steps] = dynamics.rollout(x0, np.zeros((steps, dynamics.nu))).X[-1]
    error = {steps: np.linalg.norm(dynamics.difference(ends[640], ends[steps])) for steps in (20, 40)}
    assert 12.0 < error[20] / error[40] < 22.0


@pytest.mark.parametrize("steps", [1, 3])
def test_manifold(steps):
    dynamics, rng = solo(), np.random.default_rng(2)
    dx = 0.7 * rng.normal(size=(steps, 2, dynamics.ndx))
    x = dynamics.integrate(dynamics.initial_state, rng.normal(size=(steps, 1, dynamics.ndx)))
    y = dynamics.integrate(x, dx)
    assert y.shape == (steps, 2, dynamics.nx)
    np.testing.assert_allclose(dynamics.difference(x, y), dx, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(y[..., 3:7], axis=-1), 1.0, atol=1e-14)
    J, e = dynamics.difference_jacobian(x, y), 1e-6
    for i in (0, 4, 9, 20):
        d = e * np.eye(dynamics.ndx)[i]
        column = dynamics.difference(x, dynamics.integrate(y, d)) - dynamics.difference(x, dynamics.integrate(y, -d))
        np.testing.assert_allclose(J[..., i], column / (2.0 * e), atol=1e-8)
    assert dynamics.tangent_basis(x[0, 0]).shape == (37, 36)


def test_outputs_and_names():
    dynamics = solo()
    assert dynamics.outputs["FL_FOOT"] == (slice(0, 3), False)
    assert dynamics.outputs["FL_FOOT.orientation"] == (slice(3, 7), True)
    assert dynamics.output_names[:4] == ("FL_FOOT[0]", "FL_FOOT[1]", "FL_FOOT[2]", "FL_FOOT.orientation[0]")
    assert dynamics.state_names[:8] == (
        "root.x", "root.y", "root.z", "root.qx", "root.qy", "root.qz", "root.qw", "FL_HAA",
    )  # fmt: skip
    assert dynamics.state_names[19] == "root.vx" and dynamics.state_names[-1] == "HR_KFE.vel"
    assert dynamics.control_names[0] == "FL_HAA" and dynamics.nu == 12 and "FL_FOOT" in dynamics.frame_names


def test_quaternions_of_all_turns():
    rng = np.random.default_rng(4)
    turns = [pin.exp3(r) for r in rng.normal(size=(50, 3)) * 2.0]
    turns += [np.diag(signs) for signs in ([1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1])]
    for R, q in zip(turns, quaternions(np.array(turns, dtype=float)), strict=True):
        np.testing.assert_allclose(pin.Quaternion(*q).matrix(), R, atol=1e-14)
        assert q[0] >= 0.0


def test_orientation_cost(urdf):
    """A target on a frame's orientation: the gradient is the derivative of the cost."""
    dynamics = mjslq.PinocchioDynamics.from_path(urdf, 0.02, outputs=("hand.orientation",))
    term = mjslq.costs.Sensor("hand.orientation", [0.9, 0.1, 0.2, 0.3], 10.0, "always")
    problem = mjslq.Problem(dynamics, 20, dynamics.initial_state, [mjslq.costs.Control(0.01), term])
    rng, e = np.random.default_rng(0), 1e-5
    U, direction = rng.normal(size=(2, 20, 2))
    ahead, behind = (problem.cost(problem.rollout(U + s * e * direction)) for s in (1.0, -1.0))
    slope = np.vdot(problem.gradient(problem.rollout(U)), direction)
    np.testing.assert_allclose(slope, (ahead - behind) / (2.0 * e), rtol=1e-6)


def test_continuous_joints_are_angles(urdf):
    dynamics = mjslq.PinocchioDynamics.from_path(urdf, 0.01)
    assert (dynamics.nx, dynamics.nu) == (4, 2) and dynamics.damping.tolist() == [0.3, 0.0]
    np.testing.assert_array_equal(dynamics.control_limits, [[-np.inf, np.inf], [-7.0, 7.0]])
    assert dynamics.difference_jacobian(dynamics.initial_state, dynamics.initial_state) is None


def test_other_joints_of_a_given_model():
    """A spherical joint and an unbounded one (cosine, sine), and controls on one of them only."""
    model, body = pin.Model(), pin.Inertia(1.0, np.array([0.1, 0.0, 0.2]), 0.1 * np.eye(3))
    ball = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(ball, body, pin.SE3.Identity())
    wheel = model.addJoint(ball, pin.JointModelRUBX(), pin.SE3(np.eye(3), np.array([0.3, 0.0, 0.0])), "wheel")
    model.appendBodyToJoint(wheel, body, pin.SE3.Identity())
    dynamics = mjslq.PinocchioDynamics.from_model(model, 0.01, actuated=("wheel",))
    assert (dynamics.nx, dynamics.ndx, dynamics.nu) == (10, 8, 1) and dynamics.control_names == ("wheel",)
    assert dynamics.state_names[:5] == ("ball.qx", "ball.qy", "ball.qz", "ball.qw", "wheel[0]")
    assert dynamics.check_derivatives(moving(dynamics)).worst_error < 1e-9
    assert dynamics.scene() is None


def test_locked_joints(urdf):
    free = mjslq.PinocchioDynamics.from_path(urdf, 0.01, outputs=("hand",))
    locked = mjslq.PinocchioDynamics.from_path(urdf, 0.01, {"elbow": 0.7}, outputs=("hand",))
    assert locked.control_names == ("shoulder",)
    y = locked.step(np.array([0.3, 0.0]), np.zeros(1))[1]
    np.testing.assert_allclose(y, free.step(np.array([0.3, 0.7, 0.0, 0.0]), np.zeros(2))[1], atol=1e-15)


def test_holding_controls(urdf):
    dynamics = mjslq.PinocchioDynamics.from_path(urdf, 0.01)
    x0 = np.array([0.4, -0.3, 0.0, 0.0])
    trajectory = dynamics.rollout(x0, np.tile(dynamics.holding_controls(x0), (50, 1)))
    np.testing.assert_allclose(trajectory.X, np.tile(x0, (51, 1)), atol=1e-12)


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("floating", [False, True])
def test_a_rollout_that_blows_up_says_where(urdf, integrator, floating):
    dynamics = solo(integrator) if floating else mjslq.PinocchioDynamics.from_path(urdf, 0.01, outputs=("hand",))
    U = np.zeros((6, dynamics.nu))
    U[2] = 1e200
    trajectory = dynamics.rollout(dynamics.initial_state, U)
    assert trajectory.diverged_at == 3
    assert np.isfinite(trajectory.Y[:3]).all() and np.isnan(trajectory.X[3:]).all()
    with pytest.raises(ValueError, match="diverged at knot 3"):
        dynamics.linearize(trajectory)


def test_equal_inputs_equal_results():
    dynamics = solo()
    first = moving(dynamics)
    dynamics.linearize(moving(dynamics, seed=5))
    np.testing.assert_array_equal(moving(dynamics).X, first.X)
    np.testing.assert_array_equal(dynamics.linearize(first).A, dynamics.linearize(first).A)


def test_report(urdf):
    report = dict(mjslq.PinocchioDynamics.from_path(urdf, 0.01, outputs=("hand",)).support_report())
    assert report["joint damping"].startswith("implicit") and "output hand" in report


@pytest.mark.parametrize(
    "options, said",
    [
        ({"outputs": ("hnd",)}, "unknown frame 'hnd'; similar ones are: hand"),
        ({"outputs": "hand"}, "write \\('hand',\\)"),
        ({"outputs": ("hand", "hand")}, "outputs must differ"),
        ({"locked_joints": ("elbo",)}, "joint to lock 'elbo'; there are: shoulder, elbow; did you mean 'elbow'"),
        ({"locked_joints": "elbow"}, "write \\('elbow',\\)"),
        ({"actuated": ("hip",)}, "unknown joint to actuate 'hip'; there are: shoulder, elbow"),
        ({"actuated": ("elbow", "elbow")}, "each joint once"),
        ({"integrator": "euler"}, "there are: semi-implicit-euler, rk4"),
        ({"armature": {"hip": 1.0}}, "unknown joint in armature 'hip'"),
        ({"damping": -1.0}, "damping of joint 'shoulder' must not be negative"),
        ({"timestep": 0.0}, "timestep must be positive"),
    ],
)
def test_refusals(urdf, options, said):
    with pytest.raises(ValueError, match=said):
        mjslq.PinocchioDynamics.from_path(urdf, **({"timestep": 0.01} | options))


def test_files_that_are_none(tmp_path, urdf):
    make = mjslq.PinocchioDynamics.from_path
    with pytest.raises(ValueError, match="does not exist"):
        make(tmp_path / "no.urdf", 0.01)
    (tmp_path / "a.urdf").write_text("<mujoco/>")
    with pytest.raises(ValueError, match="outermost element is <mujoco>"):
        make(tmp_path / "a.urdf", 0.01)
    (tmp_path / "b.urdf").write_text("robot")
    with pytest.raises(ValueError, match="no valid XML"):
        make(tmp_path / "b.urdf", 0.01)
    with pytest.raises(ValueError, match=r"must be a pinocchio\.Model"):
        mjslq.PinocchioDynamics.from_model(urdf, 0.01)


def test_states_that_are_none():
    dynamics = solo()
    with pytest.raises(ValueError, match="entries 3 to 6 of the state are a quaternion and must not be all zero"):
        dynamics.rollout(np.zeros(37), np.zeros((2, 12)))
    x0 = dynamics.initial_state
    x0[3:7] *= 3.0
    np.testing.assert_allclose(dynamics.rollout(x0, np.zeros((1, 12))).X[0], dynamics.initial_state, atol=1e-15)
    with pytest.raises(ValueError, match="these dynamics have 37 and 12"):
        dynamics.linearize(mjslq.Trajectory(np.zeros((2, 3)), np.zeros((1, 1))))


def test_a_joint_without_mass_is_named(tmp_path):
    (tmp_path / "c.urdf").write_text(ARM.replace('<mass value="1"/>', '<mass value="0"/>').replace("0.005", "0")
                                     .replace('ixx="0.01" iyy="0.01"', 'ixx="0" iyy="0"'))  # fmt: skip
    with pytest.raises(
        ValueError, match=r"'elbow' moves no mass \(links .*: lower, hand\); lock it, or give it armature"
    ):
        mjslq.PinocchioDynamics.from_path(tmp_path / "c.urdf", 0.01)
    mjslq.PinocchioDynamics.from_path(tmp_path / "c.urdf", 0.01, armature=0.1)


def test_solves_with_a_floating_base():
    dynamics = solo(outputs=("FL_FOOT",), damping=0.05)
    target = dynamics.step(dynamics.initial_state, np.zeros(12))[1] + np.array([0.05, 0.02, 0.0])
    costs = [mjslq.costs.Control(1e-2), mjslq.costs.State(0.1, dynamics.initial_state, "always"),
             mjslq.costs.Sensor("FL_FOOT", target, 1e4, "terminal")]  # fmt: skip
    result = mjslq.solve(mjslq.Problem(dynamics, 15, dynamics.initial_state, costs))
    assert result.success, result.message
    np.testing.assert_allclose(result.trajectory.Y[-1], target, atol=5e-3)
