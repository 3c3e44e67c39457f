"""Light and dark: the colours of ground, sky, lines and markers, and lights that go with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Color = tuple[int, int, int]


@dataclass(frozen=True)
class Theme:
    """Colours of a scene, as red, green and blue in 0 ... 255."""

    dark: bool
    sky: Color
    """Above."""
    horizon: Color
    """Below, where the ground fades away."""
    ground: Color
    cell: Color
    section: Color
    net: Color
    """Lines of the net that stands for a ground where a model has none."""
    shadow: float
    """Opacity of shadows on the ground."""
    dim: float
    """What the colours of a model's own ground are multiplied by."""
    key: float
    """Intensity of the light from the front."""
    rim: float
    """Intensity of the light from the other side."""
    ambient: float
    """Intensity of the light from everywhere, blue from above and grey from the ground."""
    paths: tuple[Color, ...]
    """Colours of traces, one after the other."""
    force: Color
    contact: Color
    target: Color
    mass: Color
    """Marks of centres of mass."""
    axis: Color
    """Arrows along the axes of joints."""

    def faded(self, color: Color, share: float) -> Color:
        """`color` mixed with a share of the ground's."""
        r, g, b = ((1.0 - share) * np.array(color) + share * np.array(self.ground)).round().astype(int).tolist()
        return r, g, b

    def backdrop(self) -> NDArray[np.uint8]:
        """The sky as an image: from `sky` at the top to `horizon` in the middle and below it. Shape (256, 4, 3)."""
        share = np.clip(np.linspace(0.0, 2.0, 256), 0.0, 1.0)[:, None]
        share = share * share * (3.0 - 2.0 * share)
        column = (1.0 - share) * np.array(self.sky) + share * np.array(self.horizon)
        return np.repeat(column.round().astype(np.uint8)[:, None], 4, axis=1)


LIGHT = Theme(
    dark=False,
    sky=(214, 225, 238),
    horizon=(247, 248, 250),
    ground=(221, 225, 231),
    cell=(206, 211, 219),
    section=(184, 191, 202),
    net=(206, 211, 219),
    shadow=0.42,
    dim=1.0,
    key=0.9,
    rim=0.35,
    ambient=0.85,
    paths=((208, 80, 38), (31, 110, 178), (36, 140, 92), (150, 72, 168), (190, 140, 20), (70, 80, 95)),
    force=(203, 44, 74),
    contact=(240, 150, 20),
    target=(30, 150, 105),
    mass=(240, 185, 20),
    axis=(60, 100, 200),
)
DARK = Theme(
    dark=True,
    sky=(23, 27, 34),
    horizon=(35, 40, 49),
    ground=(43, 48, 57),
    cell=(54, 60, 70),
    section=(72, 79, 91),
    net=(74, 82, 95),
    shadow=0.6,
    dim=0.25,
    key=1.0,
    rim=1.0,
    ambient=0.6,
    paths=((255, 138, 86), (96, 172, 240), (92, 208, 150), (214, 140, 232), (240, 200, 90), (190, 198, 210)),
    force=(255, 96, 120),
    contact=(255, 186, 70),
    target=(70, 220, 160),
    mass=(255, 214, 80),
    axis=(130, 165, 255),
)


def theme(dark: bool) -> Theme:
    """The theme, by whether it is dark."""
    return DARK if dark else LIGHT
