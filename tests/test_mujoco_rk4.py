"""MuJoCo's Runge-Kutta integrator, the choice of integrators, and models without actuators."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import mjslq
from mjslq.dynamics.derivative_check import compare_jacobians, fine_reference
from mjslq.dynamics.mujoco import MujocoDynamics

HEAD = '<mujoco><option integrator="RK4" timestep=".01" tolerance="0" iterations="200" ls_iterations="200"/><worldbody>'
MODELS = {
    "acrobot": """<body><joint name="a" axis="0 1 0" damping=".1"/><geom type="capsule" fromto="0 0 0 0 0 -1"
        size=".05" mass="1"/><body pos="0 0 -1"><joint name="b" axis="0 1 0" damping="3 1" stiffness="2"/>
        <geom type="capsule" fromto="0 0 0 0 0 -1" size=".05" mass="1"/><site name="s" pos="0 0 -1"/></body></body>
        </worldbody><actuator><motor joint="b"/></actuator>
        <sensor><framepos objtype="site" objname="s"/><jointvel joint="b"/></sensor></mujoco>""",
    "cartpole": """<body><joint name="x" type="slide" axis="1 0 0" damping=".05"/><geom type="box" size=".1 .1 .1"
        mass="1" contype="0"/><body><joint name="p" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .6"
        size=".03" mass=".1" contype="0"/></body></body></worldbody>
        <actuator><position joint="x" kp="20" kv="2" ctrlrange="-1 1"/></actuator></mujoco>""",
    "free": """<body><freejoint/><geom type="box" size=".1 .2 .3" mass="2"/><site name="s" pos="0 .1 .2"/>
        <body pos="0 0 .4"><joint name="c" type="ball" damping=".2"/><geom type="ellipsoid" size=".05 .1 .2"
        pos="0 0 .2"/></body></body></worldbody><actuator><general site="s" gear="0 0 1 0 0 .3" dyntype="filter"
        dynprm=".05" actlimited="true" actrange="-1 .3"/></actuator></mujoco>""",
    "contact": """<geom type="plane" size="5 5 1"/><body pos="0 0 .099"><freejoint/><geom size=".1" mass="1"
        solimp="0 .95 .02"/><body pos="0 0 .1"><joint name="j" axis="0 1 0"/><geom size=".05" pos=".1 0 .1"
        contype="0"/></body></body></worldbody><actuator><motor joint="j"/></actuator></mujoco>""",
    "exact filter": """<body><joint name="a" axis="0 1 0"/><geom size=".1" pos=".3 0 0"/></body></worldbody>
        <actuator><general joint="a" dyntype="filterexact" dynprm=".05"/></actuator></mujoco>""",
}
CHAINED = [name for name in MODELS if name != "exact filter"]


def engine(name: str, jacobian: str = "transition", substeps: int = 1) -> MujocoDynamics:
    return MujocoDynamics.from_xml(HEAD + MODELS[name], jacobian=jacobian, substeps=substeps, threads=1)


def motion(dynamics: MujocoDynamics, name: str, N: int = 6) -> mjslq.Trajectory:
    rng = np.random.default_rng(1)
    spread = 0.0 if name == "contact" else 0.5
    x0 = dynamics.integrate(dynamics.initial_state, spread * rng.normal(size=dynamics.ndx))
    return dynamics.rollout(x0, 0.3 * rng.normal(size=(N, dynamics.nu)))


def errors(dynamics: MujocoDynamics, name: str) -> dict[str, float]:
    trajectory = motion(dynamics, name)
    fine = fine_reference(dynamics, trajectory, 1e-6 if name == "contact" else 1e-4)
    return compare_jacobians(dynamics.linearize(trajectory), fine).errors


@pytest.mark.parametrize("name", MODELS)
def test_rollouts_are_mujocos_own_steps(name):
    dynamics = engine(name, substeps=2)
    trajectory, model = motion(dynamics, name), mujoco.MjModel.from_xml_string(HEAD + MODELS[name])
    data = mujoco.MjData(model)
    data.qpos, data.qvel, data.act = np.split(trajectory.X[0], [model.nq, model.nq + model.nv])
    for x, u in zip(trajectory.X[1:], trajectory.U, strict=True):
        data.ctrl = u
        mujoco.mj_step(model, data, 2)
        np.testing.assert_array_equal(np.concatenate([data.qpos, data.qvel, data.act]), x)


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("name", MODELS)
def test_jacobians_by_differences_of_the_step(name, substeps):
    found = errors(engine(name, substeps=substeps), name)
    assert max(found.values()) < 1e-7, found


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("name", CHAINED)
def test_jacobians_by_the_chain_of_stages(name, substeps):
    found = errors(engine(name, "inverse", substeps), name)
    assert max(found.values()) < (1e-8 if name == "contact" else 1e-9), found


def test_steps_that_do_not_follow_each_other():
    dynamics = engine("free", "inverse")
    X, U = motion(dynamics, "free").X, np.zeros((3, 1))
    X = X[[0, 4, 2, 1]]
    F = dynamics.step_each(X, U)[0]
    ours, other = dynamics.linearize_steps(X, U, F), engine("free").linearize_steps(X, U, F)
    np.testing.assert_allclose(ours.A, other.A, atol=1e-7)


def test_activations_beyond_their_range_have_no_derivative():
    dynamics = engine("free", "inverse")
    x = dynamics.initial_state
    x[-1] = 0.3
    B = dynamics.linearize(dynamics.rollout(x, np.array([[5.0]]))).B[0]
    assert B[-1, 0] == 0.0 and np.abs(B[:-1, 0]).max() > 0.0


def test_what_does_not_chain_goes_by_differences():
    dynamics = engine("exact filter", "auto")
    assert dynamics.jacobian == "transition"
    assert "RK4 advances its activations" in dict(dynamics.support_report())['no jacobian="inverse"']
    with pytest.raises(ValueError, match="RK4 advances its activations"):
        engine("exact filter", "inverse")
    assert engine("acrobot", "auto").jacobian == "inverse"
    assert dict(engine("acrobot", "inverse").support_report())["integrator RK4"].endswith("stages chained")


def test_controls_at_their_limits_are_moved_to_the_inside():
    dynamics = engine("cartpole")
    B = dynamics.linearize(dynamics.rollout(np.zeros(4), np.array([[1.0], [0.5], [-1.0], [1.5]]))).B
    np.testing.assert_allclose(B[[0, 2], :, 0], B[[1, 1], :, 0], rtol=1e-2, atol=1e-6)
    assert (B[3] == 0.0).all()


@pytest.mark.parametrize(
    "name, number", [("rk4", 1), ("RK4", 1), ("euler", 0), ("Implicit", 2), ("IMPLICITFAST", 3), ("discrete", 4)]
)
def test_the_integrator_can_be_chosen(name, number):
    text = HEAD.replace("RK4", "Euler") + MODELS["acrobot"]
    model = mujoco.MjModel.from_xml_string(text)
    dynamics = MujocoDynamics.from_model(model, integrator=name)
    assert dynamics.model.opt.integrator == number and model.opt.integrator == 0
    other = MujocoDynamics.from_xml(text, integrator=name)
    assert other.model.opt.integrator == number


@pytest.mark.parametrize("name", ["rk5", 3])
def test_unknown_integrators_are_refused(name):
    with pytest.raises(
        ValueError, match=r"unknown integrator .*; there are: Euler, implicit, implicitfast, discrete, RK4"
    ):
        MujocoDynamics.from_xml(HEAD + MODELS["acrobot"], integrator=name)


@pytest.mark.parametrize("integrator", ["Euler", "RK4"])
@pytest.mark.parametrize("jacobian", ["inverse", "transition"])
def test_models_without_actuators_are_simulated_but_not_solved(integrator, jacobian):
    text = MODELS["acrobot"].replace('<motor joint="b"/>', "")
    dynamics = MujocoDynamics.from_xml(HEAD + text, integrator=integrator, jacobian=jacobian, threads=1)
    trajectory = dynamics.rollout(dynamics.initial_state + 0.1, np.zeros((4, 0)))
    assert dynamics.check_derivatives(trajectory).worst_error < 1e-8
    assert dynamics.linearize(trajectory).B.shape == (4, 4, 0)
    assert dynamics.scene().poses(trajectory.X).shape == (5, 2)
    problem = mjslq.Problem(dynamics, 4, dynamics.initial_state, [mjslq.costs.State(1.0)])
    with pytest.raises(ValueError, match="no controls, so there is nothing to optimize; give it actuators"):
        mjslq.solve(problem)
