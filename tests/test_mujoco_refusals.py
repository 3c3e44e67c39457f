"""What MujocoDynamics refuses, and what it does when a simulation goes wrong."""

import os

import mujoco
import numpy as np
import pytest

from mjslq.dynamics.mujoco import MujocoDynamics

TEMPLATE = """
<mujoco>{head}<worldbody><body><joint name="j" axis="0 1 0" {joint}/><geom size="0.1" mass="1" pos="0.2 0 0"/></body>
</worldbody><actuator>{actuator}</actuator></mujoco>"""
UNSTABLE = '<option timestep="0.05"/>'


def xml(head="", joint="", actuator='<motor name="m" joint="j"/>'):
    return TEMPLATE.format(head=head, joint=joint, actuator=actuator)


@pytest.mark.parametrize(
    "text, reason",
    [
        (xml('<option><flag sleep="enable"/></option>'), 'sleeping is enabled.*sleep="disable"'),
        (xml(actuator='<motor joint="j" nsample="4" delay="0.004"/>'), "delay keep a history.*nsample"),
        (xml(joint='stiffness="5" springyield="0.1"'), "plastic springs.*springyield"),
        ("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>", "no joints"),
    ],
)
def test_models_that_hold_more_than_the_state_are_refused(text, reason):
    with pytest.raises(ValueError, match=f"^this model is not supported: .*{reason}"):
        MujocoDynamics.from_xml(text)


