"""A model of your own in ten lines of MJCF, with limits, a soft path and feedback that runs without the solver.

Run with    python demos/04_own_model.py
"""

import mujoco
import numpy as np

import mjslq

CRANE = """
<mujoco model="crane"><option timestep="0.02" integrator="implicitfast"/><worldbody>
  <body name="trolley" pos="0 0 2"><joint name="track" type="slide" axis="1 0 0" damping="1"/>
    <geom type="box" size=".15 .1 .06" mass="5"/>
    <body name="rope"><joint name="swing" axis="0 1 0" damping=".01"/>
      <geom type="capsule" fromto="0 0 0 0 0 -1" size=".01" mass=".1"/>
      <geom type="sphere" pos="0 0 -1" size=".12" mass="2" rgba=".9 .4 .15 1"/><site name="load" pos="0 0 -1"/>
  </body></body></worldbody>
  <actuator><motor name="drive" joint="track" ctrlrange="-15 15"/></actuator>
  <sensor><framepos name="load" objtype="site" objname="load"/></sensor></mujoco>
"""


def main() -> None:
    crane = mjslq.MujocoDynamics.from_xml(CRANE)
    problem = mjslq.Problem(
        dynamics=crane,
        horizon=200,
        x0=crane.initial_state,
        costs=[
            mjslq.costs.Control(1e-3),
            mjslq.costs.Sensor("load", target=[3.0, 0.0, 1.0], weight=1.0, loss="smooth-abs", width=0.2),
            mjslq.costs.State(100.0, target=[3.0, 0.0, 0.0, 0.0], when="terminal"),
        ],
        constraints=[
            mjslq.constraints.State(upper=[np.inf, 0.3, np.inf, np.inf], lower=[-np.inf, -0.3, -np.inf, -np.inf])
        ],
    )  # the rope swings by less than 0.3 rad
    result = mjslq.solve(problem, verbose=1)

    # The policy in a plain MuJoCo loop, with a gust after one second.
    model = mujoco.MjModel.from_xml_string(CRANE)
    data = mujoco.MjData(model)
    for n in range(problem.horizon):
        data.ctrl = result.policy(np.concatenate([data.qpos, data.qvel]), t=0.02 * n)
        data.xfrc_applied[model.body("rope").id, 0] = 10.0 if 50 <= n < 55 else 0.0
        mujoco.mj_step(model, data)
    print(f"after a gust the trolley stands at {data.qpos[0]:.3f} of 3 m, the rope hangs at {data.qpos[1]:+.3f} rad")
    mjslq.view(result)


if __name__ == "__main__":
    main()
