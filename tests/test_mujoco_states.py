"""The manifold of MuJoCo states: round trips, MuJoCo's own functions, derivatives."""

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.manifold import StateSpace

MODEL = mujoco.MjModel.from_xml_string("""
<mujoco><worldbody>
  <body><joint name="slide" type="slide"/><geom size="0.1"/>
    <body><joint name="ball" type="ball"/><geom size="0.1"/></body></body>
  <body><freejoint name="root"/><geom size="0.1"/>
    <body><joint name="hinge"/><geom size="0.1"/></body></body>
</worldbody><actuator><general joint="hinge" dyntype="filter" dynprm="1"/></actuator></mujoco>""")
SPACE = StateSpace.of_model(MODEL)
START = np.concatenate([MODEL.qpos0, np.zeros(MODEL.nv + MODEL.na)])

numbers = st.floats(-10.0, 10.0, allow_nan=False)
tangents = arrays(np.float64, SPACE.ndx, elements=numbers)
short_tangents = arrays(np.float64, SPACE.ndx, elements=st.floats(-1.7, 1.7))  # turns of less than pi


def state(dx):
    return SPACE.integrate(START, dx)


@given(tangents, tangents)
@settings(max_examples=100, deadline=None)
def test_integrate_undoes_difference(a, b):
    x, y = state(a), state(b)
    back = SPACE.integrate(x, SPACE.difference(x, y))
    sign = np.sign((back[SPACE.quat_x] * y[SPACE.quat_x]).sum(-1))  # q and -q are one rotation
    back[SPACE.quat_x] *= sign[:, None]
    np.testing.assert_allclose(back, y, atol=1e-12)


@given(tangents, short_tangents)
@settings(max_examples=100, deadline=None)
def test_difference_undoes_integrate(a, dx):
    x = state(a)
    np.testing.assert_allclose(SPACE.difference(x, SPACE.integrate(x, dx)), dx, atol=1e-12)


@given(tangents, tangents)
@settings(max_examples=100, deadline=None)
def test_mujoco_agrees(a, b):
    x, y, nq, nv = state(a), state(b), MODEL.nq, MODEL.nv
    dq = np.zeros(nv)
    mujoco.mj_differentiatePos(MODEL, dq, 1.0, x[:nq], y[:nq])
    np.testing.assert_allclose(SPACE.difference(x, y)[:nv], dq, atol=1e-11)
    q = x[:nq].copy()
    mujoco.mj_integratePos(MODEL, q, b[:nv], 1.0)
    np.testing.assert_allclose(SPACE.integrate(x, b)[:nq], q, atol=1e-11)


@given(tangents, short_tangents)
@settings(max_examples=50, deadline=None)
def test_jacobian_of_the_difference(a, dx):
    x = state(a)
    y, eps = SPACE.integrate(x, dx), 1e-6
    turns = np.eye(SPACE.ndx) * eps
    columns = (
        SPACE.difference(x, SPACE.integrate(y, turns)) - SPACE.difference(x, SPACE.integrate(y, -turns))
    ) / (2 * eps)  # fmt: skip
    np.testing.assert_allclose(SPACE.difference_jacobian(x, y), columns.T, atol=1e-6)


@given(tangents)
@settings(max_examples=50, deadline=None)
def test_tangent_basis(a):
    x, turns = state(a), 1e-6 * np.eye(SPACE.ndx)
    columns = (SPACE.integrate(x, turns) - SPACE.integrate(x, -turns)) / 2e-6
    np.testing.assert_allclose(SPACE.tangent_basis(x), columns.T, atol=1e-8)
    np.testing.assert_array_equal(SPACE.tangent_basis(np.array([START, x]))[1], SPACE.tangent_basis(x))


def test_leading_axes():
    rng = np.random.default_rng(0)
    dx = 0.5 * rng.normal(size=(4, 3, SPACE.ndx))
    X = SPACE.integrate(START, dx)
    assert X.shape == (4, 3, SPACE.nx)
    np.testing.assert_allclose(SPACE.difference(START, X), dx, atol=1e-12)
    jacobians = SPACE.difference_jacobian(START, X)
    assert jacobians.shape == (4, 3, SPACE.ndx, SPACE.ndx)
    np.testing.assert_array_equal(jacobians[2, 1], SPACE.difference_jacobian(START, X[2, 1]))


def test_zero_difference_is_exact():
    np.testing.assert_array_equal(SPACE.difference(START, START), 0.0)
    np.testing.assert_array_equal(SPACE.difference_jacobian(START, START), np.eye(SPACE.ndx))


def test_plain_vectors_have_the_identity():
    plain = MujocoDynamics.from_xml(
        '<mujoco><worldbody><body><joint name="a"/><geom size="1"/></body></worldbody>'
        '<actuator><motor joint="a"/></actuator></mujoco>'
    )
    assert plain.difference_jacobian(np.zeros(2), np.ones(2)) is None
    np.testing.assert_array_equal(plain.difference(np.zeros(2), np.ones(2)), 1.0)


def test_start_is_normalized_and_zero_quaternions_are_refused():
    dynamics = MujocoDynamics.from_model(MODEL)
    x = START.copy()
    x[SPACE.quat_x] *= 2.0
    np.testing.assert_allclose(dynamics.rollout(x, np.zeros((1, 1))).X[0], START)
    x[SPACE.quat_x[1]] = 0.0
    with pytest.raises(ValueError, match="quaternion and must not be all zero"):
        dynamics.rollout(x, np.zeros((1, 1)))
