"""Simple scenes for problems whose equations are functions: shapes on slides and hinges that the states move."""

from __future__ import annotations

from mjslq.scene import Scene

_FRAME = """<mujoco model="{name}">
  <compiler autolimits="true"/>
  <option gravity="0 0 0"/>
  <statistic center="{center}" extent="{extent}"/>
  <visual>
    <headlight ambient="0.4 0.4 0.42" diffuse="0.45 0.45 0.45" specular="0.2 0.2 0.2"/>
    <rgba haze="0.86 0.90 0.95 1"/>
    <global azimuth="90" elevation="{elevation}"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.93 0.96 0.99" rgb2="0.66 0.76 0.87"
             width="256" height="256"/>
    <material name="body" rgba="0.93 0.42 0.16 1" specular="0.6" shininess="0.6"/>
    <material name="link" rgba="0.20 0.45 0.72 1" specular="0.5" shininess="0.5"/>
    <material name="rail" rgba="0.55 0.60 0.67 1" specular="0.5" shininess="0.5"/>
    <material name="wall" rgba="0.80 0.25 0.25 0.55"/>
    <material name="goal" rgba="0.16 0.62 0.40 0.6"/>
  </asset>
  <default>
    <geom contype="0" conaffinity="0" mass="0.001"/>
  </default>
  <worldbody>
    <light pos="0 -3 5" dir="0 0.5 -1"/>
    {bodies}
  </worldbody>
</mujoco>"""


def scene(
    name: str,
    bodies: str,
    columns: tuple[int, ...],
    center: str = "0 0 0",
    extent: float = 2.0,
    elevation: float = -12.0,
) -> Scene | None:
    """Make a scene of the MJCF `bodies`; their joints, in order, are the entries `columns` of the state."""
    from mjslq.dynamics.mujoco import MujocoDynamics

    text = _FRAME.format(name=name, bodies=bodies, center=center, extent=extent, elevation=elevation)
    made = MujocoDynamics.from_xml(text).scene()
    return None if made is None else Scene(made.model, columns, name)


def discs(parameters: tuple[float, ...], upright: bool) -> str:
    """Obstacles x, y, r in a row as cylinders: in the vertical plane x, z if `upright`, else on the ground."""
    found = []
    for i in range(0, len(parameters), 3):
        x, y, r = parameters[i : i + 3]
        place = f'pos="{x} 0 {y}" euler="90 0 0"' if upright else f'pos="{x} {y} 0.1"'
        found.append(f'<geom type="cylinder" size="{r} 0.1" {place} material="wall"/>')
    return "\n    ".join(found)
