"""Every residual with every loss at every `when`, on three engines, against plain formulas and their differences."""

import numpy as np
import pytest
from numba import njit
from scipy.spatial.transform import Rotation

from mjslq import FunctionDynamics, MujocoDynamics, PinocchioDynamics, Problem, Trajectory, costs
from mjslq.quadratic import Expansion

WIDTH = 0.3
LOSSES = {"quadratic": {}} | {name: {"loss": name, "width": WIDTH} for name in ("smooth-abs", "huber", "pseudo-huber")}
N, H = 4, 0.05
CRAFT = """
<mujoco><option timestep="0.05"/><worldbody><body name="hull" pos="0 0 1"><freejoint/>
<geom type="box" size=".1 .2 .05" mass="1"/><site name="middle"/>
<body pos=".2 0 0"><joint name="hinge" axis="0 1 0"/>
<geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass=".3"/><site name="tip" pos=".3 0 0"/>
</body></body></worldbody>
<actuator><motor name="elbow" joint="hinge"/><motor site="middle" gear="0 0 1 .2 .5 .2"/></actuator>
<sensor><framepos name="point" objtype="site" objname="tip"/><framequat name="attitude" objtype="site" objname="tip"/>
<actuatorfrc name="effort" actuator="elbow"/></sensor></mujoco>"""
ARM = """
<robot name="twolink">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.01" ixy="0.001" ixz="0" iyz="0"/></inertial></link>
  <link name="point"><inertial><origin xyz="0.05 0 0.1"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.005" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <dynamics damping="0.3"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="point"/><origin xyz="0 0 0.4"/>
    <axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="7" velocity="1"/></joint>
</robot>"""
WHENS = {
    "running": [(0, H), (1, H), (2, H), (3, H)],
    "terminal": [(4, 1.0)],
    "always": [(0, H), (1, H), (2, H), (3, H), (4, 1.0)],
    "initial": [(0, 1.0)],
    "knots": [(1, 1.0), (4, 1.0)],
    "steps": [(1, 1.0), (3, 1.0)],
}
GIVEN = {"knots": [1, -1], "steps": [0.05, 0.15]}
"""What is written for some of these."""


def function(x, u, t):
    return np.stack([x[0] * u[1] + x[1] * x[1] - t, np.sin(x[2]) - u[0] + x[3] * x[3]])


@njit
def compiled(x, u, t):
    out = np.empty(2, x.dtype)
    out[0], out[1] = x[0] * u[1] + x[1] * x[1] - t, np.sin(x[2]) - u[0] + x[3] * x[3]
    return out


@pytest.fixture(scope="module")
def engines(tmp_path_factory):
    file = tmp_path_factory.mktemp("robots") / "twolink.urdf"
    file.write_text(ARM)

    def equations(x, u):
        return np.stack([x[2], x[3], u[0] - np.sin(x[0]) * x[1], u[1] - x[3]])

    def outputs(x, u, t):
        return np.stack([np.sin(x[0]), x[1] * x[2], x[3] * u[1]])

    names = ("point[0]", "point[1]", "point[2]")
    return {
        "function": FunctionDynamics(equations, 4, 2, H, outputs=outputs, output_names=names),
        "mujoco": MujocoDynamics.from_xml(CRAFT),
        "pinocchio": PinocchioDynamics.from_path(file, H, outputs=("point", "point.orientation")),
    }


