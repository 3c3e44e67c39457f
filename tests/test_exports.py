"""Results as tables, policies, pictures and films: what is in the files, and what is refused."""

from __future__ import annotations

import dataclasses
import sys

import mujoco
import numpy as np
import pytest
from PIL import Image

import mjslq
from mjslq.exports import OPTIONS, opengl
from mjslq.exports.motion import Motion
from mjslq.exports.table import columns, sensor_units

ARM = """
<mujoco model="arm"><option timestep="0.02"/><worldbody>
  <camera name="side" pos="0 -3 0" xyaxes="1 0 0 0 0 1"/>
  <body name="upper"><joint name="shoulder" axis="0 1 0" damping=".1"/>
    <geom type="capsule" size=".05" fromto="0 0 0 .5 0 0" rgba="1 .3 0 1"/><site name="hand" pos=".5 0 0"/></body>
  <body name="box" pos="0 1 0"><freejoint name="root"/><geom type="box" size=".1 .1 .1" rgba="0 .3 1 1"/></body>
</worldbody><actuator><motor name="motor" joint="shoulder" ctrlrange="-5 5"/></actuator>
<sensor><framepos name="hand" objtype="site" objname="hand"/><jointvel name="rate" joint="shoulder"/></sensor></mujoco>
"""


@pytest.fixture(scope="module")
def arm():
    dynamics = mjslq.MujocoDynamics.from_xml(ARM)
    costs = [mjslq.costs.Control(1e-3), mjslq.costs.Sensor("rate", 2.0, 1.0)]
    return mjslq.solve(mjslq.Problem(dynamics, 20, dynamics.initial_state, costs, name="arm"))


@pytest.fixture(scope="module")
def curve():
    """A result of equations, with nothing to draw."""
    return dataclasses.replace(mjslq.solve(mjslq.problems.get("van_der_pol")), scene=None)


@pytest.fixture
def opengl_here(arm):
    model = mujoco.MjModel.from_xml_string(ARM)
    try:
        context, rendering = opengl.open_context(model, 16, 16)
    except ValueError as error:
        pytest.skip(str(error))
    rendering.free()
    context.free()


def test_table_is_read_back_to_the_last_bit(arm, tmp_path):
    mjslq.export(arm, tmp_path / "arm.csv")
    names = (tmp_path / "arm.csv").read_text().splitlines()[0].split(",")
    assert names[:3] == ["time [s]", "shoulder [rad]", "root.x [m]"] and len(set(names)) == len(names)
    assert {"shoulder.vel [rad/s]", "root.qw", "control motor [Nm]", "sensor rate [rad/s]"} <= set(names)
    table = np.genfromtxt(tmp_path / "arm.csv", delimiter=",", names=True, deletechars="", replace_space=" ")
    assert list(table.dtype.names) == names
    t = arm.trajectory
    np.testing.assert_array_equal(table["time [s]"], t.times)
    np.testing.assert_array_equal(np.stack([table[name] for name in names[1 : 1 + t.X.shape[1]]], axis=1), t.X)
    np.testing.assert_array_equal(table["control motor [Nm]"][:-1], t.U[:, 0])
    assert np.isnan(table["control motor [Nm]"][-1])
    np.testing.assert_array_equal(np.stack([table[name] for name in names[-t.Y.shape[1] :]], axis=1), t.Y)


def test_table_of_a_motion_that_diverged_has_empty_cells(curve, tmp_path):
    X = curve.trajectory.X.copy()
    X[5:] = np.nan
    lost = dataclasses.replace(curve, trajectory=dataclasses.replace(curve.trajectory, X=X, diverged_at=5))
    mjslq.export(lost, tmp_path / "lost.csv")
    rows = (tmp_path / "lost.csv").read_text().splitlines()
    assert rows[5].split(",")[1] != "" and rows[6].split(",")[1:3] == ["", ""]


def test_names_in_a_table_end_where_they_should(curve):
    names = {"states": ('a,"b"', "a #1"), "controls": ("x",), "outputs": ()}
    assert columns(dataclasses.replace(curve, names=names))[1:3] == ["a;'b'", "a _1"]
    twice = {"states": ("a", "a"), "controls": ("a",), "outputs": ()}
    assert columns(dataclasses.replace(curve, names=twice))[1:4] == ["a", "a 2", "control a"]


def test_units_of_sensors():
    model = mujoco.MjModel.from_xml_string(ARM)
    assert sensor_units(model) == ["m", "m", "m", "rad/s"]


