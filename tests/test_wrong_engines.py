"""Wrong engines: functions that return something else, models that cannot be simulated, files that are no models."""

import mujoco
import numba
import numpy as np
import pytest
from wrong_inputs import ARM, MODEL, PENDULUM, one_sentence, pose, refused, table

import mjslq
from mjslq import FunctionDynamics, MujocoDynamics, PinocchioDynamics, Status, costs, problems, robot_path, solve

nan = float("nan")
UR5 = robot_path("ur5")


def system(f=lambda x, u: -x, **options):
    return FunctionDynamics(f, 2, 1, 0.1, **options)


def late(value):
    """A function that returns something else from 0.3 s on."""
    return lambda x, u, t: x if t < 0.29 else value


def raising(x, u):
    raise RuntimeError("boom\nbang")


def rolled(f):
    return lambda: system(f, integrator="map").rollout([0.0, 0.0], np.zeros((5, 1)))


def arm(old="", new="", **options):
    return lambda: MujocoDynamics.from_xml(ARM.replace(old, new) if old else ARM, **options)


def written(**fields):
    """A compiled model into which a user has written."""

    def make():
        model = mujoco.MjModel.from_xml_string(ARM)
        for name, value in fields.items():
            getattr(model, name)[...] = value
        return MujocoDynamics.from_model(model)

    return make


def at_step(h):
    def make():
        model = mujoco.MjModel.from_xml_string(ARM)
        model.opt.timestep = h
        return MujocoDynamics.from_model(model)

    return make


def ur5(timestep=0.01, locked=None, **options):
    return lambda: PinocchioDynamics.from_path(UR5, timestep, locked, **options)


@table(
    ("f none", lambda: system(lambda x, u: None), "f must return numbers", "got NoneType None"),
    ("f text", lambda: system(lambda x, u: "x"), "f must return numbers", "got str 'x'"),
    ("f table", lambda: system(lambda x, u: {}), "f must return numbers", "got dict {}"),
    ("f ragged", lambda: system(lambda x, u: [[1], [1, 2]]), "f must return numbers", "got list"),
    ("f complex", lambda: system(lambda x, u: x * 1j), "f must return real numbers"),
    ("f shape", lambda: system(lambda x, u: x[:1]), "f must return shape (2,), got (1,)"),
    ("f number", lambda: system(lambda x, u: 0.0), "f must return shape (2,), got ()"),
    ("f raises", lambda: system(raising), "f fails for x of shape (2,)", "RuntimeError: boom bang"),
    ("f divides", lambda: system(lambda x, u: 1 / 0), "f fails", "division by zero"),
    ("f writes", lambda: system(lambda x, u: np.multiply(x, 2, out=x)), "f fails", "read-only"),
    ("f compiled", lambda: system(numba.njit(lambda x, u: x + "a")), "f cannot be compiled by numba: "),
    ("f none later", rolled(late(None)), "f must return numbers, got NoneType None at t = 0.3"),
    ("f text later", rolled(late("x")), "f must return numbers, got str 'x' at t = 0.3"),
    ("f shape later", rolled(lambda x, u, t: x if t < 0.29 else x[:1]), "f must return shape (2,), got (1,) at t"),
    ("outputs text", lambda: system(outputs="all"), "outputs must be a function", "got str 'all'"),
    ("outputs none", lambda: system(outputs=lambda x, u: None), "outputs must return numbers"),
    ("outputs later", lambda: system(outputs=lambda x, u, t: x if t < 0.3 else x[:1]).rollout([0, 0], np.zeros((5, 1))),
     "outputs must return shape (2,), got (1,) at t = "),
    ("hessian text", lambda: system(hessian="exact"), "hessian must be a function", "got str 'exact'"),
    ("jacobian none", lambda: system(jacobian=lambda x, u, t: None).linearize(PENDULUM.rollout([0, 0], [[0.0]])),
     "jacobian must return A and B of shapes (2, 2) and (2, 1), got NoneType None"),
    ("jacobian one", lambda: system(jacobian=lambda x, u, t: np.eye(2)).linearize(PENDULUM.rollout([0, 0], [[0.0]])),
     "jacobian must return A and B", "got ndarray"),
    ("limits reversed", lambda: system(control_limits=(1, -1)), "lower <= upper, but control 0 has 1.0 and -1.0"),
    ("limits text", lambda: system(control_limits="model"), "control_limits must be an array of numbers"),
    ("names number", lambda: system(state_names=3), "state_names must be a list of 2 names, got int 3"),
    ("names text", lambda: system(state_names="ab"), "state_names must be a list of 2 names, got str 'ab'"),
    ("names numbers", lambda: system(state_names=(1, 2)), "state_names must be texts", "got int 1 at 0"),
    ("names twice", lambda: system(state_names=("a", "a")), "texts that differ from each other", "'a' at 1"),
)  # fmt: skip
def test_functions(call, fragments):
    refused(call, *fragments)