class Case:
    """A cost term, and the same cost by plain formulas, knot by knot."""

    def __init__(self, engine, kind, loss, when, seed=0):
        rng = np.random.default_rng(seed)
        self.engine, self.loss, self.kind = engine, loss, kind
        zero = engine.initial_state if hasattr(engine, "initial_state") else np.zeros(engine.nx)
        x0, self.target = (engine.integrate(zero, 0.5 * rng.standard_normal(engine.ndx)) for _ in range(2))
        self.trajectory = engine.rollout(x0, rng.standard_normal((N, engine.nu)))
        given = {"when": GIVEN.get(when, when)} | LOSSES[loss]
        self.quaternion = rng.standard_normal(4)
        self.point = rng.standard_normal(3)
        size = {"state": engine.ndx, "control": engine.nu, "function": 2, "compiled": 2, "force": 1}.get(kind, 3)
        root = rng.standard_normal((size, size))
        self.W, self.terminal = root.T @ root, None
        if when == "always":
            given["terminal_weight"] = self.terminal = 2.5 * self.W
        term = {
            "state": lambda: costs.State(self.W, self.target, **given),
            "control": lambda: costs.Control(self.W, self.point[: engine.nu], **given),
            "position": lambda: costs.Sensor("point", self.point, self.W, **given),
            "orientation": lambda: costs.Sensor(self.attitude, self.quaternion, self.W, **given),
            "force": lambda: costs.Sensor("effort", 0.3, self.W, **given),
            "function": lambda: costs.Residual(function, self.W, **given),
            "compiled": lambda: costs.Residual(compiled, self.W, **given),
        }[kind]()
        self.problem = Problem(engine, N, x0, [term])

    @property
    def attitude(self):
        return next(name for name, output in self.engine.outputs.items() if output.quaternion)

    def moved(self, n, d):
        """State, control and outputs at knot n, moved along the tangent and control directions `d`."""
        ndx = self.engine.ndx
        u = self.trajectory.U[n] + d[ndx:] if n < N else np.zeros(self.engine.nu)
        x = self.engine.integrate(self.trajectory.X[n], d[:ndx])
        return x, u, self.engine.step(x, u, min(n, N - 1))[1]

    def residual(self, n, d):
        x, u, y = self.moved(n, d)
        if self.kind == "state":
            return self.engine.difference(self.target, x)
        if self.kind == "control":
            return u - self.point[: len(u)]
        if self.kind in ("function", "compiled"):
            return function(x, u, n * H)
        outputs = self.engine.outputs
        if self.kind == "orientation":
            turned = Rotation.from_quat(y[outputs[self.attitude].columns], scalar_first=True)
            return (Rotation.from_quat(self.quaternion, scalar_first=True).inv() * turned).as_rotvec()
        return (
            y[outputs["point"].columns] - self.point if self.kind == "position" else y[outputs["effort"].columns] - 0.3
        )

    def weight(self, n):
        return self.terminal if n == N and self.terminal is not None else self.W

    def value(self, n, d):
        """The cost of knot n, its scale left out."""
        W, r = self.weight(n), self.residual(n, d)
        w, square = np.diag(W).mean(), r @ W @ r
        s = np.sqrt(square / w)
        return (
            w
            * {
                "quadratic": 0.5 * s**2,
                "smooth-abs": np.sqrt(s**2 + WIDTH**2) - WIDTH,
                "huber": 0.5 * s**2 if s <= WIDTH else WIDTH * (s - 0.5 * WIDTH),
                "pseudo-huber": WIDTH**2 * (np.sqrt(1.0 + s**2 / WIDTH**2) - 1.0),
            }[self.loss]
        )

    def gauss_newton(self, n):
        """J'HJ with the loss's own second derivatives H by the residual, as in the formula of the losses."""
        W, r = self.weight(n), self.residual(n, np.zeros(self.engine.ndx + self.engine.nu))
        w = np.diag(W).mean()
        S, s = W / w, np.sqrt(r @ W @ r / w)
        slope, second = {
            "quadratic": (s, 1.0),
            "smooth-abs": (s / np.sqrt(s**2 + WIDTH**2), WIDTH**2 / (s**2 + WIDTH**2) ** 1.5),
            "huber": (s, 1.0) if s <= WIDTH else (WIDTH, 0.0),
            "pseudo-huber": (s / np.sqrt(1.0 + s**2 / WIDTH**2), (1.0 + s**2 / WIDTH**2) ** -1.5),
        }[self.loss]
        inner = w * (slope / s * S + (second - slope / s) / s**2 * np.outer(S @ r, S @ r))
        J = self.differences(lambda d: self.residual(n, d), n)
        return J.T @ inner @ J

    def differences(self, f, n, e=1e-3):
        size = self.engine.ndx + self.engine.nu
        columns = []
        for i in range(size):
            d = np.zeros(size)
            d[i] = e
            if n == N and i >= self.engine.ndx:
                columns.append(0.0 * f(d))
                continue
            six = zip((45.0, -9.0, 1.0), (1, 2, 3), strict=True)
            columns.append(sum(c * (f(k * d) - f(-k * d)) for c, k in six) / (60.0 * e))
        return np.stack(columns, axis=-1)


def kinds_and_whens():
    for engine, kinds in {
        "function": ("state", "control", "position", "function", "compiled"),
        "mujoco": ("state", "control", "position", "orientation", "force", "function", "compiled"),
        "pinocchio": ("state", "control", "position", "orientation", "function", "compiled"),
    }.items():
        for kind in kinds:
            for when in WHENS if kind != "control" else ("running", "initial", "steps"):
                yield pytest.param(engine, kind, when, id=f"{engine}-{kind}-{when}")


