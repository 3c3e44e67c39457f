"""Recorded motions: what they are at other times, and what a robot that follows them is told."""

import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mjslq
from mjslq import costs
from mjslq.clips import Clip
from mjslq.clips.resampling import angular_velocity, continuous, quaternions
from mjslq.rotation import conjugate, exp, log, product

seeds = st.integers(0, 2**32 - 1)
OF = ("position", "orientation", "linear-velocity", "angular-velocity")
ROBOT = """
<mujoco model="robot">
  <option timestep="0.01"/>
  <worldbody>
    <body name="base" pos="0 0 1"><freejoint name="root"/>
      <geom type="box" size=".2 .1 .1" pos=".03 0 0" mass="2"/>
      <body name="arm" pos=".2 0 0"><joint name="shoulder" axis="0 1 0" damping=".1"/>
        <geom type="capsule" fromto="0 0 0 .4 0 .1" size=".02" mass=".5"/>
        <body name="hand" pos=".4 0 .1"><joint name="wrist" type="ball" damping=".1"/>
          <geom type="box" size=".05 .03 .02" mass=".2"/><site name="tip" pos=".1 0 0"/></body>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="m" joint="shoulder"/><motor name="w" joint="wrist" gear="1 0 0"/></actuator>
</mujoco>
"""
FRAMES = ("base", "hand", "tip")
N = 20


@pytest.fixture(scope="module")
def robot():
    return mjslq.MujocoDynamics.from_xml(ROBOT, substeps=2, frames=FRAMES)


@pytest.fixture(scope="module")
def motion(robot):
    rng = np.random.default_rng(3)
    x0 = robot.integrate(robot.initial_state, 0.7 * rng.standard_normal(robot.ndx))
    return robot.rollout(x0, rng.standard_normal((N, robot.nu)))


def some_clip(seed, T=7):
    """A clip of one frame, with quaternions of any sign, at uneven times."""
    rng = np.random.default_rng(seed)
    times = rng.uniform(-2.0, 2.0) + np.cumsum(rng.uniform(0.05, 0.3, T))
    Q = rng.standard_normal((T, 4))
    Q /= np.linalg.norm(Q, axis=1, keepdims=True)
    P, V, W = rng.standard_normal((3, T, 3))
    frame = dict(zip(OF, (P, Q, V, W), strict=True))
    qpos = {f"root.{end}": column for end, column in zip(("qw", "qx", "qy", "qz"), Q.T, strict=True)}
    return Clip(times, {"head": frame}, qpos | {"knee": rng.standard_normal(T)}, {"knee": rng.standard_normal(T)})


@given(seeds)
@settings(max_examples=40)
def test_resampled_at_its_own_times_a_clip_is_itself(seed):
    clip = some_clip(seed)
    again = clip.resampled(clip.times - clip.times[0])
    for of in OF:
        np.testing.assert_allclose(again.frames["head"][of], clip.frames["head"][of], rtol=0, atol=1e-12)
    for kind in ("qpos", "qvel"):
        for entry, samples in getattr(clip, kind).items():
            np.testing.assert_allclose(getattr(again, kind)[entry], samples, rtol=0, atol=1e-12)


@given(seeds, st.floats(0.0, 1.0), st.floats(0.05, 1.0))
@settings(max_examples=60)
def test_between_two_attitudes_the_rate_is_constant(seed, share, h):
    """q(s) = exp(s w) q_0 for an angle below half a turn; its rate is w everywhere, by differences of any size."""
    rng = np.random.default_rng(seed)
    q0, axis = rng.standard_normal(4), rng.standard_normal(3)
    q0 /= np.linalg.norm(q0)
    w = axis / np.linalg.norm(axis) * rng.uniform(0.0, 3.1)
    times, Q = np.array([0.0, 1.0]), np.stack([q0, product(exp(w), q0) * rng.choice([-1.0, 1.0])])
    found = quaternions(times, Q, np.array([share]))[0]
    wanted = product(exp(share * w), q0)
    assert np.abs(np.abs(found @ wanted) - 1.0) < 1e-12
    clip = Clip(times, {"head": {"orientation": Q}})
    rate = clip.signal("head", "angular-velocity", step=h)(share)
    np.testing.assert_allclose(rate, w, rtol=0, atol=1e-9)


