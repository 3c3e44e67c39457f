"""Kernels travel as bitcode: it fits the sources, gives what numba gives bit for bit, and needs no numba to run."""

import ctypes
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from mjslq import quadratic
from mjslq.compiling import CompileClock
from mjslq.lq import riccati
from mjslq.native import bitcode, build, emit, machine, sources
from mjslq.native.arrays import ArrayKernel
from mjslq.native.kernel import KERNELS, Kernel

HOME = "mjslq.quadratic"
"""A module whose checksum serves for kernels of these tests."""
shipped = pytest.mark.skipif(
    not (bitcode.FOLDER / bitcode.PLATFORM).is_dir(), reason=f"no bitcode was made for {bitcode.PLATFORM}"
)


@pytest.fixture
def own_folders(tmp_path, monkeypatch):
    """Folders for machine code and bitcode in which nothing is yet."""
    monkeypatch.setenv(machine.FOLDER, str(tmp_path / "machine"))
    monkeypatch.setattr(bitcode, "FOLDER", tmp_path / "bitcode")
    return tmp_path


def double(x):
    return 2.0 * x


def triple(x):
    return 3.0 * x


def called(kernel, x):
    return ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(kernel.address)(x)


def made(name, function):
    """A kernel that nobody else knows of."""
    kernel = Kernel(name, function, "float64(float64)", HOME)
    del KERNELS[name]
    return kernel


@shipped
def test_bitcode_fits_the_sources():
    for kernel in build.kernels():
        stored = bitcode.read(kernel.name)
        assert stored is not None and stored.checksum == sources.checksum(kernel.module), (
            f"{kernel.name} was made of other sources: run `python -m mjslq.native.build` to make them anew"
        )
    names = {bitcode.path(kernel.name).name for kernel in build.kernels()}
    assert {path.name for path in (bitcode.FOLDER / bitcode.PLATFORM).iterdir()} == names


def test_the_sources_are_those_that_count():
    found, waiting = set(), ["mjslq.dynamics.mujoco.inverse.kernel"]
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += sources._imported(sources._path(name).read_text())
    inverse = "mjslq.dynamics.mujoco.inverse"
    needed = {f"{inverse}.table.job", f"{inverse}.table.columns", f"{inverse}.spatial", f"{inverse}.forces.laws",
              f"{inverse}.rows.pairs", f"{inverse}.readings.motions", "mjslq.dynamics.mujoco.kernels"}  # fmt: skip
    assert needed <= found
    assert "mjslq.solvers.loop" not in found and "mjslq.cli" not in found
    assert sources.checksum("mjslq.lq.riccati") != sources.checksum("mjslq.lq.adjoint")


def lq_arguments(seed=0, N=20, nx=6, nu=2):
    rng = np.random.default_rng(seed)
    A, B = np.eye(nx) + 0.1 * rng.standard_normal((N, nx, nx)), rng.standard_normal((N, nx, nu))
    Q, R = np.tile(np.eye(nx), (N + 1, 1, 1)), np.tile(np.eye(nu), (N, 1, 1))
    M, shift, held = 0.1 * rng.standard_normal((N, nu, nx)), np.zeros((N, nu)), rng.random((N, nu)) < 0.2
    out = np.zeros((N, nu, nx)), np.zeros((N, nu, nu)), np.zeros((N, nx, nx)), np.zeros((N + 1, nx, nx))
    return A, B, Q, R, M, shift, 0.0, held, *out, np.zeros(3 * nx * nx + 2 * nx * nu + nu * nu + nx + nu)


@shipped
def test_bitcode_gives_what_numba_gives_bit_for_bit():
    kernel, stored = riccati._factorize.kernel, bitcode.read("lq-factorize")
    anew, results = emit.emit(kernel.function, kernel.signature, kernel.entry), []
    for number, text in enumerate((stored.bitcode(), anew.bitcode)):
        entry, code = f"test_factorize_{number}", machine.llvm.parse_bitcode(text)
        code.get_function(kernel.entry).name = entry
        twin = ArrayKernel(entry, riccati._factorize.function, FACTORIZE, {})
        del KERNELS[entry]
        twin.kernel._address = machine.link(machine.translate(code.as_bitcode()), stored.symbols, entry)
        arguments = lq_arguments()
        assert twin(*arguments) == -1
        results.append(b"".join(array.tobytes() for array in arguments[8:12]))
    arguments = lq_arguments()
    assert riccati._factorize(*arguments) == -1
    assert results[0] == results[1] == b"".join(array.tobytes() for array in arguments[8:12])
    assert np.abs(arguments[8]).max() > 0.1


FACTORIZE = "i8(f8[3], f8[3], f8[3], f8[3], f8[3], f8[2], f8, b1[2], f8[3], f8[3], f8[3], f8[3], f8[1])"

