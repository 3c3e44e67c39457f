"""`StateSpace`: round trips, derivatives, and the functions of MuJoCo and Pinocchio that it stands for."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import mjslq
from mjslq.dynamics.mujoco.states import state_space
from mjslq.dynamics.pinocchio.states import state_space as pinocchio_space
from mjslq.manifold import StateSpace
from mjslq.rotation import cotangent_series

MODEL = mujoco.MjModel.from_xml_string("""
<mujoco><worldbody>
  <body><joint name="slide" type="slide"/><geom size="0.1"/>
    <body><joint name="ball" type="ball"/><geom size="0.1"/></body></body>
  <body><freejoint name="root"/><geom size="0.1"/>
    <body><joint name="hinge"/><geom size="0.1"/></body></body>
</worldbody><actuator><general joint="hinge" dyntype="filter" dynprm="1"/></actuator></mujoco>""")


def pinocchio_model():
    """A joint of every kind: what MuJoCo has, planar, unbounded, and a composite of three."""
    composite = pin.JointModelComposite(pin.JointModelRX())
    composite.addJoint(pin.JointModelSpherical())
    composite.addJoint(pin.JointModelRUBX())
    model, joints = pin.Model(), (
        pin.JointModelFreeFlyer(), pin.JointModelRY(), pin.JointModelSpherical(), pin.JointModelPlanar(),
        pin.JointModelRUBX(), composite, pin.JointModelTranslation(), pin.JointModelSphericalZYX(),
    )  # fmt: skip
    for i, joint in enumerate(joints):
        j = model.addJoint(i, joint, pin.SE3.Random(), f"joint{i}")
        model.appendBodyToJoint(j, pin.Inertia.Random(), pin.SE3.Identity())
    return model


PIN = pinocchio_model()
SPACES = {"mujoco": state_space(MODEL), "pinocchio": pinocchio_space(PIN)}
STARTS = {
    "mujoco": np.concatenate([MODEL.qpos0, np.zeros(MODEL.nv + MODEL.na)]),
    "pinocchio": np.concatenate([pin.neutral(PIN), np.zeros(PIN.nv)]),
}
every_space = pytest.mark.parametrize("name", SPACES)


def tangents(largest):
    """Tangent directions for the larger space, with turns of up to sqrt(3) times `largest`, or tiny ones."""
    numbers = st.floats(-largest, largest)
    scales = st.sampled_from([1.0, 0.3, 1e-2, 1e-4, 1e-7])
    size = max(space.ndx for space in SPACES.values())
    return st.builds(lambda d, s: s * d, arrays(np.float64, size, elements=numbers), scales)


def state(name, dx):
    return SPACES[name].integrate(STARTS[name], dx[: SPACES[name].ndx])


def same_signs(space, x, like):
    """The same state with quaternions on the side of those of `like`: q and -q are one rotation."""
    x = x.copy()
    for part in space.parts:
        unit = part.x[:, part.group.unit]
        if unit.shape[1] == 4:
            x[unit] *= np.sign((x[unit] * like[unit]).sum(-1, keepdims=True))
    return x


def five_point(f, ndx, e=1e-3):
    """Derivative of f by a tangent direction, at zero."""
    turns = e * np.eye(ndx)
    return ((8.0 * (f(turns) - f(-turns)) - (f(2.0 * turns) - f(-2.0 * turns))) / (12.0 * e)).T


@every_space
@given(tangents(9.0), tangents(9.0))
@settings(max_examples=60)
def test_integrate_undoes_difference(name, a, b):
    space, x, y = SPACES[name], state(name, a), state(name, b)
    back = space.integrate(x, space.difference(x, y))
    np.testing.assert_allclose(same_signs(space, back, y), y, rtol=0, atol=1e-12)


@every_space
@given(tangents(9.0), tangents(1.7))
@settings(max_examples=60)
def test_difference_undoes_integrate(name, a, dx):
    space, x = SPACES[name], state(name, a)
    dx = dx[: space.ndx]
    np.testing.assert_allclose(space.difference(x, space.integrate(x, dx)), dx, rtol=0, atol=1e-13)


@every_space
@given(tangents(9.0), tangents(1.6))
@settings(max_examples=60)
def test_jacobian_of_the_difference(name, a, dx):
    """For all sizes of turns, those about which closed formulas lose their digits among them."""
    space, x = SPACES[name], state(name, a)
    y = space.integrate(x, dx[: space.ndx])
    columns = five_point(lambda turns: space.difference(x, space.integrate(y, turns)), space.ndx)
    np.testing.assert_allclose(space.difference_jacobian(x, y), columns, rtol=0, atol=1e-9)


@every_space
@given(tangents(9.0))
@settings(max_examples=30)
def test_tangent_basis(name, a):
    space, x, other = SPACES[name], state(name, a), STARTS[name]
    columns = five_point(lambda turns: space.integrate(x, turns), space.ndx)
    np.testing.assert_allclose(space.tangent_basis(x), columns, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(space.tangent_basis(np.array([other, x]))[1], space.tangent_basis(x))


@every_space
@given(tangents(9.0), st.integers(0, 2**32 - 1))
@settings(max_examples=10, deadline=None)
def test_curvature_of_tangent_directions(name, a, seed):
    space, x, e = SPACES[name], state(name, a), 1e-2
    g, units = np.random.default_rng(seed).standard_normal(space.nx), np.eye(space.ndx)
    at = lambda d: space.integrate(x, d) @ g  # noqa: E731

    def along(d):  # second derivative, to fourth order
        beside, beyond = at(e * d) + at(-e * d), at(2.0 * e * d) + at(-2.0 * e * d)
        return (16.0 * beside - beyond - 30.0 * at(0.0 * d)) / (12.0 * e * e)

    squares = np.array([along(d) for d in units])
    both = np.stack([along(units + d) for d in units])
    expected = 0.5 * (both - squares[:, None] - squares)
    np.testing.assert_allclose(space.curvature(x, g), expected, rtol=0, atol=1e-6 * np.abs(g).max())
    pairs = space.curvature(np.array([STARTS[name], x]), np.array([g, g]))
    np.testing.assert_allclose(pairs[1], space.curvature(x, g), rtol=0, atol=1e-15 * np.abs(g).max())


@given(tangents(9.0), tangents(9.0))
@settings(max_examples=100)
def test_mujoco_agrees(a, b):
    space, x, y, nq, nv = SPACES["mujoco"], state("mujoco", a), state("mujoco", b), MODEL.nq, MODEL.nv
    dq = np.zeros(nv)
    mujoco.mj_differentiatePos(MODEL, dq, 1.0, x[:nq], y[:nq])
    np.testing.assert_allclose(space.difference(x, y)[:nv], dq, atol=1e-11)
    q = x[:nq].copy()
    mujoco.mj_integratePos(MODEL, q, b[:nv], 1.0)
    np.testing.assert_allclose(space.integrate(x, b[: space.ndx])[:nq], q, atol=1e-11)


@pytest.mark.parametrize("seed", range(40))
def test_pinocchio_agrees(seed):
    """Between 0.01 and 3 rad: about 1e-4 rad Pinocchio's own formulas lose up to half of their digits."""
    space, nq, nv, rng = SPACES["pinocchio"], PIN.nq, PIN.nv, np.random.default_rng(seed)
    x, dx = state("pinocchio", 3.0 * rng.normal(size=space.ndx)), rng.uniform(0.1, 1.7, space.ndx)
    dx *= rng.choice([-1.0, 1.0], space.ndx)
    y = np.concatenate([pin.integrate(PIN, x[:nq], dx[:nv]), x[nq:] + dx[nv:]])
    np.testing.assert_allclose(same_signs(space, space.integrate(x, dx), y), y, rtol=0, atol=1e-12)
    np.testing.assert_allclose(space.difference(x, y)[:nv], pin.difference(PIN, x[:nq], y[:nq]), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(space.difference(x, y)[nv:], y[nq:] - x[nq:])
    J = pin.dDifference(PIN, x[:nq], y[:nq], pin.ArgumentPosition.ARG1)
    np.testing.assert_allclose(space.difference_jacobian(x, y)[:nv, :nv], J, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(space.difference_jacobian(x, y)[nv:], np.eye(2 * nv)[nv:])


def test_kinds_of_joints_are_told_apart():
    """The free joint's position is plain in MuJoCo and part of a rigid motion in Pinocchio."""
    names = {name: {type(part.group).__name__: len(part.x) for part in space.parts} for name, space in SPACES.items()}
    assert names == {"mujoco": {"Rotation": 2}, "pinocchio": {"Motion": 1, "Rotation": 2, "Slide": 1, "Turn": 2}}
    assert len(SPACES["mujoco"].plain_x) == MODEL.nq - 8 + MODEL.nv + MODEL.na


def test_other_kinds_of_joints_are_refused():
    joint = SimpleNamespace(shortname=lambda: "JointModelNew", nq=5, nv=3)
    model = SimpleNamespace(njoints=2, joints=[None, joint], names=["universe", "odd"], idx_qs=[0, 0], idx_vs=[0, 0])
    with pytest.raises(ValueError, match="joint 'odd' is of a kind that is not supported: JointModelNew"):
        pinocchio_space(model)


def test_series_and_formula_meet():
    """c = (1 - t/2 cot t/2) / t^2 and its slope have no step where one takes over from the other."""
    t = np.array([0.5 - 1e-9, 0.5 + 1e-9])
    for values in cotangent_series(t[:, None]):
        np.testing.assert_allclose(values[0], values[1], rtol=1e-8)
    c, slope = cotangent_series(np.array([[0.3], [2.0]]))
    for t, ours, rate in zip((0.3, 2.0), c, slope, strict=True):
        e = 1e-4
        by_hand = [(1.0 - 0.5 * s / np.tan(0.5 * s)) / s**2 for s in (t - e, t, t + e)]
        np.testing.assert_allclose(ours, by_hand[1], rtol=1e-13)
        np.testing.assert_allclose(rate, (by_hand[2] - by_hand[0]) / (2.0 * e) / t, rtol=1e-6)


@every_space
def test_leading_axes(name):
    space, start, rng = SPACES[name], STARTS[name], np.random.default_rng(0)
    dx = 0.5 * rng.normal(size=(4, 3, space.ndx))
    X = space.integrate(start, dx)
    assert X.shape == (4, 3, space.nx)
    np.testing.assert_allclose(space.difference(start, X), dx, atol=1e-12)
    jacobians = space.difference_jacobian(start, X)
    assert jacobians.shape == (4, 3, space.ndx, space.ndx)
    np.testing.assert_array_equal(jacobians[2, 1], space.difference_jacobian(start, X[2, 1]))


@every_space
def test_zero_difference_is_exact(name):
    space, start = SPACES[name], STARTS[name]
    np.testing.assert_array_equal(space.difference(start, start), 0.0)
    np.testing.assert_array_equal(space.difference_jacobian(start, start), np.eye(space.ndx))


def test_plain_vectors_have_the_identity():
    hinge = mjslq.MujocoDynamics.from_xml(
        '<mujoco><worldbody><body><joint name="a"/><geom size="1"/></body></worldbody>'
        '<actuator><motor joint="a"/></actuator></mujoco>'
    )
    for space in (hinge.space, StateSpace.plain(2), mjslq.FunctionDynamics(lambda x, u: x, 2, 1, 0.1).space):
        assert space.difference_jacobian(np.zeros(2), np.ones(2)) is None
        assert space.tangent_basis(np.zeros(2)) is None
        np.testing.assert_array_equal(space.difference(np.zeros(2), np.ones(2)), 1.0)
        np.testing.assert_array_equal(space.integrate(np.ones(2), np.ones(2)), 2.0)


@every_space
def test_unit_lengths_are_restored_and_zero_is_refused(name):
    space, start = SPACES[name], STARTS[name]
    for part in space.parts:
        units = part.x[:, part.group.unit]
        x = start.copy()
        x[units] *= 2.0
        np.testing.assert_allclose(space.normalized(x), start, rtol=0, atol=1e-15)
        x[units[-1]] = 0.0
        first, last, kind = (
            units[-1].min(),
            units[-1].max(),
            "quaternion" if units.shape[1] == 4 else "cosine and a sine",
        )
        with pytest.raises(
            ValueError, match=f"entries {first} to {last} of the state are a {kind} and must not be all"
        ):
            space.normalized(x)


def test_starts_are_normalized_by_engines():
    dynamics = mjslq.MujocoDynamics.from_model(MODEL)
    x, rotations = STARTS["mujoco"].copy(), SPACES["mujoco"].parts[0].x
    x[rotations] *= 2.0
    np.testing.assert_allclose(dynamics.rollout(x, np.zeros((1, 1))).X[0], STARTS["mujoco"])
    x[rotations[1]] = 0.0
    with pytest.raises(ValueError, match="quaternion and must not be all zero"):
        dynamics.rollout(x, np.zeros((1, 1)))