@table(
    ("timestep 0", arm(timestep=0), "timestep must be positive and finite, got 0"),
    ("timestep nan", arm(timestep=nan), "timestep must be positive and finite, got nan"),
    ("timestep text", arm(timestep="1ms"), "timestep must be a number, got str '1ms'"),
    ("substeps 0", arm(substeps=0), "substeps must be a whole number of at least 1", "0"),
    ("substeps float", arm(substeps=1.5), "substeps must be a whole number", "got float 1.5"),
    ("threads 0", arm(threads=0), "threads must be a whole number of at least 1, got int 0"),
    ("threads text", arm(threads="all"), "threads must be a whole number", "got str 'all'"),
    ("jacobian", arm(jacobian="exact"), "unknown jacobian 'exact'; there are: auto, inverse, transition"),
    ("integrator", arm(integrator="rk5"), "unknown integrator 'rk5'; there are: Euler, implicit"),
    ("contact", arm(contact="soft"), "unknown contact 'soft'; there are: model, smooth, stiff"),
    ("keyframe", lambda: MODEL.keyframe("hme"), "unknown keyframe 'hme'; there are: home; did you mean 'home'?"),
    ("keyframe index", lambda: MODEL.keyframe(0), "unknown keyframe 0; there are: home"),
    ("mass zero", arm('mass="1"', 'mass="0"'), "MuJoCo cannot make a model", "mass and inertia", "'arm'"),
    ("mass negative", arm('mass="1"', 'mass="-1"'), "MuJoCo cannot make a model", "negative"),
    ("range reversed", arm("-1 1", "1 -1"), "range[0] should be smaller than range[1]", "'j'"),
    ("ctrlrange reversed", arm("-2 2", "2 -2"), "actuator 'm' must have a ctrlrange from low to high, got 2 -2"),
    ("mass nan", written(body_mass=nan), "the model must be finite, but body_mass[0] is nan"),
    ("damping nan", written(dof_damping=nan), "the model must be finite, but dof_damping[0] is nan"),
    ("position nan", written(geom_pos=nan), "the model must be finite, but geom_pos[0][0] is nan"),
    ("gain nan", written(actuator_gainprm=nan), "the model must be finite, but actuator_gainprm"),
    ("step nan", at_step(nan), "the model's timestep must be positive and finite, got nan"),
    ("step 0", at_step(0.0), "the model's timestep must be positive and finite, got 0"),
    ("no joints", lambda: MujocoDynamics.from_xml("<mujoco/>"), "it has no joints, so nothing can move"),
    ("no XML", lambda: MujocoDynamics.from_xml("<mujoco>"), "MuJoCo cannot make a model of the XML text: "),
    ("controls", lambda: MODEL.rollout([0.0, 0.0], np.zeros((3, 2))), "U must have shape (N, 1), got (3, 2)"),
    ("no actuators", lambda: solve(pose(dynamics=MujocoDynamics.from_xml(ARM.split("<actuator>")[0] + "</mujoco>"))),
     "this model has no controls"),
    ("robot", lambda: robot_path("pnda"), "unknown robot 'pnda'", "did you mean 'panda'?"),
    ("robot none", lambda: robot_path(None), "unknown robot None; there are: "),
    ("contact width", lambda: mjslq.Contact("smooth", width=-1), "width must be positive and finite, got -1"),
    ("contact of the model", lambda: mjslq.Contact("model", width=1.0), "keeps the model's own parameters"),
    ("pinocchio timestep", ur5(0), "timestep must be positive and finite, got 0"),
    ("pinocchio no timestep", ur5(None), "timestep must be a number, got NoneType None"),
    ("frame", ur5(outputs=("hand",)), "unknown frame 'hand'; there are: "),
    ("outputs text", ur5(outputs="ee_link"), "outputs must be a sequence of frame names, got the text 'ee_link'"),
    ("locked", ur5(locked=["elbow"]), "unknown joint to lock 'elbow'", "did you mean 'elbow_joint'?"),
    ("locked nan", ur5(locked={"elbow_joint": nan}), "locked_joints['elbow_joint'] must be finite"),
    ("armature", ur5(armature=-1), "armature of joint 'shoulder_pan_joint' must not be negative, got -1"),
    ("pinocchio integrator", ur5(integrator="rk5"), "unknown integrator 'rk5'; there are: semi-implicit-euler, rk4"),
    ("problem", lambda: problems.get("hoper"), "unknown problem 'hoper'; there are: ", "did you mean 'hopper'?"),
    ("problem none", lambda: problems.get(None), "unknown problem None; there are: "),
    ("parameter", lambda: problems.get("hopper", heigth=2), "unknown parameter of hopper 'heigth'", "'height'?"),
    ("parameter text", lambda: problems.get("hopper", height="tall"), "height must be a number such as 20.0"),
    ("parameter nan", lambda: problems.get("hopper", height=nan), "height must be finite"),
    ("parameter negative", lambda: problems.get("hopper", alpha=-1), "alpha must be positive and finite, got -1"),
)  # fmt: skip
def test_models(call, fragments):
    refused(call, *fragments)


