"""Pictures of a model in a pose, by MuJoCo's own renderer, without a window.

A model is drawn as MuJoCo draws it, with its materials, lights and skybox. What it lacks is added: a background, a lamp
that throws shadows, a faint net to stand on, colours of geoms that nobody gave one. The camera sees the whole motion,
as the viewer's does, unless one of the model's own is named.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from mjslq.exports.motion import Motion
from mjslq.exports.opengl import open_context
from mjslq.validation import Array, choose
from mjslq.viewer import camera
from mjslq.viewer.geometry import visible_geoms

_UNSET = (0.5, 0.5, 0.5, 1.0)  # MuJoCo's own colour: nobody chose one
_MOVING, _FIXED, _FLOOR = (0.36, 0.50, 0.68, 1.0), (0.62, 0.65, 0.69, 1.0), (0.80, 0.83, 0.87, 1.0)
_BACKGROUND, _NET = (0.955, 0.963, 0.975), (0.80, 0.83, 0.87)
_GHOST_OPACITY = (0.18, 0.5)
"""Of the earliest ghost and of the latest."""
_SAMPLES, _SHADOW_SIZE = 8, 4096
_ROOM = 4000  # for geoms of decoration in a scene, beyond those of the model
_FAR = 12.0  # the background, in sizes of the motion
_DIM = 0.02  # of the background's colour that takes light; the rest glows by itself, whatever the lamps are
_POSES = 60  # of a motion that are looked at for its extent


class Drawing:
    """Draws a model in given poses into pictures of one size; a context manager, for it holds an OpenGL context."""

    def __init__(
        self, model: Any, motion: Motion, size: tuple[int, int], camera_name: str | None = None, ghosts: int = 0
    ) -> None:
        """Prepare pictures of `size` (width, height) [px], each with up to `ghosts` pale poses beside the one shown.

        Raises ValueError when the model has no camera `camera_name`, or no OpenGL can be opened.
        """
        self._size = width, height = size
        self._model, self._data = model, mujoco.MjData(model)
        low, high = self._extent(motion)
        self._extent_of_motion = float(np.linalg.norm(high - low)) or 1.0
        self._camera = self._look(low, high, camera_name)
        self._low, self._centre = low, 0.5 * (low + high)
        _prepare(model, width, height, self._extent_of_motion)
        self._option = mujoco.MjvOption()
        self._option.geomgroup[model.geom_group[visible_geoms(model)]] = 1  # all where none is in the usual ones
        self._scene = mujoco.MjvScene(model, (ghosts + 1) * (model.ngeom + model.nsite + model.ntendon) + _ROOM)
        self._context, self._rendering = open_context(model, width, height)

    def __enter__(self) -> Drawing:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def close(self) -> None:
        """Free the OpenGL context."""
        if self._context is not None:
            self._rendering.free()
            self._context.free()
            self._context = None

    def picture(self, q: Array, ghosts: Sequence[Array] = ()) -> NDArray[np.uint8]:
        """The model at joint positions `q` (nq,), and pale ones at each of `ghosts`, the earliest first.

        Returns
        -------
        NDArray[np.uint8]
            Colours. Shape (height, width, 3).
        """
        scene = self._scene
        self._place(q)
        every = mujoco.mjtCatBit.mjCAT_ALL.value
        mujoco.mjv_updateScene(self._model, self._data, self._option, None, self._camera, every, scene)
        self._decorate()
        moving = mujoco.mjtCatBit.mjCAT_DYNAMIC.value
        for place, ghost in enumerate(ghosts):
            first = scene.ngeom
            self._place(ghost)
            mujoco.mjv_addGeoms(self._model, self._data, self._option, mujoco.MjvPerturb(), moving, scene)
            share = place / max(len(ghosts) - 1, 1)
            for geom in scene.geoms[first : scene.ngeom]:
                geom.rgba[3] *= _GHOST_OPACITY[0] + share * (_GHOST_OPACITY[1] - _GHOST_OPACITY[0])
        width, height = self._size
        self._context.make_current()
        whole = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_render(whole, scene, self._rendering)
        upside_down = np.empty((height, width, 3), np.uint8)
        mujoco.mjr_readPixels(upside_down, None, whole, self._rendering)
        return upside_down[::-1].copy()

    def _place(self, q: Array) -> None:
        """Move the model; only what drawing needs, for collisions may not work in a scene's model."""
        model, data = self._model, self._data
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        mujoco.mj_flex(model, data)
        mujoco.mj_tendon(model, data)

    def _extent(self, motion: Motion) -> tuple[Array, Array]:
        """Corners (3,) and (3,) [m] of the box that holds all that moves, over the whole motion."""
        model, data = self._model, self._data
        drawn = [i for i in visible_geoms(model) if model.geom_type[i] != mujoco.mjtGeom.mjGEOM_PLANE]
        moving = [i for i in drawn if model.body_weldid[model.geom_bodyid[i]] != 0]
        geoms = moving or drawn
        if not geoms:
            return -np.ones(3), np.ones(3)
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        boxes = model.geom_aabb[geoms, None, :3] + corners * model.geom_aabb[geoms, None, 3:]  # (geoms, 8, 3)
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for q in motion.qpos[:: max(len(motion.qpos) // _POSES, 1)]:
            data.qpos[:] = q
            mujoco.mj_kinematics(model, data)
            turned = np.einsum("gij,gkj->gki", data.geom_xmat[geoms].reshape(-1, 3, 3), boxes)
            points = turned + data.geom_xpos[geoms, None]
            low, high = np.minimum(low, points.min(axis=(0, 1))), np.maximum(high, points.max(axis=(0, 1)))
        return low, high

    def _look(self, low: Array, high: Array, name: str | None) -> Any:
        made = mujoco.MjvCamera()
        if name is not None:
            names = [self._model.camera(i).name for i in range(self._model.ncam)]
            if not names:
                raise ValueError(f"the model has no cameras, so none is named {name!r}")
            choose("camera", name, names)
            made.type = mujoco.mjtCamera.mjCAMERA_FIXED
            made.fixedcamid = names.index(name)
            return made
        view = camera.fit(low, high, self._size[0] / self._size[1])
        away = view.position - view.look_at
        made.lookat[:] = view.look_at
        made.distance = float(np.linalg.norm(away))
        made.azimuth = float(np.degrees(np.arctan2(-away[1], -away[0])))
        made.elevation = -float(np.degrees(np.arcsin(away[2] / made.distance)))
        return made

    def _decorate(self) -> None:
        """Add what the model has none of: a background, a lamp, a net to stand on."""
        model, scene, size = self._model, self._scene, self._extent_of_motion
        if not (model.tex_type == mujoco.mjtTexture.mjTEXTURE_SKYBOX).any():
            dim = tuple(_DIM * c for c in _BACKGROUND)
            sphere = _add(scene, mujoco.mjtGeom.mjGEOM_SPHERE, np.full(3, _FAR * size), self._centre, dim, 1.0 / _DIM)
            sphere.mat[:] = -np.eye(3)  # inside out
        for lamp in scene.lights[: scene.nlight]:  # where a directional one stands only tells where it throws shadows
            if lamp.type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL and lamp.castshadow:
                lamp.pos[:] = self._centre - 2.0 * size * np.array(lamp.dir)
        if model.nlight == 0:
            lamp = scene.lights[scene.nlight]
            scene.nlight += 1
            from_above = np.array([0.4, -0.5, 1.4])
            lamp.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
            lamp.headlight, lamp.castshadow = 0, 1
            lamp.pos[:], lamp.dir[:] = self._centre + 2.0 * size * from_above, -from_above / np.linalg.norm(from_above)
            lamp.ambient[:], lamp.diffuse[:], lamp.specular[:] = 0.0, 0.45, 0.15
        if not (model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE).any():
            self._draw_net()

    def _draw_net(self) -> None:
        """Draw lines below the motion, for orientation; they grow faint with the distance from its middle."""
        size, cells = self._extent_of_motion, 24
        cell = _round_length(size / 6.0)
        middle = np.round(self._centre / cell) * cell
        height = self._low[2] - 0.01 * size
        reach = np.arange(-cells, cells + 1) * cell
        for along in (0, 1):
            for offset in reach:
                for start, end in zip(reach[:-1:4], reach[4::4], strict=True):
                    ends = np.full((2, 3), height)
                    ends[:, along] = middle[along] + np.array([start, end])
                    ends[:, 1 - along] = middle[1 - along] + offset
                    away = float(np.hypot(0.5 * (start + end), offset)) / (cells * cell)
                    if away < 1.0:
                        _add_line(self._scene, ends, (*_NET, 1.0 - away))


def _prepare(model: Any, width: int, height: int, size: float) -> None:
    """Set how `model` is drawn: the buffer, the field of view, clipping by the size of the motion, missing colours."""
    visual = model.vis
    visual.global_.offwidth, visual.global_.offheight = width, height
    visual.global_.fovy = float(np.degrees(camera.FIELD_OF_VIEW))
    visual.quality.offsamples, visual.quality.shadowsize = _SAMPLES, _SHADOW_SIZE
    model.stat.extent = size
    visual.map.znear, visual.map.zfar = 0.02, 2.5 * _FAR
    visual.map.shadowclip = max(visual.map.shadowclip, 4.0)
    if model.nlight == 0:
        visual.headlight.ambient[:], visual.headlight.diffuse[:] = 0.35, 0.35
    unset = np.isclose(model.geom_rgba, _UNSET).all(axis=1) & (model.geom_matid < 0)
    moves = model.body_weldid[model.geom_bodyid] != 0
    flat = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    model.geom_rgba[unset & moves], model.geom_rgba[unset & ~moves] = _MOVING, _FIXED
    model.geom_rgba[unset & flat] = _FLOOR


def _add(scene: Any, kind: Any, size: Array, position: Array, rgb: tuple[float, ...], glow: float) -> Any:
    geom = scene.geoms[scene.ngeom]
    rgba = np.array([*rgb, 1.0][:4], np.float32)
    mujoco.mjv_initGeom(geom, kind, size, position, np.eye(3).ravel(), rgba)
    geom.category = mujoco.mjtCatBit.mjCAT_DECOR
    geom.emission, geom.specular, geom.shininess, geom.reflectance = glow, 0.0, 0.0, 0.0
    scene.ngeom += 1
    return geom


def _add_line(scene: Any, ends: Array, rgba: tuple[float, ...]) -> None:
    geom = _add(scene, mujoco.mjtGeom.mjGEOM_LINE, np.ones(3), np.zeros(3), rgba, 1.0)
    geom.rgba[3] = rgba[3]
    mujoco.mjv_connector(geom, mujoco.mjtGeom.mjGEOM_LINE.value, 1.5, ends[0], ends[1])


def _round_length(length: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above `length`."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= length * (1.0 + 1e-9)))