def test_policy_needs_nothing_but_numpy(arm, tmp_path):
    mjslq.export(arm, tmp_path / "policy.npz")
    again, x, t = mjslq.Policy.load(tmp_path / "policy.npz"), arm.trajectory.X[3] + 0.01, 0.06
    assert (again(x, t) == arm.policy(x, t)).all() and (again(x, 0.0713) == arm.policy(x, 0.0713)).all()
    p = np.load(tmp_path / "policy.npz")  # as a robot's computer would
    model, nq, n = mujoco.MjModel.from_xml_string(ARM), 8, 3
    dq = np.zeros(model.nv)
    mujoco.mj_differentiatePos(model, dq, 1.0, p["X"][n, :nq], x[:nq])
    u = p["U"][n] - p["K"][n] @ np.concatenate([dq, x[nq:] - p["X"][n, nq:]])
    np.testing.assert_allclose(np.clip(u, p["lower"][n], p["upper"][n]), arm.policy(x, t), rtol=1e-12)


def test_policy_without_feedback_and_other_files(arm, curve, tmp_path):
    still = mjslq.Policy(curve.trajectory.X, curve.trajectory.U, dt=curve.trajectory.dt)
    still.save(tmp_path / "still.npz")
    again = mjslq.Policy.load(tmp_path / "still.npz")
    assert again(curve.trajectory.X[2] + 1.0, 0.0) == still(curve.trajectory.X[2] + 1.0, 0.0)
    arm.save(tmp_path / "whole.npz")
    (tmp_path / "text.npz").write_text("no policy")
    np.savez(tmp_path / "part.npz", policy_format=np.array(1), X=np.zeros((2, 1)))
    np.savez(tmp_path / "new.npz", policy_format=np.array(99))
    for name, said in [
        ("whole", r"a whole result, whose policy is mjslq.load"),
        ("text", "it is no .npz file"),
        ("part", "not a policy saved by mjslq .*U"),
        ("new", "format 99"),
    ]:
        with pytest.raises(ValueError, match=said):
            mjslq.Policy.load(tmp_path / f"{name}.npz")
    with pytest.raises(FileNotFoundError, match="there is no file"):
        mjslq.Policy.load(tmp_path / "missing.npz")


def test_poses_between_knots_turn_evenly(arm):
    model = mujoco.MjModel.from_xml_string(ARM)
    motion = Motion(model, arm)
    np.testing.assert_array_equal(motion(0.0), motion.qpos[0])
    np.testing.assert_allclose(motion(motion.duration + 1.0), motion.qpos[-1])
    X = arm.trajectory.X.copy()
    half = np.sqrt(0.5)
    X[1, 4:8] = [half, 0.0, 0.0, half]  # the box turns by 90 degrees in the first step
    turned = Motion(model, dataclasses.replace(arm, trajectory=dataclasses.replace(arm.trajectory, X=X)))
    np.testing.assert_allclose(turned(0.01)[4:8], [np.cos(np.pi / 8), 0.0, 0.0, np.sin(np.pi / 8)], atol=1e-12)


def orange(picture):
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    return int(((red > 120) & (red > green + 50) & (red > blue + 50)).sum())


def test_picture_of_a_moment_and_of_several(arm, tmp_path, opengl_here):
    for name, options in (("first", {"at": 0.0}), ("last", {"at": 0.4}), ("many", {}), ("side", {"camera": "side"})):
        mjslq.export(arm, tmp_path / f"{name}.png", size=(320, 240), **options)
    pictures = {}
    for file in tmp_path.iterdir():
        with Image.open(file) as picture:
            pictures[file.stem] = np.asarray(picture)
    assert all(picture.shape == (240, 320, 3) and orange(picture) > 200 for picture in pictures.values())
    moved = np.abs(pictures["first"].astype(int) - pictures["last"]).max(axis=2) > 40
    assert moved.sum() > 200
    assert orange(pictures["many"]) > 1.3 * orange(pictures["last"])  # ghosts are of its colour, too
    corner = pictures["last"][:20, :20].reshape(-1, 3)
    assert corner.min() > 225  # what is behind is bright, whatever the lamps are
    assert (pictures["side"] != pictures["many"]).any()


def test_collision_shapes_are_drawn_where_there_is_nothing_else(tmp_path, opengl_here):
    found = {}
    for group in (0, 3):
        dynamics = mjslq.MujocoDynamics.from_xml(ARM.replace("<geom ", f'<geom group="{group}" '))
        problem = mjslq.Problem(dynamics, 5, dynamics.initial_state, [mjslq.costs.Control(1.0)])
        mjslq.export(mjslq.solve(problem), tmp_path / "arm.png", size=(160, 120), at=0.0)
        with Image.open(tmp_path / "arm.png") as picture:
            found[group] = np.asarray(picture)
    assert orange(found[3]) > 100 and np.array_equal(found[0], found[3])


