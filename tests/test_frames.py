"""Frames as costs and constraints: read by sensors that the engine adds, or that the model has."""

import mujoco
import numpy as np
import pytest

import mjslq
from mjslq import constraints, costs
from mjslq.dynamics.mujoco.frames import frame_motion, frame_names
from mjslq.reports.errors import lines, task_errors

ARM = """
<mujoco model="arm">
  <option timestep="0.02"/>
  <worldbody>
    <body name="base" pos="0 0 1"><freejoint name="root"/>
      <geom name="trunk" type="box" size=".2 .1 .1" pos=".03 0 0" mass="2"/>
      <body name="arm" pos=".2 0 0"><joint name="shoulder" axis="0 1 0" damping=".1"/>
        <geom name="bone" type="capsule" fromto="0 0 0 .4 0 .1" size=".02" mass=".5"/>
        <site name="tip" pos=".4 0 .1" euler="20 30 0"/>
        <camera name="eye" pos=".1 0 .2" euler="0 40 10"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="m" joint="shoulder"/></actuator>
  <sensor>
    <framepos name="far" objtype="site" objname="tip" reftype="body" refname="base"/>
    <framepos name="mass" objtype="body" objname="arm"/>
    <framepos name="end" objtype="site" objname="tip"/>
  </sensor>
</mujoco>
"""
FRAMES = ("base", "arm", "bone", "tip", "eye")
OF = ("position", "orientation", "linear-velocity", "angular-velocity")
N = 6


@pytest.fixture(scope="module")
def arm():
    return mjslq.MujocoDynamics.from_xml(ARM, frames=FRAMES)


def moving(dynamics, seed=0):
    rng = np.random.default_rng(seed)
    x0 = dynamics.integrate(dynamics.initial_state, rng.standard_normal(dynamics.ndx))
    return dynamics.rollout(x0, rng.standard_normal((N, 1)))


def test_frames_are_read_as_mujoco_has_them(arm):
    """Against the poses in mjData, and against differences of these over a short time."""
    along, model, e = moving(arm), arm.model, 1e-6
    found = frame_motion(model, along.X, FRAMES)
    ahead = frame_motion(model, arm.integrate(along.X, e * velocities(arm, along.X)), FRAMES)
    behind = frame_motion(model, arm.integrate(along.X, -e * velocities(arm, along.X)), FRAMES)
    for frame in FRAMES:
        for of in OF:
            columns, quaternion = arm.outputs[arm.frame_output(frame, of)]
            reading = along.Y[:, columns]
            if quaternion:
                reading = reading * np.sign((reading * found[frame][of]).sum(axis=1))[:, None]
            np.testing.assert_allclose(found[frame][of], reading, rtol=0, atol=1e-12)
        speed = (ahead[frame]["position"] - behind[frame]["position"]) / (2 * e)
        np.testing.assert_allclose(found[frame]["linear-velocity"], speed, rtol=0, atol=1e-7)
        turned = np.zeros((N + 1, 3))
        for n, (q, p) in enumerate(zip(ahead[frame]["orientation"], behind[frame]["orientation"], strict=True)):
            difference = np.empty(3)
            mujoco.mju_subQuat(difference, q, p)  # in the frame's own axes
            mujoco.mju_rotVecQuat(turned[n], difference, p)
        np.testing.assert_allclose(found[frame]["angular-velocity"], turned / (2 * e), rtol=0, atol=1e-6)


def velocities(dynamics, X):
    return np.hstack([X[:, dynamics.model.nq :], np.zeros((len(X), dynamics.nv))])


def test_a_frame_cost_is_that_of_its_sensor(arm):
    along = moving(arm)
    for frame, of, size in (("tip", "position", 3), ("eye", "orientation", 4), ("arm", "linear-velocity", 3)):
        target = np.arange(1.0, size + 1)
        frames = [costs.Frame(frame, target, 3.0, "always", of=of, loss="huber", terminal_weight=2.0)]
        sensors = [costs.Sensor(f"{frame}.{of}", target, 3.0, "always", "huber", terminal_weight=2.0)]
        ours, theirs = (mjslq.Problem(arm, N, arm.initial_state, terms) for terms in (frames, sensors))
        assert ours.cost(along) == theirs.cost(along) > 0.0
        np.testing.assert_array_equal(ours.gradient(along), theirs.gradient(along))


def test_a_sensor_of_the_model_is_found_whatever_it_is_called():
    plain = mjslq.MujocoDynamics.from_xml(ARM)
    assert plain.frame_output("tip", "position") == "end"  # not "far", which is relative to the base
    with pytest.raises(ValueError, match=r"no sensor reads the position of 'arm'; make the engine with frames="):
        plain.frame_output("arm", "position")  # "mass" reads its centre of mass
    with pytest.raises(ValueError, match=r"unknown site, body, geom or camera 'tipp'.*did you mean 'tip'"):
        plain.frame_output("tipp", "position")
    some = mjslq.MujocoDynamics.from_xml(ARM, frames={"arm": ["position"], "eye": "orientation"})
    assert list(some.outputs) == ["far", "mass", "end", "arm.position", "eye.orientation"]
    assert set(frame_names(plain.model)) == {*FRAMES, "trunk"}


