"""Free parameters: designs whose optima are known, identification, MuJoCo's quantities, what is refused."""

import mujoco
import numba
import numpy as np
import pytest
from free_time_problems import POLE

from mjslq import Bounds, FunctionDynamics, MujocoDynamics, PinocchioDynamics, Problem, constraints, costs, solve

SPRING = {"stiffness": 4.0, "drag": 0.1}


def spring(x, u, t, p):
    """A mass of one on a spring."""
    return np.array([x[1], u[0] - p[0] * x[0] - p[1] * x[1]])


def set_length(model, length):
    """Make the pole a rod of another length."""
    model.geom("rod").pos[2] = model.body("pole").ipos[2] = -0.5 * length
    model.geom("rod").size[1] = 0.5 * length
    model.body("pole").inertia[:2] = length**2 / 12.0
    model.site("tip").pos[2] = -length


@pytest.mark.parametrize("f", [spring, numba.njit(spring)], ids=["python", "compiled"])
def test_a_spring_is_chosen_so_that_its_period_fits(f):
    """From rest at 1 m, at 0 m after T without any force: a quarter of a period, k = (pi / 2 T)^2."""
    T = 0.8
    dynamics = FunctionDynamics(f, 2, 1, T / 40, parameters=SPRING | {"drag": 0.0})
    problem = Problem(
        dynamics, 40, [1.0, 0.0], [costs.Control(1.0)], free_parameters={"stiffness": (0.1, 20.0)},
        constraints=[constraints.Terminal(lambda x: x[:1], name="middle")],
    )  # fmt: skip
    result = solve(problem)
    assert result.success and result.cost < 1e-9
    assert result.free_parameters == {"stiffness": pytest.approx((np.pi / (2.0 * T)) ** 2, rel=1e-5)}
    assert result.final_time == pytest.approx(T) and dynamics.parameters[0] == 4.0


def test_a_parameter_stops_at_its_limit():
    T = 0.8
    dynamics = FunctionDynamics(spring, 2, 1, T / 40, parameters=SPRING | {"drag": 0.0})
    problem = Problem(
        dynamics, 40, [1.0, 0.0], [costs.Control(1.0), costs.State([9.0, 0.0], when="terminal")],
        free_parameters={"stiffness": (0.1, 3.0)},
    )  # fmt: skip
    result = solve(problem)
    assert result.success and result.unknowns == {"stiffness": 3.0} and result.multipliers["stiffness"][0] > 0.0


def test_time_and_stiffness_are_chosen_together():
    """The stiffer the spring the shorter the quarter of a period: the stiffest one there is."""
    dynamics = FunctionDynamics(spring, 2, 1, 0.02, parameters=SPRING | {"drag": 0.0})
    problem = Problem(
        dynamics, 40, [1.0, 0.0], [costs.Control(1.0), costs.Time(0.5)], free_time=(0.1, 3.0),
        free_parameters={"stiffness": (0.1, 20.0)}, bounds=Bounds(u=(0.0, 0.0)),
        constraints=[constraints.Terminal(lambda x: x[:1], name="middle")],
    )  # fmt: skip
    result = solve(problem)
    assert result.success, result.message
    time, stiffness = result.unknowns["final time"], result.unknowns["stiffness"]
    assert time == pytest.approx(np.pi / (2.0 * np.sqrt(stiffness)), rel=1e-5) and stiffness == 20.0


def test_parameters_are_identified_from_a_recorded_motion():
    truth = {"stiffness": 7.0, "drag": 0.4}
    U = np.sin(0.3 * np.arange(60))[:, None]
    record = FunctionDynamics(spring, 2, 1, 0.05, parameters=truth).rollout([0.5, 0.0], U)
    problem = Problem(
        FunctionDynamics(spring, 2, 1, 0.05, parameters=SPRING), 60, [0.5, 0.0],
        [costs.State(1.0, record.X, "always")], bounds=Bounds(u=(U, U)),
        free_parameters={"stiffness": (1.0, 20.0), "drag": (0.0, 2.0)},
    )  # fmt: skip
    result = solve(problem)
    assert result.success and result.iterations < 15 and result.cost < 1e-12
    assert result.free_parameters == {name: pytest.approx(value, rel=1e-6) for name, value in truth.items()}
    np.testing.assert_array_equal(result.trajectory.U, U)
    rolled = problem.fixed(result.unknowns).rollout(U)
    np.testing.assert_allclose(rolled.X, result.trajectory.X, rtol=1e-12, atol=1e-14)
    assert problem.fixed({}).rollout(U).X[-1, 0] != pytest.approx(record.X[-1, 0], abs=1e-3)