def test_gif_has_a_picture_each_step(arm, tmp_path, opengl_here):
    shares = []
    mjslq.export(arm, tmp_path / "arm.gif", size=(160, 120), fps=10, progress=shares.append)
    assert shares == pytest.approx([0.2, 0.4, 0.6, 0.8, 1.0])
    with Image.open(tmp_path / "arm.gif") as film:
        assert film.n_frames == 5 and film.info["duration"] == 100 and film.info["loop"] == 0  # 0.4 s and both ends
        first = np.asarray(film.convert("RGB")).astype(int)
        film.seek(4)
        last = np.asarray(film.convert("RGB")).astype(int)
    assert (np.abs(last - first).max(axis=2) > 40).sum() > 100


def test_mp4_plays_at_the_speed_asked_for(arm, tmp_path, opengl_here):
    av = pytest.importorskip("av", reason="the package av is not installed")
    mjslq.export(arm, tmp_path / "arm.mp4", size=(160, 120), fps=30, speed=0.5)
    with av.open(str(tmp_path / "arm.mp4")) as film:
        track = film.streams.video[0]
        assert (track.codec_context.name, track.width, track.height) == ("h264", 160, 120)
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(track)]
    assert len(frames) == 25  # 0.8 s of film, and both ends
    assert orange(frames[0]) > 100 and (np.abs(frames[0].astype(int) - frames[-1]).max(axis=2) > 40).sum() > 100


@pytest.mark.parametrize("ending", [".gif", ".mp4"])
def test_interrupted_film_leaves_nothing(arm, tmp_path, opengl_here, ending):
    if ending == ".mp4":
        pytest.importorskip("av", reason="the package av is not installed")

    def interrupt(share):
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mjslq.export(arm, tmp_path / f"arm{ending}", size=(160, 120), progress=interrupt)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "name, options, said",
    [
        ("arm.avi", {}, r"unknown ending of an exported file '.avi'; there are: .html, .mp4"),
        ("arm", {}, "unknown ending of an exported file ''"),
        ("arm.csv", {"fps": 3.0}, "fps is an option of .mp4 and .gif files, not of .csv files"),
        ("arm.gif", {"poses": 3}, "poses is an option of .png files, not of .gif files"),
        ("arm.png", {"speed": 3.0}, "speed is an option of .mp4 and .gif files, not of .png"),
        ("arm.png", {"at": 0.5}, "at must be from 0 to 0.4 s"),
        ("arm.png", {"at": np.nan}, "at must be finite"),
        ("arm.png", {"poses": 0}, "poses must be a whole number of at least 1"),
        ("arm.png", {"camera": "front"}, "unknown camera 'front'; there are: side"),
        ("arm.png", {"size": 3}, "size must be a width and a height"),
        ("arm.png", {"size": (320, 2)}, "height must be a whole number of at least 16"),
        ("arm.png", {"size": (320, 9000)}, "size must be at most 8192 x 8192"),
        ("arm.gif", {"fps": 100.0}, "fps must be at most 50"),
        ("arm.gif", {"fps": 0.0}, "fps must be positive"),
        ("arm.gif", {"speed": -1.0}, "speed must be positive"),
        ("arm.gif", {"speed": 1e-7}, "a lower fps or a higher speed makes it shorter"),
        ("none/arm.csv", {}, "cannot write .*there is no folder"),
    ],
)
def test_wrong_options_are_one_sentence(arm, tmp_path, name, options, said):
    with pytest.raises(ValueError, match=said):
        mjslq.export(arm, tmp_path / name, **options)
    assert not list(tmp_path.iterdir())


def test_what_cannot_be_drawn(arm, curve, tmp_path, monkeypatch):
    for name in ("curve.png", "curve.gif"):
        with pytest.raises(ValueError, match=r"has no model to draw; .html and .csv files show its curves"):
            mjslq.export(curve, tmp_path / name)
    with pytest.raises(ValueError, match="only a Result"):
        mjslq.export(arm.trajectory, tmp_path / "arm.csv")
    monkeypatch.setattr(opengl, "ways", lambda: ("nowhere",))
    with pytest.raises(ValueError, match=r"none could be opened .nowhere: .*set MUJOCO_GL to egl"):
        mjslq.export(arm, tmp_path / "arm.png")
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ImportError, match=r"need the package av, which `pip install .mjslq\[video\].` brings"):
        mjslq.export(arm, tmp_path / "arm.mp4")
    assert not list(tmp_path.iterdir())


def test_way_to_opengl_follows_the_machine(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("MUJOCO_GL", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert opengl.ways() == ("egl",)
    monkeypatch.setenv("DISPLAY", ":0")
    assert opengl.ways() == ("glfw", "egl")
    monkeypatch.setenv("MUJOCO_GL", "OSMesa")
    assert opengl.ways() == ("osmesa",)


def test_every_ending_is_described():
    for ending in OPTIONS:
        assert f"`{ending}`" in mjslq.export.__doc__
