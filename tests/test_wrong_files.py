"""Places that cannot be written to: full disks, what is read-only, names that are none; nothing half-written stays."""

import os
import resource
import shutil
import stat
import subprocess
from concurrent.futures import Executor, Future
from contextlib import contextmanager

import numpy as np
import pytest
from wrong_inputs import one_sentence, pose, refused

import mjslq
from mjslq import cli, numba_cache, solve
from mjslq.files import atomic_write
from mjslq.reports import figures

RESULT = solve(pose(x0=[0.1, 0.0]))
LIMIT = 4096
"""Bytes that a file may have, or that a small disk has left."""


def picture(path):
    figure, axes = figures.subplots(1, 1, (4.0, 3.0))
    axes[0, 0].plot(np.random.default_rng(0).standard_normal(300))
    figures.save(figure, path)


class Inline(Executor):
    """Solves in the caller's own thread."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_result(fn(*args, **kwargs))
        return future


WRITERS = {
    "result": ("one.npz", RESULT.save),
    "page": ("one.html", lambda path: mjslq.export_html(RESULT, path)),
    "picture": ("one.png", picture),
}


@contextmanager
def short_files():
    """No file may grow beyond `LIMIT` bytes in this process."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.fixture
def full_disk(tmp_path):
    """A disk with `LIMIT` bytes left, where disks can be mounted."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = shutil.which("mount")
    if mount is None or os.geteuid() != 0:
        pytest.skip("a small disk takes the right to mount one")
    if subprocess.run([mount, "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(place)], capture_output=True).returncode:
        pytest.skip("disks cannot be mounted here")
    try:
        (place / "ballast").write_bytes(b"x" * (64 * 1024 - LIMIT))
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)


@pytest.mark.parametrize("writer", WRITERS)
def test_a_file_that_grows_too_large_leaves_the_old_one(writer, tmp_path):
    name, write = WRITERS[writer]
    path = tmp_path / name
    path.write_text("old")
    with short_files(), pytest.raises(ValueError) as caught:
        write(path)
    one_sentence(str(caught.value), f"cannot write {path}: ", "File too large")
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]


def test_many_results_of_which_one_cannot_be_written_are_handed_on(tmp_path):
    problems = [pose(x0=[0.1, 0.0], name=name) for name in "ab"]
    with short_files():
        found = list(mjslq.solve_many([*problems, "none"], Inline(), out=tmp_path, ordered=True, keep_iterates=True))
    assert [solved.success for solved in found] == [True, True, False] and found[0].file is None
    one_sentence(found[0].error, f"cannot write {tmp_path / '0000_a.npz'}: File too large")
    assert os.listdir(tmp_path) == ["0002_problem.error.json"]
    again = list(mjslq.solve_many(problems, Inline(), out=tmp_path, ordered=True))
    assert all(solved.file.is_file() and not solved.resumed for solved in again)


@pytest.mark.parametrize("writer", WRITERS)
def test_a_full_disk_leaves_nothing_half_written(writer, full_disk):
    name, write = WRITERS[writer]
    with pytest.raises(ValueError) as caught:
        write(full_disk / name)
    one_sentence(str(caught.value), f"cannot write {full_disk / name}: No space left on device")
    assert os.listdir(full_disk) == ["ballast"]


def test_a_command_on_a_full_disk_keeps_its_result_elsewhere(full_disk, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr("sys.argv", ["mjslq", "solve", "drag_particle", "-q", "--save", str(full_disk / "one.npz")])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    out, err = capsys.readouterr()
    assert (ended.value.code, out) == (2, "")
    one_sentence(err.strip(), "No space left on device; the result is in ")
    assert mjslq.load(err.split("the result is in ")[1].strip()).success
    assert os.listdir(full_disk) == ["ballast"]


@pytest.mark.parametrize("writer", ["result", "page"])
@pytest.mark.parametrize("given", [None, 3, b"one.npz", "one\0.npz"])
def test_what_is_no_path(writer, given):
    refused(lambda: WRITERS[writer][1](given), "path must be the path of a file")


@pytest.mark.parametrize(
    "name, said",
    [("none/one.npz", "there is no folder"), ("folder", "it is a folder"), ("x" * 300, "File name too long"),
     ("file/one.npz", "there is no folder")],
)  # fmt: skip
def test_places_that_are_none(name, said, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file").write_text("")
    refused(lambda: RESULT.save(tmp_path / name), "cannot write ", said)
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


@pytest.mark.skipif(os.geteuid() == 0, reason="nothing is read-only to root")
def test_folders_and_files_that_are_read_only(tmp_path):
    (tmp_path / "one.npz").write_text("old")
    (tmp_path / "one.npz").chmod(stat.S_IRUSR)
    refused(lambda: RESULT.save(tmp_path / "one.npz"), "one.npz: the file is read-only")
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    refused(lambda: RESULT.save(tmp_path / "two.npz"), "cannot write ", "Permission denied")
    (tmp_path / "one.npz").chmod(0)
    refused(lambda: mjslq.load(tmp_path / "one.npz"), "cannot read ", "Permission denied")


def denied(*given, **options):
    raise PermissionError(13, "Permission denied", "hidden")


def test_what_the_system_denies_is_said(tmp_path, monkeypatch):
    """The same, where tests are run by root."""
    RESULT.save(tmp_path / "one.npz")
    with monkeypatch.context() as patch:
        patch.setattr("builtins.open", denied)
        refused(lambda: mjslq.load(tmp_path / "one.npz"), f"cannot read {tmp_path / 'one.npz'}: Permission denied")
    with monkeypatch.context() as patch:
        patch.setattr("tempfile.mkstemp", denied)
        refused(lambda: RESULT.save(tmp_path / "two.npz"), f"cannot write {tmp_path / 'two.npz'}: Permission denied")
    with monkeypatch.context() as patch:
        patch.setattr("os.access", lambda path, mode: False)
        refused(lambda: RESULT.save(tmp_path / "one.npz"), "one.npz: the file is read-only")
    assert os.listdir(tmp_path) == ["one.npz"]


def test_errors_of_the_writer_itself_come_through(tmp_path):
    with pytest.raises(ZeroDivisionError), atomic_write(tmp_path / "one"):
        1 / 0  # noqa: B018
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("write", [lambda path: path.write_text("x"), lambda path: path.mkdir()])
def test_folders_of_many_results_that_are_none(write, tmp_path):
    write(tmp_path / "file")
    place = tmp_path / "file" / "sub"
    if (tmp_path / "file").is_dir():
        place.write_text("")
    refused(lambda: mjslq.solve_many([pose()], out=place), f"cannot write to {place}: ")


# Where there is no place to keep compiled code


def test_numba_gets_a_folder_where_there_is_none(monkeypatch, tmp_path):
    monkeypatch.delenv(numba_cache.FOLDER, raising=False)
    monkeypatch.setattr("os.access", lambda path, mode: False)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    config = pytest.importorskip("numba").config
    monkeypatch.setattr(config, "CACHE_DIR", config.CACHE_DIR)
    ended = []
    monkeypatch.setattr("atexit.register", lambda *call, **options: ended.append((call, options)))
    numba_cache.provide()
    folder = os.environ[numba_cache.FOLDER]
    assert os.path.dirname(folder) == str(tmp_path) and folder == config.CACHE_DIR
    assert stat.S_IMODE(os.stat(folder).st_mode) == 0o700  # numba unpickles what is in it
    ((remove, *given), options) = ended[0]
    remove(*given, **options)
    assert not os.path.exists(folder)


@pytest.mark.parametrize("where", ["named", "installed", "home"])
def test_numba_keeps_the_folder_that_it_has(where, monkeypatch, tmp_path):
    monkeypatch.delenv(numba_cache.FOLDER, raising=False)
    if where == "named":
        monkeypatch.setenv(numba_cache.FOLDER, str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("os.access", lambda path, mode: where == "installed" or str(path).startswith(str(tmp_path)))
    monkeypatch.setattr("tempfile.mkdtemp", denied)
    numba_cache.provide()
    assert os.environ.get(numba_cache.FOLDER) == (str(tmp_path) if where == "named" else None)