@pytest.mark.parametrize(
    "name, what, truth",
    [("mass", "body/pole/mass", 1.4), ("damping", "joint/hinge/damping", 0.25), ("gear", "actuator/m/gear/0", 1.5),
     ("length", (set_length, 0.5), 0.8)],
)  # fmt: skip
def test_quantities_of_a_mujoco_model_are_identified(name, what, truth):
    U = 0.5 * np.sin(0.1 * np.arange(60))[:, None]
    dynamics = MujocoDynamics.from_xml(POLE, parameters={name: what}, threads=1)
    given, start = np.array(dynamics.model.body_mass), [0.5, 0.0]

    def true(model):
        dynamics.parameters[name].set(model, truth)
        mujoco.mj_setConst(model, mujoco.MjData(model))

    record = dynamics.with_model(true).rollout(start, U)
    assert np.abs(record.X - dynamics.rollout(start, U).X).max() > 1e-2
    problem = Problem(
        dynamics, 60, start, [costs.State(1.0, record.X, "always")], bounds=Bounds(u=(U, U)),
        free_parameters={name: (0.01, 3.0)},
    )  # fmt: skip
    result = solve(problem, tol=1e-9)
    assert result.success and result.free_parameters[name] == pytest.approx(truth, rel=1e-6)
    np.testing.assert_array_equal(dynamics.model.body_mass, given)  # the user's model stays
    drawn = mujoco.MjModel.from_binary_path("m.mjb", {"m.mjb": result.scene.model})
    shown = MujocoDynamics.from_model(drawn, threads=1).rollout(start, U)
    np.testing.assert_allclose(shown.X, result.trajectory.X, rtol=1e-9, atol=1e-11)


def test_names_of_parameters():
    assert FunctionDynamics(spring, 2, 1, 0.1, parameters=SPRING).parameter_names == ("stiffness", "drag")
    assert FunctionDynamics(spring, 2, 1, 0.1, parameters=[4.0, 0.1]).parameter_names == ("p[0]", "p[1]")
    assert MujocoDynamics.from_xml(POLE).parameter_names == ()


def posed(dynamics, **free):
    return Problem(dynamics, 10, np.zeros(dynamics.nx), [costs.Control(1.0)], free_parameters=free)


@pytest.mark.parametrize(
    "free, sentence",
    [
        ({"stifness": (1.0, 2.0)}, "free_parameters: unknown parameter 'stifness'; there are: .*mean 'stiffness'"),
        ({"stiffness": (2.0, 1.0)}, r"free_parameters\['stiffness'\] must be a pair \(lower, upper\) with the lower"),
        ({"stiffness": 3.0}, r"free_parameters\['stiffness'\] must be a pair \(lower, upper\), got 3.0"),
    ],
)
def test_what_does_not_fit_is_told(free, sentence):
    with pytest.raises(ValueError, match=sentence):
        posed(FunctionDynamics(spring, 2, 1, 0.1, parameters=SPRING), **free)


def test_engines_without_parameters_say_so():
    import pinocchio as pin

    robot = PinocchioDynamics.from_model(pin.buildSampleModelManipulator(), 0.01)
    for dynamics in (robot, MujocoDynamics.from_xml(POLE)):
        with pytest.raises(ValueError, match="the system has no parameter 'mass', nor any other; name them when"):
            posed(dynamics, mass=(1.0, 2.0))
    with pytest.raises(ValueError, match="free_parameters must be a mapping from names"):
        Problem(robot, 10, np.zeros(robot.nx), [costs.Control(1.0)], free_parameters=["mass"])
    with pytest.raises(ValueError, match="'final time' is what the final time is called; choose another name"):
        Problem(
            FunctionDynamics(spring, 2, 1, 0.1, parameters={"final time": 1.0, "drag": 0.1}), 10, [0.0, 0.0],
            [costs.Control(1.0)], free_time=(0.1, 2.0), free_parameters={"final time": (1.0, 2.0)},
        )  # fmt: skip


@pytest.mark.parametrize(
    "what, sentence",
    [
        ("body/pol/mass", "unknown body 'pol'; there are: world, pole; did you mean 'pole'"),
        ("body/pole/mas", "unknown number of a body 'mas'; there are: .*mass.*did you mean 'mass'"),
        ("body/pole/subtreemass", "unknown number of a body 'subtreemass'"),
        ("bdy/pole/mass", "unknown kind of quantity 'bdy'; there are: body, joint"),
        ("geom/rod/friction", "friction has 3 entries; say which, such as 'geom/rod/friction/0'"),
        ("geom/rod/friction/7", "friction has 3 entries; say which"),
        ("mass", 'must be "kind/name/field" or "kind/name/field/index", got \'mass\''),
        (3.0, r"must be a quantity such as .* or a pair \(set, value\)"),
    ],
)
def test_quantities_that_are_none_are_refused(what, sentence):
    with pytest.raises(ValueError, match=rf"parameters\['a'\]: .*{sentence}"):
        MujocoDynamics.from_xml(POLE, parameters={"a": what})


def test_values_to_fix_are_checked():
    problem = posed(FunctionDynamics(spring, 2, 1, 0.1, parameters=SPRING), stiffness=(1.0, 5.0))
    with pytest.raises(ValueError, match="unknown name of an unknown 'drag'; there are: stiffness"):
        problem.fixed({"drag": 1.0})
    with pytest.raises(ValueError, match=r"stiffness must be within \[1, 5\], got 6"):
        problem.fixed({"stiffness": 6.0})
    assert problem.fixed({"stiffness": 2.0}).dynamics.parameters[0] == 2.0
