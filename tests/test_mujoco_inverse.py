"""Jacobians through the inverse dynamics against a fine reference: five-point differences of single steps."""

from __future__ import annotations

import inverse_models as models
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mjslq.dynamics.derivative_check import compare_jacobians, fine_reference
from mjslq.dynamics.mujoco import MujocoDynamics
from mjslq.dynamics.mujoco.inverse.readings.outputs import sensors
from mjslq.dynamics.mujoco.inverse.table import columns as columns
from mjslq.problems.drag_particle import drag_spec
from mjslq.problems.hopper import hopper_spec
from mjslq.trajectory import Trajectory
from mjslq.validation import Array


def dynamics_of(xml: str, **options: object) -> MujocoDynamics:
    # with no tolerance at all MuJoCo's iteration for the discrete integrator's metric ends in 0/0 now and then
    xml = xml.replace(' tolerance="0"', ' tolerance="1e-30"')
    return MujocoDynamics.from_xml(xml, jacobian="inverse", threads=1, **options)


def some_trajectory(
    dynamics: MujocoDynamics,
    N: int = 6,
    spread: float = 0.3,
    speed: float = 1.0,
    scale: float = 1.0,
    base: Array | None = None,
    settle: int = 0,
) -> Trajectory:
    """Roll out random controls about `base` from a random state."""
    rng = np.random.default_rng(0)
    nv, na = dynamics.model.nv, dynamics.model.na
    base = np.zeros(dynamics.nu) if base is None else base
    x = dynamics.initial_state
    if settle:
        x = dynamics.rollout(x, np.tile(base, (settle, 1))).X[-1]
    push = np.concatenate([spread * rng.normal(size=nv), speed * rng.normal(size=nv), 0.2 * rng.normal(size=na)])
    return dynamics.rollout(dynamics.integrate(x, push), base + scale * rng.normal(size=(N, dynamics.nu)))


def assert_exact(dynamics: MujocoDynamics, trajectory: Trajectory, tolerance: float = 1e-7, eps: float = 1e-5) -> None:
    assert not trajectory.diverged
    errors = compare_jacobians(dynamics.linearize(trajectory), fine_reference(dynamics, trajectory, eps)).errors
    assert max(errors.values()) < tolerance, errors


@pytest.mark.parametrize("integrator", models.INTEGRATORS)
@pytest.mark.parametrize("model", [models.arm, models.mixed, models.clipped, models.quadrotor])
def test_smooth_models(model, integrator):
    dynamics = dynamics_of(model(integrator))
    assert_exact(dynamics, some_trajectory(dynamics, N=12), tolerance=5e-9)


def test_euler_without_implicit_damping():
    xml = models.mixed("Euler").replace(
        'integrator="Euler"/>', 'integrator="Euler"><flag eulerdamp="disable"/></option>'
    )
    dynamics = dynamics_of(xml)
    assert_exact(dynamics, some_trajectory(dynamics), tolerance=5e-9)


def test_flags_that_switch_forces_off():
    flags = '<flag gravity="disable" spring="disable" damper="disable" clampctrl="disable"/></option>'
    dynamics = dynamics_of(models.mixed("implicitfast").replace('"implicitfast"/>', '"implicitfast">' + flags))
    assert_exact(dynamics, some_trajectory(dynamics), tolerance=5e-9)


def test_models_of_the_catalogue():
    hopper = MujocoDynamics.from_spec(hopper_spec(), jacobian="inverse", threads=1)
    drop = np.concatenate([[3.0, 1.0], np.zeros(2)])
    assert_exact(hopper, hopper.rollout(drop, 20.0 * np.sin(np.arange(40) * 0.12)[:, None]), eps=1e-4)
    drag = MujocoDynamics.from_spec(drag_spec(0.5), jacobian="inverse", threads=1)
    assert_exact(drag, drag.rollout([0.0, 1.0], np.ones((10, 1))), tolerance=1e-8)