def test_engines_from_files_and_specifications_take_frames(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    spec = mujoco.MjSpec.from_string(ARM)
    by_path = mjslq.MujocoDynamics.from_path(tmp_path / "arm.xml", frames=["bone"])
    by_spec = mjslq.MujocoDynamics.from_spec(spec, frames=["bone"])
    assert list(by_path.outputs) == list(by_spec.outputs) and len(spec.sensors) == 3
    mujoco.mj_saveModel(by_path.model, str(tmp_path / "arm.mjb"))
    with pytest.raises(ValueError, match=r"arm.mjb is binary, so that it takes no sensors"):
        mjslq.MujocoDynamics.from_path(tmp_path / "arm.mjb", frames=["bone"])
    with pytest.raises(ValueError, match="a compiled model takes no sensors"):
        mjslq.MujocoDynamics.from_model(by_path.model, frames=["bone"])
    with pytest.raises(ValueError, match="frames must be a list of names, got the text 'bone'"):
        mjslq.MujocoDynamics.from_xml(ARM, frames="bone")
    with pytest.raises(ValueError, match="unknown quantity of frame 'bone' 'speed'; there are: position"):
        mjslq.MujocoDynamics.from_xml(ARM, frames={"bone": ["speed"]})


def test_a_frame_constraint_is_that_of_its_sensor(arm):
    along = moving(arm)
    limit = constraints.Frame("tip", [0.1, -np.inf, -np.inf], when=slice(1, 4))
    speed = constraints.Frame("arm", None, lambda t: 0.1 + t, of="angular-velocity")
    problem = mjslq.Problem(arm, N, arm.initial_state, [costs.Control(1.0)], constraints=[limit, speed])
    twin = [constraints.Sensor("tip.position", [0.1, -np.inf, -np.inf], when=slice(1, 4)),
            constraints.Sensor("arm.angular-velocity", None, lambda t: 0.1 + t)]  # fmt: skip
    other = mjslq.Problem(arm, N, arm.initial_state, [costs.Control(1.0)], constraints=twin)
    ours, theirs = problem.violations(along), other.violations(along)
    assert list(ours) == list(theirs) == ["tip.position", "arm.angular-velocity"]
    for name in ours:
        np.testing.assert_array_equal(ours[name], theirs[name])
    with pytest.raises(ValueError, match="orientation, whose entries have no limits"):
        constraints.Frame("tip", 0.0, of="orientation").bind(arm, N, "turn")


def test_pinocchio_reads_positions_and_orientations():
    path = mjslq.robot_path("panda")
    panda = mjslq.PinocchioDynamics.from_path(path, 0.01, outputs=("panda_hand_tcp", "panda_hand_tcp.orientation"))
    assert panda.frame_output("panda_hand_tcp", "orientation") == "panda_hand_tcp.orientation"
    problem = mjslq.Problem(
        panda, N, panda.initial_state, [costs.Frame("panda_hand_tcp", [1.0, 0.0, 0.0, 0.0], of="orientation")]
    )
    assert [str(e).split()[1] for e in task_errors(problem, problem.rollout(np.zeros(panda.nu)))] == ["rad"]
    for frame, of, told in (
        ("panda_hand_tcp", "linear-velocity", "positions and orientations, not a frame's linear-velocity"),
        ("panda_link4", "position", r"no output reads the position of 'panda_link4'; make the engine with outputs="),
        ("panda_link44", "position", "unknown frame 'panda_link44'"),
    ):
        with pytest.raises(ValueError, match=told):
            panda.frame_output(frame, of)


def test_engines_without_frames_and_unknown_quantities_are_told(arm):
    mass = mjslq.FunctionDynamics(lambda x, u: x + u, 1, 1, 0.1)
    with pytest.raises(ValueError, match="FunctionDynamics has no frames"):
        mjslq.Problem(mass, N, [0.0], [costs.Frame("hand", 0.0)])
    with pytest.raises(ValueError, match="unknown quantity of a frame 'speed'; there are: position, orientation"):
        mjslq.Problem(arm, N, arm.initial_state, [costs.Frame("tip", 0.0, of="speed")])


def test_a_summary_tells_few_frames_one_by_one_and_many_together(arm):
    along = moving(arm)
    few = [costs.Frame(name, along.Y[-1, arm.outputs[f"{name}.position"].columns], when="terminal") for name in FRAMES]
    told = lines(task_errors(mjslq.Problem(arm, N, arm.initial_state, few[:4]), along))
    assert list(told) == [f"{name}.position" for name in FRAMES[:4]]
    few[2] = costs.Frame("bone", few[2].target + np.array([0.0, 0.3, 0.4]), when="terminal")
    told = lines(task_errors(mjslq.Problem(arm, N, arm.initial_state, few), along))
    assert told == {"5 frames, position": "0.1 m off on average, 0.5 m at most (bone)"}
