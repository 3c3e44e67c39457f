"""What people hand in: URDF packages, meshes, mimic joints, links without inertia, mix-ups, files of other versions."""

import struct
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from mjslq import MujocoDynamics, PinocchioDynamics, Problem, costs, robot_path
from mjslq.dynamics.mujoco.files import load_model, urdf_spec
from mjslq.robots import robot_spec

TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
INERTIAL = """<inertial><origin xyz="0 0 -.1"/><mass value="1"/>
<inertia ixx=".01" ixy="0" ixz="0" iyy=".01" iyz="0" izz=".01"/></inertial>"""
LINK = '<link name="{}">' + INERTIAL + "</link>"


def joint(name, parent, child, extra=""):
    return (
        f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 -.2"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="20" velocity="5"/>{extra}'
        "</joint>"
    )


MIMIC = (
    '<robot name="r"><link name="base"/>' + "".join(map(LINK.format, ("l1", "l2", "l3"))) + joint("grip", "base", "l1")
    + joint("finger", "l1", "l2", '<mimic joint="grip" multiplier="-1" offset="0.1"/>') + joint("j3", "l1", "l3")
    + "</robot>"
)  # fmt: skip
MASSLESS = (
    '<robot name="r"><link name="base"/>' + LINK.format("l1") + '<link name="tip"/>' + joint("j1", "base", "l1")
    + joint("j2", "l1", "tip") + "</robot>"
)  # fmt: skip
PENDULUM = "<mujoco><worldbody><body><joint name='j'/><geom size='.1' pos='0 0 1'/></body></worldbody>{}</mujoco>"
MOTOR = "<actuator><motor joint='j'/></actuator>"


def meshed(tmp_path, *elements):
    """A pendulum whose link has these visual and collision meshes: (role, address)."""
    parts = [f'<{role}><geometry><mesh filename="{name}"/></geometry></{role}>' for role, name in elements]
    link = LINK.format("l1").replace("</link>", "".join(parts) + "</link>")
    file = tmp_path / "robots" / "r.urdf"
    file.parent.mkdir(exist_ok=True)
    file.write_text(f'<robot name="r"><link name="base"/>{link}{joint("j", "base", "l1")}</robot>')
    return file


def package(tmp_path, folder, suffix=".obj"):
    place = tmp_path / folder / "meshes"
    place.mkdir(parents=True)
    (place / f"arm{suffix}").write_text(TETRAHEDRON)
    return tmp_path / folder


# Meshes


def test_packages_are_found_where_they_are_said_to_be(tmp_path, monkeypatch):
    """Before: looked for above the file alone, and left out without a word, with `check` saying "contacts none"."""
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    folder = package(tmp_path, "elsewhere/bot")
    package(tmp_path, "prefix/share/bot")
    file = meshed(tmp_path, ("visual", "package://bot/meshes/arm.obj"), ("collision", "package://bot/meshes/arm.obj"))
    for packages in ({"bot": folder}, folder.parent, str(folder.parent), folder, [tmp_path, folder]):
        model = MujocoDynamics.from_path(file, packages=packages).model
        assert model.nmesh == 1 and model.ngeom == 2
    for variable, value in (
        ("ROS_PACKAGE_PATH", f"/nowhere:{folder.parent}"),
        ("ROS_PACKAGE_PATH", str(folder)),
        ("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path / 'prefix'}"),
    ):
        with monkeypatch.context() as patch:
            patch.setenv(variable, value)
            assert load_model(file).ngeom == 2
    with pytest.warns(UserWarning, match=r"^r.urdf: the \w+ mesh 'package://bot/meshes/arm.obj' is left out") as caught:
        assert load_model(file).ngeom == 0
    roles = [str(warning.message).split(" mesh ")[0].rsplit(" ", 1)[1] for warning in caught]
    assert roles == ["visual", "collision"] and all("packages=" in str(warning.message) for warning in caught)


def test_a_folder_by_name_goes_before_all_others(tmp_path):
    right, wrong = package(tmp_path, "right"), tmp_path / "bot"
    package(tmp_path, "bot", ".stl")
    file = meshed(tmp_path, ("visual", "package://bot/meshes/arm.obj"))
    spec = urdf_spec(file, packages={"bot": right})
    assert [mesh.file for mesh in spec.meshes] == [str(right / "meshes" / "arm.obj")] and wrong.is_dir()


def test_packages_that_are_no_folders_are_refused(tmp_path):
    file = meshed(tmp_path, ("visual", "package://bot/meshes/arm.obj"))
    for packages in (tmp_path / "none", {"bot": tmp_path / "none"}, [file]):
        with pytest.raises(ValueError, match=r"packages must name folders, but '.*' is none"):
            urdf_spec(file, packages=packages)