def test_controls_at_and_beyond_their_limits():
    dynamics = dynamics_of(models.mixed("Euler"))
    trajectory = dynamics.rollout(dynamics.initial_state, np.tile([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0]], (3, 1)))
    controls = np.zeros((3, 6))
    controls[:, 4] = [0.5, 0.500001, -3.0]  # on the border the inner derivative, beyond it none
    trajectory = dynamics.rollout(dynamics.initial_state, controls)
    B = dynamics.linearize(trajectory).B
    assert np.abs(B[0, :, 4]).max() > 1e-3
    assert (B[1:, :, 4] == 0.0).all()


STAND = np.tile([0.0, 0.6, -1.2], 4)


@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
@pytest.mark.parametrize("integrator", models.INTEGRATORS)
def test_walking_on_a_plane(integrator, cone):
    dynamics = dynamics_of(models.walker(integrator, cone, soft=models.SOFT))
    trajectory = some_trajectory(dynamics, spread=0.0, speed=0.1, scale=0.05, base=STAND, settle=200)
    assert_exact(dynamics, trajectory, eps=1e-6)


def test_flying_over_a_plane():
    dynamics = dynamics_of(models.walker("implicitfast", "pyramidal", height=3.0))
    assert_exact(dynamics, some_trajectory(dynamics, base=STAND), tolerance=5e-9)


@pytest.mark.parametrize("shape", models.SHAPES)
@pytest.mark.parametrize(
    ("integrator", "cone", "condim"),
    [("Euler", "pyramidal", 3), ("implicitfast", "elliptic", 3), ("implicitfast", "pyramidal", 6),
     ("implicit", "elliptic", 6), ("Euler", "elliptic", 4), ("Euler", "pyramidal", 1)],
)  # fmt: skip
def test_shapes_on_a_plane(shape, integrator, cone, condim):
    dynamics = dynamics_of(models.dropped(shape, integrator, cone, condim))
    trajectory = some_trajectory(dynamics, spread=0.0, speed=0.1)
    assert_exact(dynamics, trajectory, tolerance=1e-6, eps=1e-6)


@pytest.mark.parametrize("integrator", models.INTEGRATORS)
def test_limits_and_friction(integrator):
    dynamics = dynamics_of(models.limits(integrator))
    assert_exact(dynamics, some_trajectory(dynamics, N=20, spread=0.0, scale=0.5), eps=1e-6)


@pytest.mark.parametrize("integrator", models.INTEGRATORS)
def test_moving_pairs(integrator):
    for cone in ("pyramidal", "elliptic"):
        dynamics = dynamics_of(models.pair(integrator, cone))
        assert_exact(dynamics, some_trajectory(dynamics, spread=0.0, speed=0.1, scale=0.1), eps=1e-6)


@pytest.mark.parametrize("integrator", models.INTEGRATORS)
def test_equality_constraints(integrator):
    dynamics = dynamics_of(models.linkage(integrator))
    assert_exact(dynamics, some_trajectory(dynamics, spread=0.0, speed=0.1), eps=1e-6)


@pytest.mark.parametrize("integrator", models.INTEGRATORS)
def test_equality_constraints_of_joints(integrator):
    dynamics = dynamics_of(models.geared(integrator))
    assert_exact(dynamics, some_trajectory(dynamics, spread=0.05, speed=0.5), eps=1e-6)


def test_sparse_constraint_jacobian():
    xml = models.walker("implicitfast", "elliptic", soft=models.SOFT)
    dense = dynamics_of(xml.replace("<option", '<option jacobian="dense"'))
    sparse = dynamics_of(xml.replace("<option", '<option jacobian="sparse"'))
    trajectory = some_trajectory(dense, spread=0.0, speed=0.1, base=STAND, scale=0.05, settle=200)
    for ours, theirs in zip(dense.linearize(trajectory), sparse.linearize(trajectory), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-8 * max(1.0, np.abs(ours).max(initial=0.0)))


