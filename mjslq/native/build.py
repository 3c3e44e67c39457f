"""Make the bitcode of kernels anew: of all whose sources have changed, or of those named.

Usage: python -m mjslq.native.build [--all] [name ...]
"""

from __future__ import annotations

import importlib
import sys
import time

from mjslq.native import bitcode, sources
from mjslq.native.kernel import KERNELS, Kernel

MODULES = (
    "mjslq.quadratic",
    "mjslq.lq.riccati",
    "mjslq.lq.box",
    "mjslq.lq.problem",
    "mjslq.lq.adjoint",
    "mjslq.dynamics.mujoco.kernels",
    "mjslq.dynamics.mujoco.inverse.levels",
)
"""Modules that declare kernels. One that makes them when asked has a function `kernels()`, which makes all."""


def kernels() -> list[Kernel]:
    """All kernels that travel as bitcode."""
    for name in MODULES:
        module = importlib.import_module(name)
        getattr(module, "kernels", list)()
    return list(KERNELS.values())


def main(arguments: list[str]) -> None:
    """Make the files that do not fit the sources, or all; delete those of kernels that are no more."""
    from mjslq.native.emit import emit

    known, start = kernels(), time.perf_counter()
    checksums = {kernel.name: sources.checksum(kernel.module) for kernel in known}
    wanted = [name for name in arguments if name != "--all"]
    unknown = set(wanted) - {kernel.name for kernel in known}
    if unknown:
        raise SystemExit(f"no kernel {', '.join(sorted(unknown))}; there are: {', '.join(k.name for k in known)}")
    total, refused = 0, []
    for kernel in known:
        checksum, stored, begun = checksums[kernel.name], bitcode.read(kernel.name), time.perf_counter()
        fits = stored is not None and stored.checksum == checksum
        if (wanted and kernel.name not in wanted) or (fits and "--all" not in arguments):
            total += bitcode.path(kernel.name).stat().st_size if stored else 0
            continue
        if checksum is None:
            raise SystemExit("a file was changed meanwhile: run this again")
        try:
            code = emit(kernel.function, kernel.signature, kernel.entry)
        except TypeError as error:
            print(error, file=sys.stderr, flush=True)
            refused.append(kernel.name)
            continue
        size = bitcode.write(kernel.name, checksum, code.bitcode, code.symbols).stat().st_size
        total += size
        print(f"{kernel.name:40} {size / 1000:7.1f} kB {time.perf_counter() - begun:7.1f} s", flush=True)
    for path in sorted(bitcode.path("any").parent.glob("*.bc.xz")):
        if path.name not in {bitcode.path(kernel.name).name for kernel in known}:
            path.unlink()
            print(f"{path.name:40} deleted")
    if refused:
        raise SystemExit(f"not made: {', '.join(refused)}")
    print(f"{len(known)} kernels, {total / 1000:.0f} kB, for {bitcode.PLATFORM}; {time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main(sys.argv[1:])