def test_meshes_that_cannot_be_read_are_named(tmp_path):
    """Each collision mesh by itself, since it costs contacts; visual ones of a kind in one line."""
    folder = package(tmp_path, "bot", ".dae")
    for name in ("a.dae", "b.dae", "c.stl"):
        (folder / "meshes" / name).write_text("text")
    addresses = {name: f"package://bot/meshes/{name}" for name in ("a.dae", "b.dae", "c.stl")}
    elements = [("visual", addresses["a.dae"]), ("visual", addresses["b.dae"]), ("visual", addresses["a.dae"])]
    elements += [("collision", addresses["a.dae"]), ("collision", addresses["c.stl"]), ("visual", "lost.obj")]
    with pytest.warns(UserWarning) as caught:
        model = load_model(meshed(tmp_path, *elements))
    assert model.ngeom == 0
    sentences = [str(warning.message) for warning in caught]
    assert len(sentences) == 4 and not any("\n" in sentence for sentence in sentences)
    assert "visual mesh 'package://bot/meshes/a.dae', 'package://bot/meshes/b.dae' is" in sentences[0]
    assert "cannot read .dae files" in sentences[0] and "looks" in sentences[0]
    assert "visual mesh 'lost.obj' is" in sentences[1] and "there is no such file in" in sentences[1]
    assert "collision mesh 'package://bot/meshes/a.dae' is" in sentences[2] and "contacts" in sentences[2]
    assert "cannot read STL text files" in sentences[3]