def test_any_number_of_threads_gives_the_same():
    xml = models.walker("implicitfast", "pyramidal")
    one = dynamics_of(xml)
    trajectory = some_trajectory(one, N=17, spread=0.0, speed=0.1, base=STAND, scale=0.05, settle=100)
    reference = one.linearize(trajectory)
    for threads in (2, 3, 5):
        several = MujocoDynamics.from_xml(xml, jacobian="inverse", threads=threads)
        for ours, theirs in zip(several.linearize(trajectory), reference, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_singular_inertia_gives_nan():
    xml = models.arm("Euler").replace('damping=".1" armature=".01"', "")
    dynamics = dynamics_of(xml)
    trajectory = some_trajectory(dynamics)
    wild = Trajectory(trajectory.X * np.array([1e160]), trajectory.U, trajectory.Y, trajectory.dt)
    assert not np.isfinite(dynamics.linearize(wild).A).all()


def random_tree(draw) -> str:
    """A tree of two to six bodies with random joints, dampers, springs and actuators."""
    number = st.floats(0.0, 1.0, allow_subnormal=False)
    bodies, joints = draw(st.integers(2, 6)), []

    def body(k: int) -> str:
        kind = draw(st.sampled_from(["hinge", "slide", "ball", "free"] if k == 0 else ["hinge", "slide", "ball"]))
        x, y, z = (round(draw(number) - 0.5, 3) for _ in range(3))
        details = ""
        if kind != "free":
            a, b = round(draw(number), 3), round(draw(number), 3)
            details = f'damping="{a} {b} {draw(st.sampled_from([0, 0.1]))}" armature="{round(draw(number), 3)}"'
            details += f' stiffness="{b} {a} {draw(st.sampled_from([0, 0.2]))}"'
        axis = f'axis="{x} {y} 1"' if kind in ("hinge", "slide") else ""
        joints.append((f"j{k}", kind))
        inside = ""
        while len(joints) < bodies and draw(st.booleans()):
            inside += body(len(joints))
        return (
            f'<body pos="{y} {z} {x}" gravcomp="{draw(st.sampled_from([0, 0, 1, 0.5]))}">'
            f'<joint name="j{k}" type="{kind}" {axis} {details}/>'
            f'<geom type="box" size=".1 .2 .15" pos="{z} {x} .1" euler="{10 * x} 20 0" contype="0" conaffinity="0"/>'
            f"{inside}</body>"
        )

    tree = body(0)
    actuators = ""
    for name, kind in joints:
        if kind in ("hinge", "slide"):
            actuators += draw(
                st.sampled_from([
                    f'<motor joint="{name}" gear="2"/>',
                    f'<position joint="{name}" kp="3" kv=".3"/>',
                    f'<general joint="{name}" dyntype="filterexact" dynprm=".1" gainprm="2"/>',
                ])
            )  # fmt: skip
        else:
            actuators += f'<motor joint="{name}" gear="1 -1 .5"/>'
    integrator = draw(st.sampled_from(models.INTEGRATORS))
    return (
        f'<mujoco><option timestep=".005" integrator="{integrator}"/><worldbody>{tree}</worldbody>'
        f"<actuator>{actuators}</actuator></mujoco>"
    )


@given(st.data())
def test_random_trees(data):
    dynamics = dynamics_of(random_tree(data.draw))
    assert_exact(dynamics, some_trajectory(dynamics, N=2, spread=1.0), tolerance=1e-7)


def test_uncovered_models_fall_back_with_a_reason():
    xml = (
        models.arm("Euler")
        .replace("<option", '<option noslip_iterations="3"')
        .replace('contype="0" conaffinity="0"', "")
    )
    with pytest.raises(ValueError, match="noslip iterations"):
        dynamics_of(xml)
    dynamics = MujocoDynamics.from_xml(xml)
    assert dynamics.jacobian == "transition"
    assert any("noslip" in served for _, served in dynamics.support_report())
    assert MujocoDynamics.from_xml(models.arm("Euler")).jacobian == "inverse"


@pytest.mark.parametrize("integrator", models.INTEGRATORS)
def test_sensors_in_closed_form(integrator):
    dynamics = dynamics_of(models.sensed(integrator))
    assert not (sensors(dynamics.model)["sen_kind"] == columns.BY_DIFFERENCES).any()
    assert_exact(dynamics, some_trajectory(dynamics), tolerance=1e-8)


def test_sensors_in_contact():
    sensor = '<sensor><framepos objtype="geom" objname="fl"/><subtreelinvel body="trunk"/></sensor></mujoco>'
    xml = models.walker("implicitfast", "elliptic", soft=models.SOFT).replace("</mujoco>", sensor)
    dynamics = dynamics_of(xml.replace('<body pos="0 0 0.36">', '<body name="trunk" pos="0 0 0.36">'))
    trajectory = some_trajectory(dynamics, spread=0.0, speed=0.1, scale=0.05, base=STAND, settle=100)
    assert_exact(dynamics, trajectory, eps=1e-6)


@pytest.mark.parametrize("hands", models.HANDS)
@pytest.mark.parametrize(
    ("integrator", "cone", "condim"),
    [
        ("implicitfast", "pyramidal", 3),
        ("Euler", "elliptic", 3),
        ("implicit", "pyramidal", 6),
        ("Euler", "elliptic", 6),
    ],
)
def test_contacts_within_one_tree(hands, integrator, cone, condim):
    dynamics = dynamics_of(models.clasp(hands, integrator, cone, condim))
    trajectory = some_trajectory(dynamics, spread=0.0, speed=0.1, scale=0.1)
    dynamics.linearize(trajectory)
    assert dynamics.simulator.data[0].nefc > 0
    if hands != "boxes":
        assert_exact(dynamics, trajectory, eps=1e-6)
        return
    # what two boxes exchange has kinks, and a knot may lie on one
    ours, fine = dynamics.linearize(trajectory).A, fine_reference(dynamics, trajectory, 1e-6).A
    errors = np.abs(ours - fine).max(axis=(1, 2)) / np.abs(fine).max()
    assert np.sort(errors)[-2] < 1e-7, errors


@pytest.mark.parametrize(
    "contact",
    ['margin=".02" gap=".004"', 'solref="-500 -20"', 'solref=".03 .8" solimp=".3 .9 .05 .4 3"', 'solimp=".9 .9 .01"'],
)
@pytest.mark.parametrize("cone", ["pyramidal", "elliptic"])
def test_contact_parameters(contact, cone):
    dynamics = dynamics_of(models.dropped("sphere", "implicitfast", cone, 3, contact))
    assert_exact(dynamics, some_trajectory(dynamics, spread=0.0, speed=0.1), tolerance=1e-6, eps=1e-6)


def test_friction_with_a_reference_of_its_own():
    pair = '<contact><pair geom1="floor" geom2="ball" solreffriction=".05 1" friction=".5 .8 .01 .01 .01"/></contact>'
    xml = models.dropped("sphere", "Euler", "elliptic", 3).replace("<actuator>", pair + "<actuator>")
    xml = xml.replace('<geom type="plane"', '<geom name="floor" type="plane"')
    dynamics = dynamics_of(xml.replace('<geom type="sphere"', '<geom name="ball" type="sphere"'))
    assert_exact(dynamics, some_trajectory(dynamics, spread=0.0, speed=0.1), tolerance=1e-6, eps=1e-6)


def test_one_sided_differences_when_asked_for():
    xml = models.clasp("boxes", "Euler", "elliptic", 3)
    centred = dynamics_of(xml)
    trajectory = some_trajectory(centred, spread=0.0, speed=0.1)
    one_sided = dynamics_of(xml, centered=False).linearize(trajectory).A
    reference = centred.linearize(trajectory).A
    assert 0.0 < np.abs(one_sided - reference).max() < 1e-3 * np.abs(reference).max()