@pytest.mark.parametrize("engine", [MujocoDynamics.from_path, lambda file: PinocchioDynamics.from_path(file, 0.01)])
@pytest.mark.parametrize(
    "name, content, fragment",
    [
        ("none.urdf", None, "does not exist; give the path of a"),
        ("folder.urdf", ..., "is a folder; give the path of a"),
        ("empty.urdf", b"", "it is no valid XML"),
        ("text.urdf", b"nonsense", "it is no valid XML"),
        ("bytes.urdf", bytes(range(256)), "it is no valid XML"),
        ("cut.urdf", b"<robot name='r'><link", "it is no valid XML"),
        ("jointless.urdf", b"<robot name='r'><link name='a'/></robot>", "it has no joints"),
    ],
)
def test_files_of_models(engine, name, content, fragment, tmp_path):
    if content is ...:
        (tmp_path / name).mkdir()
    elif content is not None:
        (tmp_path / name).write_bytes(content)
    refused(lambda: engine(tmp_path / name), fragment)


@table(
    ("html", ("page.xml", b"<html><body>404</body></html>"), "Unrecognized XML model type: 'html'"),
    ("include", ("inc.xml", b"<mujoco><include file='gone.xml'/></mujoco>"), "Error opening file 'gone.xml'"),
    ("mesh", ("mesh.xml", b"<mujoco><asset><mesh name='m' file='gone.stl'/></asset></mujoco>"), "gone.stl"),
    ("binary", ("b.mjb", bytes(range(256))), "b.mjb: it is no binary model (.mjb)"),
    ("empty binary", ("e.mjb", b""), "e.mjb: it is no binary model (.mjb)"),
)
def test_files_of_mujoco(call, fragments, tmp_path):
    name, content = call
    (tmp_path / name).write_bytes(content)
    refused(lambda: MujocoDynamics.from_path(tmp_path / name), "MuJoCo cannot make a model of", *fragments)


@pytest.mark.parametrize("given", [None, 3, b"arm.xml"])
def test_what_is_no_path(given):
    refused(lambda: MujocoDynamics.from_path(given), "from_path takes the path of an .xml, .urdf or .mjb file, got")


BLOWN = FunctionDynamics(lambda x, u: x * 1e30 + u, 2, 1, 0.1)
STIFF = ARM.replace("0.02", "0.5").replace("axis=", 'stiffness="-1e8" axis=')


@table(
    ("function", lambda: pose(dynamics=BLOWN, horizon=50, x0=[1, 1]), "The start blew up at step 1"),
    ("model", lambda: pose(dynamics=MujocoDynamics.from_xml(STIFF), x0=[0.1, 0.0]), "The start blew up at step"),
    ("nan", lambda: pose(dynamics=system(lambda x, u: x * nan)), "The start blew up at step 1"),
    ("cost nan", lambda: pose(costs.Function(lambda x, u, t: nan)), "The cost of the start is not finite"),
    ("cost inf", lambda: pose(costs.Function(lambda x, u, t: np.inf)), "The cost of the start is not finite"),
    ("jacobian nan", lambda: pose(dynamics=system(jacobian=lambda x, u, t: (np.full((2, 2), nan), np.ones((2, 1))))),
     "derivatives along the trajectory are not finite"),
)  # fmt: skip
def test_what_blows_up_at_once_is_an_ending_with_advice(call, fragments):
    result = solve(call())
    assert result.status is Status.DIVERGED
    one_sentence(result.message, "check the cost", *fragments)


def failing_later(f):
    system = FunctionDynamics(f, 2, 1, 0.1, jacobian="finite-difference")
    return pose(costs.State(1.0, None, "terminal"), dynamics=system, x0=[1.0, 1.0])


@table(
    ("f raises", lambda: failing_later(lambda x, u: x + u if abs(u[0]) < 1e-4 else 1 / 0), "division by zero"),
    ("f text", lambda: failing_later(lambda x, u: x + u if abs(u[0]) < 1e-4 else "a"), "f must return numbers"),
    ("jacobian none", lambda: pose(costs.Residual(lambda x, u, t: x, jacobian=lambda x, u, t: None)),
     "jacobian must return shape (2, 2) and (2, 1), got NoneType None"),
    ("jacobian shape", lambda: pose(costs.Residual(lambda x, u, t: x, jacobian=lambda x, u, t: (np.eye(3), 0.0))),
     "jacobian must return shape (2, 2) and (2, 1), got (3, 3) and ()"),
    ("hessian shape", lambda: pose(costs.Function(lambda x, u, t: x @ x, gradient=lambda x, u, t: (2 * x, 0 * u),
                                                  hessian=lambda x, u, t: np.eye(2)), x0=[1.0, 1.0]),
     "hessian must return shape (3, 3), got (2, 2)"),
)  # fmt: skip
def test_what_fails_during_a_solve_keeps_the_best_iterate(call, fragments):
    problem = call()
    result = solve(problem)
    assert result.status is Status.FAILED and "Traceback" in result.error
    one_sentence(result.message, "An error ended the solve; this is the best iterate so far", *fragments)
    assert np.isfinite(result.cost) and result.cost == problem.cost(result.trajectory)