def test_robots_by_name_and_viewers_are_silent(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        robot_spec("panda").compile()
        file = meshed(tmp_path, ("collision", "package://bot/meshes/arm.obj"))
        assert PinocchioDynamics.from_path(file, 0.01).scene() is not None
    package(tmp_path, "else/bot")
    scene = PinocchioDynamics.from_path(file, 0.01, packages=tmp_path / "else").scene()
    assert len(scene.model) > len(PinocchioDynamics.from_path(file, 0.01).scene().model)


# Mimic joints, links without inertia


def test_followers_are_tied_in_both_engines(tmp_path):
    """Before: Pinocchio gave the follower a control of its own; then it was refused."""
    file = tmp_path / "mimic.urdf"
    file.write_text(MIMIC)
    tied = MujocoDynamics.from_path(file, timestep=0.001)
    assert tied.control_names == ("grip", "j3")
    x = tied.initial_state
    x[1] = 0.1
    end = tied.rollout(x, np.tile([3.0, 0.0], (200, 1))).X[-1]
    assert abs(end[0]) > 0.02 and end[1] == pytest.approx(0.1 - end[0], abs=2e-3)
    following = PinocchioDynamics.from_path(file, 0.001)
    assert following.control_names == ("grip", "j3") and following.state_names[:2] == ("grip", "j3")
    there = following.rollout(np.zeros(4), np.tile([3.0, 0.0], (200, 1))).X[-1]
    assert there[0] == pytest.approx(end[0], abs=2e-3)
    model = pin.buildModelFromXML(MIMIC, True)
    with pytest.raises(ValueError, match="joint 'finger' mimics another"):
        PinocchioDynamics.from_model(model, 0.001)
    free = PinocchioDynamics.from_path(file, 0.001, ["finger"])
    assert free.control_names == ("grip", "j3")


def test_followers_of_a_locked_joint_are_locked_where_it_puts_them(tmp_path):
    file = tmp_path / "mimic.urdf"
    file.write_text(MIMIC)
    ours = PinocchioDynamics.from_path(file, 0.01, {"grip": 0.5}, outputs=["l2"])
    theirs = PinocchioDynamics.from_path(file, 0.01, {"grip": 0.5, "finger": -0.4}, outputs=["l2"])
    assert ours.control_names == theirs.control_names == ("j3",)
    U = np.full((4, 1), 0.3)
    ours, theirs = (system.rollout(system.initial_state, U) for system in (ours, theirs))
    np.testing.assert_array_equal(ours.X, theirs.X)
    np.testing.assert_array_equal(ours.Y, theirs.Y)


def test_followers_of_followers_are_locked_too(tmp_path):
    file, last = tmp_path / "mimic.urdf", joint("last", "l2", "l4", '<mimic joint="finger" multiplier="2"/>')
    file.write_text(MIMIC.replace("</robot>", last + LINK.format("l4") + "</robot>"))
    ours = PinocchioDynamics.from_path(file, 0.01, {"grip": 0.5}, outputs=["l4"])
    theirs = PinocchioDynamics.from_path(file, 0.01, {"grip": 0.5, "finger": -0.4, "last": -0.8}, outputs=["l4"])
    assert ours.control_names == ("j3",)
    ours, theirs = (system.rollout(system.initial_state, np.ones((2, 1))) for system in (ours, theirs))
    np.testing.assert_array_equal(ours.Y, theirs.Y)
    assert PinocchioDynamics.from_path(file, 0.01, ["j3"]).state_names == ("grip", "grip.vel")


@pytest.mark.parametrize("engine", [MujocoDynamics, PinocchioDynamics])
def test_links_without_inertia_are_named(engine, tmp_path):
    """Before: MuJoCo moved 1e-12 kg, and `check` exited 1 without saying why."""
    file = tmp_path / "massless.urdf"
    file.write_text(MASSLESS)
    with pytest.raises(ValueError, match=r"joint 'j2' moves no mass \(.*: tip\); .*armature"):
        engine.from_path(file, timestep=0.01)
    assert urdf_spec(file, armature=0.01).compile().nv == 2


# Mix-ups


def test_what_is_for_another_constructor_is_sent_there(tmp_path):
    spec = mujoco.MjSpec.from_string(PENDULUM.format(MOTOR))
    model, make = spec.compile(), MujocoDynamics
    for call, given, sentence in (
        (
            make.from_model,
            spec,
            "from_model takes a compiled mujoco.MjModel, got an MjSpec; use MujocoDynamics.from_spec",
        ),
        (
            make.from_spec,
            model,
            "from_spec takes an mujoco.MjSpec, got a compiled MjModel; use MujocoDynamics.from_model",
        ),
        (make.from_path, model, "got a compiled MjModel; use MujocoDynamics.from_model"),
        (make.from_path, spec, "got an MjSpec; use MujocoDynamics.from_spec"),
        (make.from_path, PENDULUM, "got XML text; use MujocoDynamics.from_xml"),
        (make.from_xml, "arm.xml", "from_xml takes MJCF text, got the path 'arm.xml'; use MujocoDynamics.from_path"),
        (make.from_xml, tmp_path / "arm.xml", "use MujocoDynamics.from_path"),
        (make.from_model, "arm.xml", "use MujocoDynamics.from_path"),
        (make.from_model, None, "from_model takes a compiled mujoco.MjModel, got NoneType"),
        (make.from_spec, 3, "got int"),
    ):
        with pytest.raises(ValueError) as caught:
            call(given)
        assert sentence in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(
        ValueError, match=r"from_path takes the path of a \.urdf file, got a pinocchio.Model; from_model"
    ):
        PinocchioDynamics.from_path(pin.buildSampleModelManipulator(), 0.01)


@pytest.mark.parametrize("number, version", [(332, "3.3.2"), (3010002, "3.10.2")])
def test_binary_models_of_another_version_name_both(tmp_path, number, version):
    model, file = mujoco.MjModel.from_xml_string(PENDULUM.format(MOTOR)), tmp_path / "old.mjb"
    mujoco.mj_saveModel(model, str(file))
    assert MujocoDynamics.from_path(file).nu == 1
    data = bytearray(file.read_bytes())
    data[12:16] = struct.pack("<i", number)
    file.write_bytes(data)
    with pytest.raises(ValueError, match=f"old.mjb was written by MuJoCo {version} and MuJoCo {mujoco.__version__} is"):
        MujocoDynamics.from_path(file)


def test_warnings_of_mujocos_compiler_are_one_line_each(tmp_path):
    text = PENDULUM.format(MOTOR + "<statistic meaninertia='2'/><compiler settotalmass='3'/>")
    (tmp_path / "old.xml").write_text(text)
    for make, name in ((lambda: MujocoDynamics.from_xml(text), "the XML text"),
                       (lambda: MujocoDynamics.from_path(tmp_path / "old.xml"), "old.xml")):  # fmt: skip
        with pytest.warns(UserWarning, match=rf"^MuJoCo on {name}: .*deprecated") as caught:
            make()
        assert len(caught) == 2 and not any("\n" in str(warning.message) for warning in caught)


# Orientation actuators


def test_quaternion_controls_start_at_the_identity():
    """Before: at zeros, which are no orientation."""
    body = "<worldbody><body><joint name='j' type='ball'/><geom size='.1' pos='0 0 1'/></body></worldbody>"
    actuators = "<actuator><general joint='j'/><orientation joint='j' input='quat'/><orientation joint='j'/></actuator>"
    system = MujocoDynamics.from_xml(f"<mujoco>{body}{actuators}</mujoco>")
    np.testing.assert_array_equal(system.initial_control, [0, 1, 0, 0, 0, 0, 0, 0])
    problem = Problem(system, 3, system.initial_state, [costs.Control(1.0)])
    np.testing.assert_array_equal(problem.U0, np.tile(system.initial_control, (3, 1)))
    assert not PinocchioDynamics.from_path(robot_path("ur5"), 0.01).initial_control.any()


def test_a_model_is_told_how_to_become_a_problem(capsys, monkeypatch):
    from mjslq import cli

    for command in ("solve", "compare"):
        monkeypatch.setattr("sys.argv", ["mjslq", command, str(Path("my.xml"))])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr().err
        assert ended.value.code == 2 and said.count("\n") == 1
        assert "'my.xml' is a model" in said and "mjslq.Problem(mjslq.MujocoDynamics.from_path('my.xml')" in said