SOLVE = """
import json, sys
import mjslq
result = mjslq.solve(mjslq.problems.get("hopper"), max_iterations=3)
print(json.dumps([result.cost.hex(), result.compile_seconds, "numba" in sys.modules]))
"""


@shipped
def test_the_hopper_is_solved_without_numba(tmp_path):
    environment = os.environ | {machine.FOLDER: str(tmp_path)}
    command = [sys.executable, "-c", SOLVE]
    answers = [
        json.loads(subprocess.run(command, env=environment, check=True, capture_output=True).stdout) for _ in range(2)
    ]
    (first, seconds, numba), (second, later, numba_again) = answers
    assert first == second and not numba and not numba_again
    assert seconds > 0.0 == later


def test_importing_mjslq_imports_no_engine():
    code = "import sys, mjslq; print(sorted({'mujoco', 'numba', 'llvmlite', 'scipy'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "[]\n"


def test_what_is_stored_for_other_sources_is_not_run(own_folders):
    stale = emit.emit(triple, "float64(float64)", "mjslq_test_stale")
    bitcode.write("test-stale", "other sources", stale.bitcode, stale.symbols)
    assert called(made("test-stale", double), 1.5) == 3.0


def test_what_is_stored_for_these_sources_is_run(own_folders):
    code = emit.emit(triple, "float64(float64)", "mjslq_test_stored")
    bitcode.write("test-stored", sources.checksum(HOME), code.bitcode, code.symbols)
    with CompileClock() as clock:
        assert called(made("test-stored", double), 1.5) == 4.5  # which shows where it came from
    assert clock.seconds > 0.0


@pytest.mark.parametrize("damage", [b"", b"nonsense", b"{}\nnonsense"])
def test_damaged_files_are_made_anew(own_folders, damage):
    name = f"test-damaged-{len(damage)}"
    bitcode.path(name).parent.mkdir(parents=True)
    bitcode.path(name).write_bytes(damage)
    assert called(made(name, double), 1.5) == 3.0
    (kept,) = (own_folders / "machine").iterdir()
    whole = kept.read_bytes()
    assert machine.recall(kept.stem) is not None
    kept.write_bytes(whole[:-1])
    assert machine.recall(kept.stem) is None


def test_bitcode_that_llvm_cannot_read_gives_way_to_numba(own_folders):
    bitcode.write("test-unreadable", sources.checksum(HOME), b"no bitcode", ())
    assert called(made("test-unreadable", double), 1.5) == 3.0


def test_kernels_run_where_nothing_can_be_kept(own_folders, monkeypatch):
    (own_folders / "file").write_text("")
    monkeypatch.setenv(machine.FOLDER, str(own_folders / "file"))
    assert called(made("test-nowhere", double), 1.5) == 3.0


def allocates(x):
    return np.full(3, x).sum()


def raises(x):
    total = 0.0
    for i in range(0, 10, int(x)):
        total += i
    return total


@pytest.mark.parametrize(
    "function, reason", [(allocates, "NRT_MemInfo"), (raises, r"ValueError\('range\(\) arg 3 must not be zero'")]
)
def test_kernels_neither_allocate_nor_raise(function, reason):
    with pytest.raises(TypeError, match=rf"the kernel mjslq_test needs Python: .*{reason}"):
        emit.emit(function, "float64(float64)", "mjslq_test")


def test_a_kernel_that_calls_what_is_nowhere_is_refused():
    code = machine.translate(emit.emit(double, "float64(float64)", "mjslq_test_missing").bitcode)
    with pytest.raises(ImportError, match="the kernel mjslq_test_missing calls functions that no library has: mj_none"):
        machine.link(code, ("mj_none",), "mjslq_test_missing")


def test_arrays_of_any_layout_are_taken():
    rng = np.random.default_rng(0)
    s, g, h = rng.standard_normal(4), rng.standard_normal((4, 3)), rng.standard_normal((4, 2))
    knots = np.array([0, 2, 2, 1])
    expected = np.zeros((3, 3, 2))
    quadratic.add_products(s, g, h, knots, expected)
    np.testing.assert_allclose(expected[1], s[3] * np.outer(g[3], h[3]), rtol=1e-14)
    into = np.zeros((3, 2, 3)).swapaxes(1, 2)
    wide = np.repeat(g, 2, axis=1)[:, ::2]
    assert not into.flags.c_contiguous and not wide.flags.c_contiguous
    quadratic.add_products(s, wide, h, knots.astype(np.int32), into)
    np.testing.assert_array_equal(into, expected)
    with pytest.raises(ValueError, match="argument 1 of add_products must have 2 axes, got 1"):
        quadratic.add_products(s, s, h, knots, into)