def blocks(expansion, n, ndx, nu):
    """Hessian and gradient by (x, u) at knot n."""
    Hn, gn = np.zeros((ndx + nu, ndx + nu)), np.zeros(ndx + nu)
    Hn[:ndx, :ndx], gn[:ndx] = expansion.Q[n], expansion.q[n]
    if n < N:
        Hn[ndx:, ndx:], Hn[ndx:, :ndx], Hn[:ndx, ndx:] = expansion.R[n], expansion.M[n], expansion.M[n].T
        gn[ndx:] = expansion.r[n]
    return Hn, gn


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize("engine, kind, when", list(kinds_and_whens()))
def test_cost_gradient_and_gauss_newton_hessian(engines, engine, kind, when, loss):
    case = Case(engines[engine], kind, loss, when)
    ndx, nu, acting = case.engine.ndx, case.engine.nu, dict(WHENS[when])
    assert case.problem.cost(case.trajectory) == pytest.approx(
        sum(s * case.value(n, np.zeros(ndx + nu)) for n, s in acting.items()), rel=1e-12
    )
    expansion, slopes = case.problem.expand(case.trajectory), case.problem.slopes(case.trajectory)
    _, _, C, D = case.engine.linearize(case.trajectory)
    by_x, by_u = np.einsum("nyi,ny->ni", C, slopes.y), np.einsum("nyi,ny->ni", D, slopes.y)[:-1]
    np.testing.assert_allclose(slopes.q + by_x, expansion.q, rtol=1e-12, atol=1e-12 * np.abs(expansion.q).max())
    np.testing.assert_allclose(slopes.r + by_u, expansion.r, rtol=1e-12, atol=1e-12 * np.abs(expansion.r).max())
    for n in range(N + 1):
        Hn, gn = blocks(expansion, n, ndx, nu)
        if n not in acting:
            assert not Hn.any() and not gn.any()
            continue
        reference = acting[n] * case.differences(lambda d, n=n: case.value(n, d), n)
        np.testing.assert_allclose(gn, reference, rtol=1e-7, atol=1e-7 * np.abs(reference).max())
        reference = acting[n] * case.gauss_newton(n)
        floor = 1e-13 * np.abs(case.W).max()  # huber's curvature along one number is zero beyond the width
        np.testing.assert_allclose(Hn, reference, rtol=0, atol=1e-7 * np.abs(reference).max() + floor)


def whole(case, X, U):
    """Gradients, and whole Hessians with the outputs' own, at knots that need not follow each other."""
    engine = case.engine
    F, Y = engine.step_each(X, U)
    trajectory, linearization = Trajectory(X, U, Y, H), engine.linearize_steps(X, U, F)
    expansion = case.problem.expand(trajectory, linearization)
    full, weights = case.problem.complete(trajectory, expansion)
    curvature = engine.hessian(trajectory, np.zeros((N + 1, engine.ndx)), weights, linearization, F)
    xx, ux, uu = full.Q + curvature.xx, full.M + curvature.ux, full.R + curvature.uu
    return Expansion(xx, uu, ux, full.q, full.r)


@pytest.mark.parametrize("loss", LOSSES)
@pytest.mark.parametrize(
    "engine, kind",
    [(engine, kind) for engine in ("function", "pinocchio") for kind in ("state", "position", "function", "compiled")]
    + [("mujoco", "position"), ("mujoco", "force")],
)
def test_completed_hessian_is_the_derivative_of_the_gradient(engines, engine, kind, loss):
    case = Case(engines[engine], kind, loss, "always", seed=1)
    ndx, nu, e = case.engine.ndx, case.engine.nu, 1e-5
    X, U = np.array(case.trajectory.X), np.array(case.trajectory.U)
    here = whole(case, X, U)
    derivative = np.zeros((N + 1, ndx + nu, ndx + nu))
    for i in range(ndx + nu):
        beside = []
        for sign in (1.0, -1.0):
            d = np.zeros((N + 1, ndx + nu))
            d[:, i] = sign * e
            moved = whole(case, case.engine.integrate(X, d[:, :ndx]), U + d[:N, ndx:])
            beside.append(np.stack([blocks(moved, n, ndx, nu)[1] for n in range(N + 1)]))
        derivative[:, :, i] = (beside[0] - beside[1]) / (2.0 * e)
    derivative = 0.5 * (derivative + derivative.swapaxes(1, 2))
    for n in range(N + 1):
        ours = blocks(here, n, ndx, nu)[0]
        floor = 1e-13 * np.abs(case.W).max()
        np.testing.assert_allclose(ours, derivative[n], rtol=0, atol=2e-6 * np.abs(derivative[n]).max() + floor)
