"""Poses of batched meshes, in one message each.

Viser sends a message for each property that is set, and what a message costs hardly depends on its size: 50 bodies that
move and turn take a server 2.7 ms a frame with two messages a body, and 1.3 ms with one. Both properties in one message
need parts of Viser that it does not call public; where a version of it has them no more, two messages are sent.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from mjslq.validation import Array


def place(handle: Any, positions: Array, wxyzs: Array) -> None:
    """Set the positions (k, 3) [m] and orientations (k, 4) of a batch; nothing is sent where they are the same."""
    positions, wxyzs = positions.astype(np.float32), wxyzs.astype(np.float32)
    still = np.array_equal(handle.batched_positions, positions)
    turned = not np.array_equal(handle.batched_wxyzs, wxyzs)
    if still or not turned or positions.shape != handle.batched_positions.shape:
        handle.batched_positions, handle.batched_wxyzs = positions, wxyzs  # Viser leaves out what is the same
        return
    try:
        from viser import _messages as messages

        state = handle._impl
        both = messages.SceneNodeUpdateMessage(state.name, {"batched_positions": positions, "batched_wxyzs": wxyzs})
        queue, props = state.api._queue_scene_message, state.props
    except (ImportError, AttributeError):
        handle.batched_positions, handle.batched_wxyzs = positions, wxyzs
        return
    props.batched_positions[:], props.batched_wxyzs[:] = positions, wxyzs
    queue(both)
