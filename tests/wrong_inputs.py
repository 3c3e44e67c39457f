"""What the tables of wrong inputs share: small systems, and the check that an error is one sentence."""

import numpy as np
import pytest

from mjslq import FunctionDynamics, MujocoDynamics, Problem, costs

ARM = """<mujoco><option timestep="0.02"/><worldbody>
<body name="arm"><joint name="j" axis="0 1 0" range="-1 1" limited="true"/>
<geom name="ball" size=".05" pos=".3 0 0" mass="1"/><site name="tip" pos=".3 0 0"/></body>
<body name="box" pos="1 0 0"><geom name="crate" size=".1"/></body></worldbody>
<actuator><motor name="m" joint="j" ctrlrange="-2 2"/></actuator>
<sensor><framepos name="hand" objtype="site" objname="tip"/>
<framequat name="turn" objtype="site" objname="tip"/></sensor>
<keyframe><key name="home" qpos="0.1"/></keyframe></mujoco>"""
LONGEST = 2000
"""Characters of a sentence that lists the names of the robots."""


def swing(x, u):
    """A pendulum."""
    return np.array([x[1], u[0] - np.sin(x[0])])


def one_sentence(text, *fragments):
    """Check that a message is one line, not empty, and says these things."""
    assert text == text.strip() and 0 < len(text) < LONGEST and "\n" not in text and "Traceback" not in text, text
    for fragment in fragments:
        assert fragment in text, f"{fragment!r} is not in {text!r}"


def refused(call, *fragments):
    """Check that a call raises ValueError with one sentence, which says these things."""
    with pytest.raises(ValueError) as caught:
        call()
    one_sentence(str(caught.value), *fragments)


def table(*rows):
    """Rows (id, call, fragment, ...) as parameters of a test."""
    return pytest.mark.parametrize("call, fragments", [pytest.param(row[1], row[2:], id=row[0]) for row in rows])


PENDULUM = FunctionDynamics(swing, 2, 1, 0.05)
MODEL = MujocoDynamics.from_xml(ARM)


def pose(*terms, dynamics=PENDULUM, horizon=10, x0=(0.0, 0.0), **options):
    """A problem with a cost of the controls and these terms."""
    return Problem(dynamics, horizon, x0, [costs.Control(0.1), *terms], **options)


def pose_arm(*terms, **options):
    """The same on a MuJoCo model."""
    return pose(*terms, dynamics=MODEL, **options)