@given(seeds)
@settings(max_examples=40)
def test_signs_of_quaternions_do_not_matter(seed):
    clip, rng = some_clip(seed), np.random.default_rng(seed + 1)
    signs = rng.choice([-1.0, 1.0], len(clip.times))
    flipped = {**clip.frames["head"], "orientation": clip.frames["head"]["orientation"] * signs[:, None]}
    other = dataclasses.replace(clip, frames={"head": flipped})
    times = np.linspace(0.0, clip.duration, 23)
    ours, theirs = (c.resampled(times).frames["head"]["orientation"] for c in (clip, other))
    np.testing.assert_allclose(np.abs((ours * theirs).sum(axis=1)), 1.0, rtol=0, atol=1e-12)
    Q = other.frames["head"]["orientation"]
    assert ((Q[1:] * Q[:-1]).sum(axis=1) >= 0.0).all()
    np.testing.assert_array_equal(continuous(Q), Q)


@given(seeds)
@settings(max_examples=25)
def test_resampling_is_straight_lines_and_arcs(seed):
    """Against np.interp and a plain loop."""
    clip, rng = some_clip(seed), np.random.default_rng(seed)
    s = np.sort(rng.uniform(0.0, clip.duration, 9))
    again, at = clip.resampled(s), clip.times[0] + s
    head, Q = clip.frames["head"], clip.frames["head"]["orientation"]
    for of in ("position", "linear-velocity", "angular-velocity"):
        for i in range(3):
            wanted = np.interp(at, clip.times, head[of][:, i])
            np.testing.assert_allclose(again.frames["head"][of][:, i], wanted, rtol=0, atol=1e-12)
    for n, t in enumerate(at):
        i = min(int(np.searchsorted(clip.times, t, side="right")) - 1, len(Q) - 2)
        share = (t - clip.times[i]) / (clip.times[i + 1] - clip.times[i])
        wanted = product(Q[i], exp(share * log(product(conjugate(Q[i]), Q[i + 1]))))
        assert abs(abs(again.frames["head"]["orientation"][n] @ wanted) - 1.0) < 1e-12
    np.testing.assert_allclose(
        np.abs(sum(again.qpos[f"root.{e}"] * again.frames["head"]["orientation"][:, i] for i, e in
                   enumerate(("qw", "qx", "qy", "qz")))), 1.0, rtol=0, atol=1e-12)  # fmt: skip


def turning(rate=50.0, duration=1.0):
    """A frame on a circle of 0.5 m, one radian a second, recorded without velocities; begins at 3 s."""
    t = np.arange(round(rate * duration) + 1) / rate
    place = 0.5 * np.stack([np.cos(t), np.sin(t), 0.0 * t], axis=1)
    return Clip(3.0 + t, {"hand": {"position": place, "orientation": exp(np.outer(t, [0.0, 0.0, 1.0]))}})


def test_velocities_are_differences_of_the_poses():
    clip = turning()
    times = 0.03 * np.arange(30)
    again = clip.resampled(times)
    speed, turn = again.frames["hand"]["linear-velocity"], again.frames["hand"]["angular-velocity"]
    wanted = 0.5 * np.stack([-np.sin(times), np.cos(times), 0.0 * times], axis=1)
    np.testing.assert_allclose(speed[1:], wanted[1:], rtol=0, atol=1e-3)
    np.testing.assert_allclose(speed[0], wanted[0], rtol=0, atol=0.01)  # one-sided
    np.testing.assert_allclose(turn, np.tile([0.0, 0.0, 1.0], (30, 1)), rtol=0, atol=1e-10)
    place = again.frames["hand"]["position"]
    np.testing.assert_allclose(speed[1:-1], (place[2:] - place[:-2]) / 0.06, rtol=0, atol=1e-12)
    q = again.frames["hand"]["orientation"]
    np.testing.assert_allclose(turn[1:-1], angular_velocity(q[:-2], q[2:], np.full(28, 0.06)), rtol=0, atol=1e-12)


def test_offset_stretch_and_what_is_beyond():
    clip = turning()
    at = clip.signal("hand", offset=0.4, stretch=2.0)
    angle = lambda t: np.arctan2(*at(t)[1::-1])  # noqa: E731
    assert angle(0.0) == pytest.approx(0.4, abs=1e-4) and angle(0.6) == pytest.approx(0.7, abs=1e-4)
    turn, speed = (clip.signal("hand", of, 0.4, 2.0) for of in ("angular-velocity", "linear-velocity"))
    assert turn(0.3) == pytest.approx([0.0, 0.0, 0.5]) and np.linalg.norm(speed(0.3)) == pytest.approx(0.25, rel=1e-3)
    assert angle(1.2) == pytest.approx(1.0, abs=1e-9) and angle(9.0) == angle(1.2)
    assert turn(1.2) == pytest.approx([0.0, 0.0, 0.5])  # at the end: by the sample before
    assert not turn(1.3).any() and not speed(-5.0).any() and angle(-5.0) == pytest.approx(0.0)
    refused = clip.signal("hand", offset=0.4, stretch=2.0, beyond="refuse")
    refused.over(np.linspace(-0.8, 1.2, 5))
    with pytest.raises(
        ValueError, match=r"the clip lasts from 3 to 4 s, but 4\.05 s is asked for; shorten the horizon"
    ):
        refused(1.3)
    recorded = dataclasses.replace(clip.resampled(clip.times - 3.0))
    fast = recorded.signal("hand", "angular-velocity", stretch=0.5)
    assert fast(0.2) == pytest.approx([0.0, 0.0, 2.0]) and not fast(0.6).any()


