"""Policies as files: plain arrays in NumPy's npz, so that a robot's computer needs NumPy and nothing else.

X, U, K, dt, lower, upper   the policy's arrays; K is zero where there is no feedback
space_size, space_x/...     where the state's rotations are, for `load_policy` alone
policy_format               version of this layout
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from mjslq.files import atomic_write, read_arrays
from mjslq.policy import Policy
from mjslq.storage import pack_space, unpack_space
from mjslq.validation import gist

FORMAT = 1
"""Version of the layout; files of another one are refused."""


def save_policy(policy: Policy, path: str | os.PathLike[str]) -> None:
    """Write `policy` to `path`; see `Policy.save`."""
    assert policy.space is not None  # filled in when made
    gains = np.zeros((*policy.U.shape, policy.space.ndx)) if policy.K is None else policy.K
    arrays: dict[str, Any] = {name: getattr(policy, name) for name in ("X", "U", "dt", "lower", "upper")}
    arrays |= {"K": gains, "policy_format": np.array(FORMAT)} | pack_space(policy.space)
    with atomic_write(path) as stream:
        np.savez_compressed(stream, **arrays)


def load_policy(path: str | os.PathLike[str]) -> Policy:
    """Read what `save_policy` wrote; see `Policy.load`."""
    what = "a policy saved by mjslq"
    name, arrays = os.fspath(path), read_arrays(path, what)
    if "policy_format" not in arrays:
        found = "a whole result, whose policy is mjslq.load(path).policy" if "header" in arrays else "of another kind"
        raise ValueError(f"{name} is not {what} (it is {found})")
    try:
        version = int(arrays["policy_format"])
        if version != FORMAT:
            raise ValueError(f"it has format {version}, this version of mjslq reads format {FORMAT}")
        given = {entry: arrays[entry] for entry in ("X", "U", "K", "dt", "lower", "upper")}
        return Policy(**given, space=unpack_space(arrays))
    except KeyError as error:
        raise ValueError(f"{name} is not {what} ({error} is missing)") from None
    except (ValueError, TypeError, IndexError) as error:
        raise ValueError(f"{name} is not {what} ({gist(error)})") from None
