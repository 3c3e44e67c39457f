"""A pole swings up in the least time: the final time is unknown, the force is limited, and so comes out bang-bang.

Run with    python demos/12_least_time.py [limit of the force in N]
"""

import sys

import mujoco
import numpy as np

import mjslq

CART_POLE = """
<mujoco model="cart and pole"><option timestep="0.04" integrator="implicitfast"/><worldbody>
  <geom type="capsule" fromto="-2 0 0 2 0 0" size=".015" mass="0" contype="0"/>
  <body name="cart"><joint name="slide" type="slide" axis="1 0 0"/>
    <geom type="box" size=".1 .06 .05" mass="1" rgba=".93 .42 .16 1" contype="0"/>
    <body name="pole"><joint name="hinge" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 .5" size=".02" mass=".1" rgba=".2 .45 .72 1" contype="0"/>
  </body></body></worldbody>
  <actuator><motor name="force" joint="slide" ctrlrange="-{limit} {limit}"/></actuator></mujoco>
"""


def main() -> None:
    limit = float(sys.argv[1]) if len(sys.argv) > 1 else 10.0
    cart = mjslq.MujocoDynamics.from_xml(CART_POLE.format(limit=limit))
    problem = mjslq.Problem(
        dynamics=cart,
        horizon=60,  # of 0.04 s each in the first try, 2.4 s in all
        x0=[0.0, np.pi, 0.0, 0.0],  # it hangs
        costs=[mjslq.costs.Time()],
        constraints=[mjslq.constraints.State(0.0, 0.0, "terminal", name="upright, at rest, in the middle")],
        free_time=(0.5, 5.0),
    )
    result = mjslq.solve(problem)
    share = np.mean(np.abs(result.trajectory.U) > 0.999 * limit)
    print(result.message)
    print(f"upright after {result.final_time:.4f} s, {share:.0%} of it at full force, +-{limit:g} N")

    # The policy in a plain MuJoCo loop, whose steps are as long as those that were found; the start is 0.02 rad off.
    # At full force feedback has one way to go, so that it mends a part.
    model = mujoco.MjModel.from_xml_string(CART_POLE.format(limit=limit))
    model.opt.timestep = result.final_time / problem.horizon
    for name in ("feedback", "the controls alone"):
        data = mujoco.MjData(model)
        data.qpos[:] = [0.0, np.pi + 0.02]
        for n in range(problem.horizon):
            x = np.concatenate([data.qpos, data.qvel]) if name == "feedback" else result.trajectory.X[n]
            data.ctrl = result.policy(x, t=data.time)
            mujoco.mj_step(model, data)
        print(f"from a start 0.02 rad off, by {name}: {data.qpos[1]:+.4f} rad from upright")
    mjslq.view(result)


if __name__ == "__main__":
    main()