def test_a_recorded_motion_costs_nothing(robot, motion):
    clip = Clip.record(motion, robot, FRAMES)
    terms = clip.costs(robot)
    assert len(terms) == 12 and {term.loss for term in terms} == {"pseudo-huber"}
    problem = mjslq.Problem(robot, N, motion.X[0], [*terms, costs.Control(1.0, motion.U)])
    assert problem.cost(motion) < 1e-20
    np.testing.assert_allclose(clip.guess(problem), motion.X, rtol=0, atol=1e-12)
    np.testing.assert_allclose(clip.states(robot, 0.1), motion.X[5], rtol=0, atol=1e-12)
    moved = problem.at(motion.X[0], 0.06)
    along = robot.rollout(motion.X[3], motion.U[3:])
    tail = mjslq.Problem(robot, N - 3, motion.X[3], terms).at(motion.X[3], 0.06)
    assert tail.cost(along) < 1e-16 and moved.cost(motion) > 0.1
    np.testing.assert_allclose(clip.guess(moved)[: N - 2], motion.X[3:], rtol=0, atol=1e-12)
    assert pickle.loads(pickle.dumps(problem)).cost(motion) == problem.cost(motion)


def test_a_clip_is_followed_from_a_file_in_ten_lines(robot, motion, tmp_path):
    Clip.record(motion, robot, FRAMES).save(tmp_path / "wave.csv", digits=6)
    clip = mjslq.clips.load(tmp_path / "wave.csv")
    engine = mjslq.MujocoDynamics.from_xml(ROBOT, substeps=2, frames=clip.frames)
    problem = mjslq.Problem(engine, N, clip.states(engine, 0.0), [costs.Control(1e-6), *clip.costs(engine)])
    result = mjslq.solve(problem, X0=clip.guess(problem), max_iterations=30)
    assert np.abs(result.trajectory.X - motion.X).max() < 1e-2
    by_controls = mjslq.solve(problem, max_iterations=30)
    assert np.abs(by_controls.trajectory.U - motion.U).max() < 0.05


def test_poses_alone_are_followed_with_velocities_by_differences(robot, motion):
    """This robot turns fast, so that differences over two steps are not its velocities: the hand is near, no more."""
    recorded = Clip.record(motion, robot, FRAMES)
    poses = {name: {of: f[of] for of in OF[:2]} for name, f in recorded.frames.items()}
    clip = dataclasses.replace(recorded, frames=poses)
    engine = mjslq.MujocoDynamics.from_xml(ROBOT, substeps=2, frames=clip.frames)  # sensors of velocities, too
    terms = clip.costs(engine)
    assert [term.of for term in terms] == [of for of in OF for _ in FRAMES]
    problem = mjslq.Problem(engine, N, motion.X[0], [costs.Control(1e-6), *terms])
    result = mjslq.solve(problem, X0=clip.guess(problem), max_iterations=30)
    tip = engine.outputs["tip.position"].columns
    away = np.linalg.norm(result.trajectory.Y[:, tip] - recorded.frames["tip"]["position"], axis=1)
    assert away.max() < 0.03 and problem.cost(motion) > 1e-3


def test_states_take_velocities_from_positions_where_none_are_recorded(robot, motion):
    clip = dataclasses.replace(Clip.record(motion, robot), qvel={})
    X = clip.states(robot, motion.times)
    V = robot.difference(motion.X[:-2], motion.X[2:])[:, : robot.nv] / (2 * robot.dt)
    np.testing.assert_allclose(X[1:-1, robot.model.nq :], V, rtol=0, atol=1e-10)
    first = robot.difference(motion.X[0], motion.X[1])[: robot.nv] / robot.dt
    np.testing.assert_allclose(X[0, robot.model.nq :], first, rtol=0, atol=1e-10)
    held = clip.states(robot, [-1.0, 1.0])
    np.testing.assert_allclose(held[:, : robot.model.nq], motion.X[[0, -1], : robot.model.nq], rtol=0, atol=1e-12)
    assert not held[:, robot.model.nq :].any()
    part = dataclasses.replace(clip, qpos={"shoulder": clip.qpos["shoulder"]}, qvel={"shoulder": np.full(N + 1, 7.0)})
    x = part.states(robot, 0.1, stretch=2.0)
    rest = robot.initial_state
    rest[7], rest[robot.model.nq + 6] = 0.5 * (motion.X[2, 7] + motion.X[3, 7]), 3.5
    np.testing.assert_allclose(x, rest, rtol=0, atol=1e-12)


