"""Clips as files: CSV and npz come back as they were, and each wrong one is told in a sentence."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import mjslq
from mjslq.clips import Clip

OF = ("position", "orientation", "linear-velocity", "angular-velocity")


def clip_of(seed, T=5):
    rng = np.random.default_rng(seed)
    Q = rng.standard_normal((T, 4))
    Q /= np.linalg.norm(Q, axis=1, keepdims=True)
    P, V, W = rng.standard_normal((3, T, 3))
    frames = {"pelvis": dict(zip(OF, (P, Q, V, W), strict=True)), "left.hand": {"position": V}}
    qpos = {"knee": P[:, 0], "root.x": P[:, 1]} | {f"root.{e}": Q[:, i] for i, e in enumerate(("qw", "qx", "qy", "qz"))}
    return Clip(rng.uniform(-5, 5) + np.cumsum(rng.uniform(0.01, 0.1, T)), frames, qpos, {"knee": P[:, 2]}, "wave")


def same(ours, theirs, atol=0.0):
    np.testing.assert_allclose(ours.times, theirs.times, rtol=0, atol=atol)
    assert list(ours.frames) == list(theirs.frames) and ours.name == theirs.name
    for frame, quantities in theirs.frames.items():
        assert list(ours.frames[frame]) == list(quantities)
        for of, samples in quantities.items():
            np.testing.assert_allclose(ours.frames[frame][of], samples, rtol=0, atol=atol)
    for kind in ("qpos", "qvel"):
        assert list(getattr(ours, kind)) == list(getattr(theirs, kind))
        for entry, samples in getattr(theirs, kind).items():
            np.testing.assert_allclose(getattr(ours, kind)[entry], samples, rtol=0, atol=atol)


@given(st.integers(0, 2**32 - 1), st.sampled_from(["csv", "npz"]))
@settings(max_examples=20)
def test_files_come_back_as_they_were(tmp_path_factory, seed, ending):
    clip, path = clip_of(seed), tmp_path_factory.mktemp("clips") / f"wave.{ending}"
    clip.save(path)
    same(mjslq.clips.load(path), clip)


def test_rounded_files_come_back_to_their_digits(tmp_path):
    clip = clip_of(0)
    clip.save(tmp_path / "wave.csv", digits=4)
    same(mjslq.clips.load(tmp_path / "wave.csv"), clip, 1e-4)
    assert max(len(cell) for cell in (tmp_path / "wave.csv").read_text().splitlines()[2].split(",")) <= 7


def test_a_file_made_by_others(tmp_path):
    """Columns in any order, comments, a byte-order mark, blanks; npz without a format."""
    text = "\ufeff# made by a suit\nhead.z, head.x,time,head.y\n3,1,10.0,2\n\n# later\n 6, 4,10.5, 5\n"
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    clip = mjslq.clips.load(tmp_path / "a.csv")
    assert clip.duration == 0.5 and np.array_equal(clip.frames["head"]["position"], [[1, 2, 3], [4, 5, 6]])
    np.savez(tmp_path / "a.npz", time=[0, 1], **{"head.linear_velocity": np.eye(3)[:2]})
    clip = mjslq.clips.load(tmp_path / "a.npz")
    assert np.array_equal(clip.frames["head"]["linear-velocity"], np.eye(3)[:2])
    assert repr(clip) == "Clip('a', 2 samples over 1 s, 1 frames, 0 joint positions)"


GOOD = "time,pelvis.x,pelvis.y,pelvis.z,pelvis.qw,pelvis.qx,pelvis.qy,pelvis.qz,qpos.knee"
ROWS = ["0,1,2,3,1,0,0,0,.1", "0.1,1,2,3,1,0,0,0,.2", "0.2,1,2,3,0.8,0.6,0,0,.3"]
WRONG_CSV = {
    "no time": (GOOD.replace("time", "t"), ROWS, "there is no column 'time'; there are: t, pelvis.x"),
    "missing": (GOOD.replace("pelvis.z", "qpos.hip"), ROWS, "the position of 'pelvis' is not whole: there is no"),
    "unknown": (GOOD.replace("pelvis.z", "pelvis.zz"), ROWS, "the column 'pelvis.zz' is neither 'time'"),
    "twice": (GOOD.replace("pelvis.z", "pelvis.x"), ROWS, "the column 'pelvis.x' is there twice"),
    "nan": (GOOD, [ROWS[0], ROWS[1].replace(".2", "nan")], "line 3, column 'qpos.knee': must be finite, got nan"),
    "text": (GOOD, [ROWS[0], ROWS[1].replace(".2", "far")], "line 3, column 'qpos.knee': 'far' is no number"),
    "short": (GOOD, [ROWS[0], ROWS[1][:-3]], "line 3 has 8 entries, but there are 9 columns"),
    "not increasing": (GOOD, [ROWS[0], ROWS[2], ROWS[1]], r"times must increase, but times[2] = 0.1 follows 0.2"),
    "length": (GOOD, [ROWS[0], ROWS[2].replace("0.8", "0.9")],
               "orientation of 'pelvis' must be unit quaternions (w, x, y, z), but sample 1 has the length 1.082"),
    "one": (GOOD, ROWS[:1], "times must have at least 2 samples, got 1"),
    "none": (GOOD, [], "there must be a line of column names and lines of numbers below it"),
    "only time": ("time", ["0", "1"], "a clip must have at least one frame or joint"),
    "part": (GOOD.replace("qpos.knee", "qpos.root.qw"), ROWS, "the quaternion of qpos 'root' is not whole: root.qx"),
    "called time": (GOOD.replace("pelvis.", "time."), ROWS, "a frame cannot be called 'time'"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG_CSV)
def test_one_sentence_for_each_wrong_csv(tmp_path, case):
    header, rows, told = WRONG_CSV[case]
    (tmp_path / "wave.csv").write_text("\n".join([header, *rows]))
    with pytest.raises(ValueError) as caught:
        mjslq.clips.load(tmp_path / "wave.csv")
    message = str(caught.value)
    assert message.startswith(f"wave.csv: {told}") and "\n" not in message


@pytest.mark.parametrize(
    "arrays, told",
    [
        ({"head.position": np.eye(3)}, "there is no array 'time'; there are: head.position"),
        ({"time": np.arange(3.0), "head.place": np.eye(3)}, "the array 'head.place' is neither 'time'"),
        ({"time": np.arange(3.0), "head.position": np.eye(4)[:3]}, "position of 'head' must have shape (3, 3), got"),
        ({"time": np.arange(3.0), "head.position": np.full((3, 3), np.nan)}, "position of 'head' must be finite"),
        ({"time": np.arange(3.0), "qpos.knee": np.eye(3)}, "qpos of 'knee' must have shape (3,), got (3, 3)"),
        ({"time": np.arange(3.0), "qpos.knee": np.arange(3.0), "format": 7}, "has the format 7, this version of mjslq"),
        (
            {"time": np.arange(3.0), "qpos.knee": np.array([None, 1, 2])},
            "is not a recorded motion (Object arrays cannot be",
        ),
        ({"time": np.array(["a", "b", "c"]), "qpos.knee": np.arange(3.0)}, "times must be an array of numbers"),
    ],
)
def test_one_sentence_for_each_wrong_npz(tmp_path, arrays, told):
    np.savez(tmp_path / "wave.npz", **arrays)
    with pytest.raises(ValueError) as caught:
        mjslq.clips.load(tmp_path / "wave.npz")
    assert told in str(caught.value) and "wave.npz" in str(caught.value) and "\n" not in str(caught.value)


def test_truncated_foreign_and_missing_files(tmp_path):
    clip_of(0).save(tmp_path / "wave.npz")
    whole = (tmp_path / "wave.npz").read_bytes()
    for size in (len(whole) - 30, len(whole) // 2, 10, 0):
        (tmp_path / "part.npz").write_bytes(whole[:size])
        with pytest.raises(ValueError, match=r"part\.npz is not a recorded motion \("):
            mjslq.clips.load(tmp_path / "part.npz")
    (tmp_path / "wave.csv").write_bytes(whole)
    with pytest.raises(ValueError, match=r"^wave.csv: it is no text file"):
        mjslq.clips.load(tmp_path / "wave.csv")
    with pytest.raises(ValueError, match=r"clip file '.*gone.csv' does not exist"):
        mjslq.clips.load(tmp_path / "gone.csv")
    for path in ("wave.bvh", "wave"):
        with pytest.raises(ValueError, match=r"a clip's file must end in .npz or .csv, got"):
            mjslq.clips.load(tmp_path / path)
        with pytest.raises(ValueError, match=r"a clip's file must end in .npz or .csv, got"):
            clip_of(0).save(tmp_path / path)
    with pytest.raises(ValueError, match="cannot write"):
        clip_of(0).save(tmp_path / "no" / "wave.csv")


ARM = """<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/><geom size=".1" mass="1"/>
  <site name="tip" pos=".3 0 0"/></body></worldbody><actuator><motor joint="hinge"/></actuator></mujoco>"""
DEEP = {"tip": {"position": np.eye(3)}}


@pytest.mark.parametrize(
    "use, told",
    [
        (lambda c, arm: c.costs(arm, names={"tipp": "tip"}), r"unknown frame of 'clip' 'tipp'; there are: tip, toe"),
        (lambda c, arm: c.costs(arm), r"unknown site, body, geom or camera 'toe'; there are: tip, arm"),
        (lambda c, arm: c.costs(arm, names={"toe": "tip", "tip": "tip"}), "names must lead to different frames"),
        (lambda c, arm: c.costs(arm, {"orientation": 1.0}), "'clip' has no orientation of any frame"),
        (lambda c, arm: c.costs(arm, {"place": 1.0}), "unknown quantity in weights 'place'; there are: position"),
        (lambda c, arm: c.costs(arm, {"position": -1.0}), "weight of 'position' must be at least 0, got -1.0"),
        (lambda c, arm: c.costs(arm, {"position": 0.0}, names={"tip": "tip"}), "there is nothing to track"),
        (lambda c, arm: c.costs(arm, 3.0), "weights must be a mapping from quantities of frames, such as 'position'"),
        (lambda c, arm: c.signal("tip", "orientation"), "'clip' has no orientation of 'tip'; it has: position"),
        (lambda c, arm: c.signal("tap"), "unknown frame of 'clip' 'tap'"),
        (lambda c, arm: c.joint_signal(["knee"]), "unknown joint position of 'clip' 'knee'; there are: elbow"),
        (lambda c, arm: c.states(arm, 0.0), "unknown joint position of the robot 'elbow'; there are: hinge"),
        (lambda c, arm: Clip(c.times, DEEP).states(arm, 0.0), "'clip' has no joint positions"),
        (lambda c, arm: Clip(c.times, {}, {"hinge": c.times}, {"hing": c.times}).states(arm, 0.0),
         "unknown velocity of the robot 'hing'; there are: hinge; did you mean 'hinge'"),
        (lambda c, arm: c.resampled([0.0]), "times must be at least two, and increase"),
        (lambda c, arm: c.resampled([0.0, 1.0], stretch=0.0), "stretch must be positive"),
        (lambda c, arm: c.resampled([0.0, 1.0], beyond="stop"), "unknown way to go beyond a clip 'stop'; there"),
        (lambda c, arm: c.resampled([0.0, 5.0], beyond="refuse"), "the clip lasts from 0 to 2 s, but 5 s is asked for"),
        (lambda c, arm: Clip.record(c, arm), "motion must be a Trajectory, or have one as a Result does, got Clip"),
        (lambda c, arm: Clip(c.times, {"tip": {"place": np.eye(3)}}), "unknown quantity of frame 'tip' 'place'"),
        (lambda c, arm: Clip(c.times, {"": DEEP["tip"]}), "a frame's name must be a text that is not empty"),
    ],
)  # fmt: skip
def test_one_sentence_for_each_wrong_use(use, told):
    arm = mjslq.MujocoDynamics.from_xml(ARM, frames=["tip"])
    clip = Clip(np.arange(3.0), {"tip": {"position": np.eye(3)}, "toe": {"position": np.eye(3)}}, {"elbow": np.ones(3)})
    with pytest.raises(ValueError) as caught:
        use(clip, arm)
    assert str(caught.value).startswith(told) and "\n" not in str(caught.value)
