"""Meshes with fewer triangles: how far they are from the model's, and what stays sharp and closed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from mjslq import Result
from mjslq.exports import export
from mjslq.robots import robot_spec
from mjslq.viewer import geometry, simplify


def edges_of_one_side(vertices: np.ndarray, faces: np.ndarray) -> int:
    """How many edges, told by their places, do not have as many triangles on one side as on the other."""
    _, place = np.unique(vertices, axis=0, return_inverse=True)
    a = place.reshape(-1)[faces]
    b, many = np.roll(a, -1, axis=1), place.max() + 1
    one, other = np.sort((a * many + b).ravel()), np.sort((b * many + a).ravel())
    return int((one != other).sum())


@settings(max_examples=10)
@given(st.floats(0.04, 0.15), st.integers(0, 2**32 - 1))
def test_a_ball_keeps_its_places_to_within_a_cell_and_stays_closed(cell: float, seed: int) -> None:
    ball = trimesh.creation.icosphere(subdivisions=5)
    centre = np.random.default_rng(seed).uniform(-1.0, 1.0, 3)
    vertices, faces = simplify.merged(ball.vertices + centre, ball.faces, cell)
    assert len(faces) < 0.8 * len(ball.faces)
    off = np.abs(np.linalg.norm(vertices - centre, axis=1) - 1.0).max()
    assert off < np.sqrt(3.0) * cell
    assert edges_of_one_side(vertices, faces) == 0
    normals = geometry.vertex_normals(vertices, faces)
    assert (np.sum(normals * (vertices - centre), axis=1) > 0.8).all()


def test_edges_of_a_box_stay_sharp_and_closed() -> None:
    vertices, faces = geometry.divided(*geometry.geom_mesh(*box()), 5)
    fewer, triangles = simplify.merged(vertices, faces, 0.05)
    assert len(triangles) == 2 * 6 * 20 * 20
    normals = geometry.vertex_normals(fewer, triangles)
    assert np.abs(normals).max(axis=1).min() > 0.9  # each belongs to one side alone: 0.7 for two
    assert edges_of_one_side(fewer, triangles) == 0


def box() -> tuple[mujoco.MjModel, int]:
    text = "<mujoco><worldbody><geom type='box' size='.5 .5 .5'/></worldbody></mujoco>"
    return mujoco.MjModel.from_xml_string(text), 0


def test_a_robot_takes_half_the_room() -> None:
    model = robot_spec("g1", floating=True).compile()
    cell = simplify.cell_of(model)
    assert 1e-3 < cell < 2e-3
    pieces = max(geometry.pieces(model), key=lambda piece: len(piece.faces)), geometry.pieces(model)[0]
    for piece in pieces:
        fewer = simplify.simplified(piece, cell)
        assert len(fewer.faces) < 0.9 * len(piece.faces)
        box, other = (np.array([one.vertices.min(axis=0), one.vertices.max(axis=0)]) for one in (piece, fewer))
        np.testing.assert_allclose(other, box, rtol=0, atol=np.sqrt(3.0) * cell)
        step = 2.0 ** np.floor(np.log2(cell / 8.0))
        np.testing.assert_array_equal(fewer.vertices, np.round(fewer.vertices / step) * step)
        assert simplify.simplified(piece, 0.0) is piece


def test_exported_pages_are_dark_or_light(arm: Result, function: Result, browser: Any, tmp_path: Path) -> None:
    for dark in (False, True):
        export(function, tmp_path / "function.html", dark=dark)
        page = browser.new_context(offline=True).new_page()
        page.goto((tmp_path / "function.html").as_uri())
        ground = page.evaluate("getComputedStyle(document.body).backgroundColor")
        shade = np.mean([int(part) for part in ground.removeprefix("rgb(").rstrip(")").split(",")])
        assert shade < 60 if dark else shade > 200
        page.context.close()
        export(arm, tmp_path / "arm.html", dark=dark)
        assert f"darkMode:{str(dark).lower()}" in (tmp_path / "arm.html").read_text()
    with pytest.raises(ValueError, match="dark must be True or False, got int 3"):
        export(function, tmp_path / "function.html", dark=3)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"dark is an option of \.html files, not of \.csv files"):
        export(function, tmp_path / "function.csv", dark=True)