@pytest.mark.parametrize("tie", ["connect", "weld"])
def test_ties_of_bodies_that_turn_about_their_centres_are_left_to_transition(tie):
    wheel = '<body name="{0}" pos="0 {1} 0"><joint name="{0}" axis="0 1 0"/><geom size=".1"/></body>'
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody>{wheel.format("a", 0)}{wheel.format("b", 1)}</worldbody>
        <equality><{tie} body1="a" body2="b" anchor=".1 0 0"/></equality><actuator><motor joint="a"/></actuator>
        </mujoco>"""
    )
    assert MujocoDynamics.from_model(model).jacobian == "transition"
    with pytest.raises(ValueError, match="without inverse weight"):
        MujocoDynamics.from_model(model, jacobian="inverse")
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EQUALITY
    assert MujocoDynamics.from_model(model).jacobian == "inverse"


def test_older_convex_collisions_are_left_to_transition():
    model = mujoco.MjModel.from_xml_string(xml().replace('size="0.1"', 'type="cylinder" size="0.1 0.1"'))
    assert MujocoDynamics.from_model(model).jacobian == "inverse"
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_NATIVECCD
    assert MujocoDynamics.from_model(model).jacobian == "transition"
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_MULTICCD
    assert MujocoDynamics.from_model(model).jacobian == "inverse"


FALLING = """<mujoco><option noslip_iterations="5"/><worldbody><geom type="plane" size="1 1 1" condim="{dim}"/>
  <body pos="0 0 .099"><freejoint/><geom size=".1" condim="1"/><body><joint axis="1 0 0" {joint}/>
  <geom size=".05" pos=".2 0 0" contype="0" conaffinity="0"/></body></body></worldbody></mujoco>"""


@pytest.mark.parametrize("dim, joint, served", [(1, "", "inverse"), (3, "", "transition"),
                                                (1, 'frictionloss=".1"', "transition")])  # fmt: skip
def test_noslip_iterations_matter_where_there_is_friction(dim, joint, served):
    """Without it the step is the same, which the Jacobians through the inverse dynamics rely on."""
    dynamics = MujocoDynamics.from_xml(FALLING.format(dim=dim, joint=joint))
    assert dynamics.jacobian == served
    plain = MujocoDynamics.from_xml(FALLING.format(dim=dim, joint=joint).replace('"5"', '"0"'))
    x0 = dynamics.initial_state
    x0[dynamics.model.nq :] = 0.3, 0.1, -0.2, 0.5, 0.4, 0.3, 1.0
    ours, theirs = (system.rollout(x0, np.zeros((20, 0))).X for system in (dynamics, plain))
    apart = np.abs(ours - theirs).max()
    assert apart < 1e-13 if served == "inverse" else apart > 1e-3


def test_ipc_contacts_are_refused():
    model = mujoco.MjModel.from_xml_string(xml())
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_IPC
    with pytest.raises(ValueError, match="IPC contacts"):
        MujocoDynamics.from_model(model)


def test_callbacks_are_refused_when_made_and_when_used():
    dynamics = MujocoDynamics.from_xml(xml())
    mujoco.set_mjcb_control(lambda model, data: None)
    try:
        with pytest.raises(ValueError, match=r"mjcb_control is installed.*set_mjcb_control\(None\)"):
            MujocoDynamics.from_xml(xml())
        with pytest.raises(ValueError, match="mjcb_control"):
            dynamics.rollout(np.zeros(2), np.zeros((3, 1)))
    finally:
        mujoco.set_mjcb_control(None)
    dynamics.rollout(np.zeros(2), np.zeros((3, 1)))


def test_files_that_are_missing_or_broken(tmp_path):
    with pytest.raises(ValueError, match=r"model file '.*nothing.xml' does not exist"):
        MujocoDynamics.from_path(tmp_path / "nothing.xml")
    with pytest.raises(ValueError, match="is a folder"):
        MujocoDynamics.from_path(tmp_path)
    (tmp_path / "broken.xml").write_text("<mujoco><worldbody>")
    with pytest.raises(ValueError, match=r"cannot make a model of broken.xml: it is no valid XML"):
        MujocoDynamics.from_path(tmp_path / "broken.xml")
    (tmp_path / "wrong.xml").write_text("<mujoco><worldbody><gem/></worldbody></mujoco>")
    with pytest.raises(ValueError, match=r"cannot make a model of wrong.xml: .*gem") as caught:
        MujocoDynamics.from_path(tmp_path / "wrong.xml")
    assert "\n" not in str(caught.value)
    (tmp_path / "bad.mjb").write_bytes(b"no model")
    with pytest.raises(ValueError, match=r"cannot make a model of bad.mjb"):
        MujocoDynamics.from_path(tmp_path / "bad.mjb")
    with pytest.raises(ValueError, match="cannot make a model of the XML text"):
        MujocoDynamics.from_xml("<mujoco><worldbody><body><joint/></body></worldbody></mujoco>")


def test_options_are_checked():
    for options, reason in (
        ({"jacobian": "guess"}, "unknown jacobian 'guess'; there are: .*transition"),
        ({"timestep": 0.0}, "timestep must be positive"),
        ({"threads": 0}, "threads must be a whole number of at least 1"),
        ({"eps": -1.0}, "eps must be positive"),
    ):
        with pytest.raises(ValueError, match=reason):
            MujocoDynamics.from_xml(xml(), **options)


def test_divergence_is_found_at_once_and_silently(tmp_path, monkeypatch, capfd):
    monkeypatch.chdir(tmp_path)
    dynamics = MujocoDynamics.from_xml(xml(UNSTABLE, 'stiffness="-50000"'))
    trajectory = dynamics.rollout([0.1, 0.0], np.zeros((100, 1)))
    bad = trajectory.diverged_at
    assert bad is not None and 0 < bad < 20
    assert np.isfinite(trajectory.X[:bad]).all() and np.abs(trajectory.X[:bad]).max() < 1e10
    assert np.isnan(trajectory.X[bad:]).all() and np.isnan(trajectory.Y[bad:]).all()
    assert np.isfinite(trajectory.U).all()
    assert np.isnan(dynamics.step(np.array([1e11, 0.0]), np.zeros(1))[0]).all()
    with pytest.raises(ValueError, match=f"diverged at knot {bad}"):
        dynamics.linearize(trajectory)
    assert os.listdir(tmp_path) == []
    assert capfd.readouterr() == ("", "")
    good = dynamics.rollout([0.0, 0.0], np.zeros((2, 1)))
    assert not good.diverged


def test_feedback_that_blows_up_is_a_divergence():
    dynamics = MujocoDynamics.from_xml(xml())
    reference = dynamics.rollout([0.0, 0.0], np.zeros((20, 1)))
    trajectory = dynamics.rollout_feedback(reference, np.full((20, 1, 2), -1e12), np.ones((20, 1)))
    assert trajectory.diverged and np.isfinite(trajectory.U).all()
    assert dynamics.rollout([0.0, 0.0], np.full((4, 1), 1e11)).diverged_at == 0


def test_the_users_log_settings_come_back(tmp_path, monkeypatch):
    from mjslq.dynamics.mujoco.library import library, quiet

    before = library().mju_getLogConfig()
    with quiet(), quiet():
        assert not library().mju_getLogConfig().to_file
    after = library().mju_getLogConfig()
    assert (after.to_file, after.to_console, after.file) == (before.to_file, before.to_console, before.file)


def spheres(memory):
    bodies = "".join(
        f'<body name="b{i}" pos="{i % 8 * 0.15} {i // 8 * 0.15} {0.1 + 0.01 * i}"><freejoint/><geom size="0.1"/></body>'
        for i in range(64)
    )
    return (
        f'<mujoco><size memory="{memory}"/><worldbody><geom type="plane" size="5 5 1"/>{bodies}</worldbody>'
        '<actuator><adhesion body="b0" ctrlrange="0 1"/></actuator></mujoco>'
    )


def test_full_buffers_are_a_divergence_or_an_exception_and_not_the_end_of_the_process():
    ends = set()
    for kilobytes in (80, 120, 160, 200, 240, 400):
        dynamics = MujocoDynamics.from_xml(spheres(f"{kilobytes}K"))
        for _ in range(2):
            try:
                trajectory = dynamics.rollout(dynamics.initial_state, np.zeros((3, 1)))
                assert trajectory.diverged
                ends.add("diverged")
            except RuntimeError as error:
                assert "MuJoCo stopped with an error" in str(error) and "memory" in str(error)
                ends.add("raised")
    assert "raised" in ends