def test_servos_follow_joint_signals(robot, motion):
    clip = Clip.record(motion, robot)
    signal = clip.joint_signal(["shoulder", "root.z"], offset=0.04)
    wanted = [motion.X[2:12, 7], motion.X[2:12, 2]]
    np.testing.assert_allclose(signal.over(motion.times[:10]), np.transpose(wanted), rtol=0, atol=1e-12)
    problem = mjslq.Problem(robot, 10, motion.X[0], [costs.Control(1.0, signal)])
    shifted = mjslq.Problem(robot, 10, motion.X[0], [costs.Control(1.0, np.transpose(wanted))])
    along = robot.rollout(motion.X[0], motion.U[:10])
    assert problem.cost(along) == pytest.approx(shifted.cost(along), rel=1e-12)


def test_names_weights_losses_and_widths(robot, motion):
    clip = Clip.record(motion, robot, FRAMES).renamed({"hand": "RightHand", "base": "Hips"})
    terms = clip.costs(
        robot, {"position": 3.0, "orientation": 2.0}, names={"RightHand": "hand"}, when="terminal",
        loss={"position": "huber"}, width={"position": 0.2}, offset=0.1,
    )  # fmt: skip
    assert [(t.name, t.of, t.weight, t.loss, t.width, t.when) for t in terms] == [
        ("hand", "position", 3.0, "huber", 0.2, "terminal"),
        ("hand", "orientation", 2.0, "quadratic", None, "terminal"),
    ]
    (last,) = clip.costs(robot, {"position": 3.0}, names={"Hips": "base"}, terminal=0.1)
    assert (last.when, last.terminal_weight) == ("always", pytest.approx(0.3)) and terms[0].terminal_weight is None
    np.testing.assert_allclose(terms[0].target(0.1), clip.frames["RightHand"]["position"][10], rtol=0, atol=1e-12)


def test_pinocchio_records_and_follows_what_it_reads():
    names = ("panda_hand_tcp", "panda_hand_tcp.orientation")
    panda = mjslq.PinocchioDynamics.from_path(mjslq.robot_path("panda"), 0.01, outputs=names)
    along = panda.rollout(panda.initial_state, np.full((10, panda.nu), 0.3))
    clip = Clip.record(along, panda, ["panda_hand_tcp"])
    assert list(clip.frames["panda_hand_tcp"]) == ["position", "orientation"]
    terms = clip.costs(panda, {"position": 1.0, "orientation": 1.0})
    assert mjslq.Problem(panda, 10, panda.initial_state, terms).cost(along) < 1e-20
    np.testing.assert_allclose(clip.states(panda, along.times), along.X, rtol=0, atol=1e-12)
    with pytest.raises(ValueError, match="not a frame's linear-velocity"):
        clip.costs(panda)


def test_a_receding_horizon_moves_along_a_clip():
    """A point mass follows a circle recorded at another rate, and stops where the clip ends."""
    xml = """<mujoco><option timestep="0.02" gravity="0 0 0"/><worldbody><body name="hand">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>
      <geom type="sphere" size=".1" mass="1"/></body></worldbody>
      <actuator><motor joint="x"/><motor joint="y"/></actuator></mujoco>"""
    mass = mjslq.MujocoDynamics.from_xml(xml, frames=["hand"])
    clip = turning(rate=12.0, duration=1.0)
    terms = clip.costs(mass, {"position": 100.0, "linear-velocity": 1.0}, stretch=1.5)
    problem = mjslq.Problem(mass, 25, [0.5, 0.0, 0.0, 1 / 3], [costs.Control(1e-4), *terms])
    loop = mjslq.MPC(problem, iterations=3, replan_every=5).run(duration=2.2)
    wanted = clip.signal("hand", stretch=1.5).over(loop.trajectory.times)[:, :2]
    assert np.abs(loop.trajectory.X[:, :2] - wanted).max() < 0.01
    assert np.abs(loop.trajectory.X[-1, 2:]).max() < 0.02
