"""Ground, sky and light of a scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from mjslq.validation import Array
from mjslq.viewer import geometry, textures
from mjslq.viewer.layers.layer import Stage, color_bytes
from mjslq.viewer.theme import Color

_FAR = 9.0  # where the ground has faded away, in sizes of the motion
_KEY = (0.75, -0.8, 0.9)  # where the light comes from that models surfaces, and that from behind
_RIM = (-0.8, 0.6, 0.35)


class Surroundings:
    """The planes of a model, or a net below it, under a sky; the lights."""

    def __init__(self, stage: Stage, middle: Array, lowest: float) -> None:
        """Draw them about a motion with its middle at (3,) [m]; nothing is below the height `lowest` [m]."""
        self._stage, self._middle, self._lowest = stage, middle, lowest
        self._handles: list[Any] = []
        self._planes: list[tuple[geometry.Plane, Any]] = []
        self.groups = set(geometry.SHOWN_GROUPS)
        """Groups whose planes are shown."""
        self.restyle()

    def restyle(self) -> None:
        """Take the colours of the stage's theme."""
        scene, theme = self._stage.server.scene, self._stage.theme
        with self._stage.server.atomic():
            for handle in self._handles:
                handle.remove()
            scene.set_up_direction("+z")
            scene.configure_environment_map(None)
            scene.set_background_image(theme.backdrop(), format="png")
            self._handles = self._light() + self._draw_ground()
            self.show_groups(self.groups)

    def show_groups(self, groups: set[int]) -> None:
        """Show the planes of some groups."""
        self.groups = set(groups)
        for plane, handle in self._planes:
            handle.visible = plane.group in self.groups

    def _light(self) -> list[Any]:
        scene, theme = self._stage.server.scene, self._stage.theme
        white, cold = (255, 250, 242), (205, 222, 255)
        above, below = ((225, 234, 250), (120, 122, 130)) if not theme.dark else ((150, 165, 195), (60, 62, 70))
        scene.configure_default_lights(True, cast_shadow=True)  # from above, of intensity 3; ours cost twice as much
        return [
            scene.add_light_directional("/lights/key", color=white, intensity=theme.key, position=_KEY),
            scene.add_light_directional("/lights/rim", color=cold, intensity=theme.rim, position=_RIM),
            scene.add_light_hemisphere("/lights/sky", sky_color=above, ground_color=below, intensity=theme.ambient),
        ]

    def _draw_ground(self) -> list[Any]:
        found = geometry.planes(self._stage.model, tuple(range(6)))
        self._planes = [(plane, self._draw_plane(plane)) for plane in found]
        if any(plane.group in geometry.SHOWN_GROUPS for plane in found):
            return [handle for _, handle in self._planes]
        # nothing to stand on in the model: a faint net below the motion, for orientation only
        below = np.array([*self._middle[:2], self._lowest - 0.05 * self._stage.reach])
        net = self._grid("reference/net", (0.0, 0.0), None, below, np.array([1.0, 0.0, 0.0, 0.0]))
        return [*(handle for _, handle in self._planes), net]

    def _draw_plane(self, plane: geometry.Plane) -> Any:
        material = int(self._stage.model.geom_matid[plane.geom])
        texture = textures.texture_of(self._stage.model, material)
        if texture is not None and not texture.cube:
            return self._draw_covered(plane, texture)
        dim = self._stage.theme.dim
        ground = self._stage.theme.ground if plane.rgb is None else color_bytes(dim * np.array(plane.rgb))
        return self._grid(f"ground/{plane.geom}", plane.size, ground, plane.position, plane.wxyz, plane.rgb is None)

    def _grid(
        self, name: str, size: tuple[float, float], ground: Color | None, position: Array, wxyz: Array, own: bool = True
    ) -> Any:
        """Draw a plane with lines; a net of lines alone where it has no colour."""
        theme, reach = self._stage.theme, self._stage.reach
        cell = _round_length(reach / 8.0)
        far = _FAR * reach
        infinite = min(size) <= 0.0 or min(size) > 2.0 * far
        lines = theme.cell, theme.section
        if ground is None:
            lines = theme.net, theme.net
        elif not own:
            rgb = np.array(ground) / 255.0
            to = 1.0 if rgb.mean() < 0.6 else 0.0
            lines = color_bytes(rgb + 0.09 * (to - rgb)), color_bytes(rgb + 0.2 * (to - rgb))
        sides = (2.2, 2.2) if infinite else size  # an infinite one is as wide as it is far, times this
        return self._stage.server.scene.add_grid(
            f"/{name}",
            *sides,
            infinite_grid=infinite,
            plane_color=ground or theme.ground,
            plane_opacity=0.0 if ground is None else 1.0,
            shadow_opacity=theme.shadow * (0.6 if ground is None else 1.0),
            cell_size=cell,
            section_size=5.0 * cell,
            cell_thickness=0.6,
            section_thickness=0.9,
            fade_distance=far,
            fade_strength=1.7,
            position=position,
            wxyz=wxyz,
            cell_color=lines[0],
            section_color=lines[1],
        )

    def _draw_covered(self, plane: geometry.Plane, texture: textures.Texture) -> Any:
        """Draw a plane with an image, as far as it can be seen where it is infinite."""
        model, far = self._stage.model, 2.0 * _FAR * self._stage.reach
        sides = [0.5 * side if side > 0.0 else far for side in plane.size]
        corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]]) * [*sides, 1.0]
        coordinates = textures.flat_coordinates(texture, corners, model.geom_size[plane.geom])
        tint = geometry.tint_of(model, model.geom_rgba[plane.geom], int(model.geom_matid[plane.geom]))
        data = textures.glb(
            corners, np.array([[0, 1, 2], [0, 2, 3]]), np.tile([0.0, 0.0, 1.0], (4, 1)), coordinates,
            textures.image(model, texture.index), (*(self._stage.theme.dim * tint[:3]).tolist(), float(tint[3])), 0.0,
        )  # fmt: skip
        name = f"/ground/{plane.geom}"
        return self._stage.server.scene.add_glb(
            name, data, position=plane.position, wxyz=plane.wxyz, cast_shadow=False, receive_shadow=True
        )


def _round_length(length: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is not above `length`."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= length * (1.0 + 1e-9)))
