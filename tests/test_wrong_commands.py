"""Wrong commands, in this process: status 2, one sentence on standard error, nothing on standard output, no file."""

import os
import shlex
import zipfile

import numpy as np
import pytest
from wrong_inputs import ARM, one_sentence, pose

from mjslq import cli, solve

HOPPER_OPTIONS = "height, horizon, duration"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files that commands are given: a result, results that are none, tasks and models."""
    place = tmp_path_factory.mktemp("commands")
    solve(pose(x0=[0.1, 0.0])).save(place / "ok.npz")
    whole = (place / "ok.npz").read_bytes()
    (place / "cut.npz").write_bytes(whole[: len(whole) // 2])
    (place / "text.npz").write_text("Dear diary")
    (place / "empty.npz").write_bytes(b"")
    np.savez(place / "foreign.npz", a=np.zeros(3))
    np.savez(place / "pickled.npz", header=np.array({"a": 1}, dtype=object))
    with zipfile.ZipFile(place / "zip.npz", "w") as archive:
        archive.writestr("hello.txt", "hello")
    for name in ("folder.npz", "folder.toml"):
        (place / name).mkdir()
    (place / "bad.toml").write_text("model = [")
    (place / "empty.toml").write_text("")
    (place / "bytes.toml").write_bytes(bytes(range(128, 256)))
    (place / "arm.xml").write_text(ARM)
    (place / "still.xml").write_text(ARM.split("<actuator>")[0] + "</mujoco>")
    (place / "broken.xml").write_text("<mujoco><worldbody>")
    return place


def run(command, monkeypatch, capsys):
    """Status, standard output and standard error of a command; what is compiled meanwhile is not told."""
    monkeypatch.setattr("mjslq.compiling._say", None)
    monkeypatch.setattr("mjslq.compiling.announce_compilation", lambda say: None)
    monkeypatch.setattr("sys.argv", ["mjslq", *shlex.split(command)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    captured = capsys.readouterr()
    return ended.value.code, captured.out, captured.err


COMMANDS = [
    ("list extra", "unexpected extra argument"),
    ("list --json", "No such option: --json"),
    ("solve", "Missing argument 'problem'"),
    ("solve hoper", "unknown problem 'hoper'; there are: drag_particle", "did you mean 'hopper'?"),
    ("solve hopper --nonsense", "No such option: --nonsense"),
    ("solve hopper -m slk", "unknown method 'slk'; there are: auto, slq", "did you mean 'slq'?"),
    ("solve hopper --preset x", "method 'auto' has no presets; 'slq' has: sideris-bobrow"),
    ("solve hopper -s height", "--set takes NAME=VALUE, such as height=20.0, got 'height'"),
    ("solve hopper -s =3", "unknown setting of hopper or the method ''; there are: " + HOPPER_OPTIONS),
    ("solve hopper -s heigth=3", "unknown setting", "did you mean 'height'?"),
    ("solve hopper -s height=", "height must be a number such as 20.0, got ''"),
    ("solve hopper -s height=nan", "height must be a number such as 20.0, got 'nan'"),
    ("solve hopper -s height=[1,2]", "height must be a number, got shape (2,)"),
    ("solve hopper -s height=None", "height must be a number such as 20.0, got None"),
    ("""solve hopper -s 'height=__import__("os")'""", "height must be a number such as 20.0"),
    ("solve hopper -s horizon=0", "horizon must be a whole number of at least 1, got int 0"),
    ("solve hopper -s horizon=-3", "horizon must be a whole number of at least 1, got int -3"),
    ("solve hopper -s horizon=1e3", "horizon must be a whole number of at least 1, got float 1000.0"),
    ("solve hopper -s horizon=1000000000000", "horizon must be at most 10000000 steps"),
    ("solve hopper -s duration=0", "duration must be positive and finite, got 0"),
    ("solve hopper -s alpha=0", "alpha must be positive and finite, got 0"),
    ("solve hopper -s engine=muj", "unknown engine 'muj'; there are: mujoco, function"),
    ("solve hopper -s max_iterations=-1", "max_iterations must be a whole number of at least 0, got -1"),
    ("solve hopper -s tol=abc", "tol must be a number of at least 0, got 'abc'"),
    ("solve hopper -s deadline=0", "deadline must be positive and finite, got 0"),
    ("solve hopper -m newton -s modification=none", "there are: multiplier, blend, stage"),
    ("solve hopper -m trust-region -s eta=(1,0)", "0 < eta_1 < eta_2 < 1, got (1, 0)"),
    ("solve hopper -m slq -s damping=-1", "damping must be positive and finite, got -1"),
    ("solve hopper --view --port 0", "port must be a whole number of at least 1, got int 0"),
    ("solve hopper --view --port -1", "port must be a whole number of at least 1, got int -1"),
    ("solve hopper --view --port 99999", "port must be at most 65535, got 99999"),
    ("solve hopper --view --port high", "--port"),
    ("solve hopper --view --host 256.1.1.1", "the viewer cannot listen at '256.1.1.1'"),
    ("solve hopper --view --host ''", "the viewer cannot listen at"),
    ("solve hopper --save .", "cannot write .: it is a folder"),
    ("solve hopper --save ok.npz/x.npz", "cannot write ok.npz/x.npz: there is no folder ok.npz"),
    ("solve hopper --save no/x.npz", "cannot write no/x.npz: there is no folder no"),
    (f"solve hopper --save {'x' * 300}.npz", "File name too long"),
    ("solve bad.toml", "bad.toml is no valid TOML: "),
    ("solve empty.toml", "empty.toml, model: is missing; it must be a text (and 1 more)"),
    ("solve folder.toml", "task file 'folder.toml' is a folder"),
    ("solve bytes.toml", "bytes.toml is no text file"),
    ("solve none.toml", "task file 'none.toml' does not exist; `mjslq new MODEL` writes one"),
    ("solve arm.xml", "'arm.xml' is a model", "`mjslq new arm.xml` writes a task file"),
    ("solve ok.npz", "unknown problem 'ok.npz'; there are: "),
    ("view none.npz", "there is no file none.npz"),
    ("view cut.npz", "cut.npz is not a result saved by mjslq"),
    ("view text.npz", "text.npz is not a result saved by mjslq (it is no .npz file)"),
    ("view empty.npz", "empty.npz is not a result saved by mjslq"),
    ("view foreign.npz", "foreign.npz is not a result saved by mjslq"),
    ("view pickled.npz", "pickled.npz is not a result saved by mjslq", "allow_pickle=False"),
    ("view zip.npz", "zip.npz is not a result saved by mjslq"),
    ("view folder.npz", "folder.npz is a folder, not a result saved by mjslq"),
    ("view bad.toml", "bad.toml is not a result saved by mjslq"),
    ("view broken.xml", "MuJoCo cannot make a model of broken.xml: it is no valid XML"),
    ("view go22", "unknown file or robot 'go22'; there are: ", "did you mean 'go2'?"),
    ("view go2 ok.npz", "a model is viewed alone, and go2 is one"),
    ("view hopper", "'hopper' is a problem; solve it and look at it with `mjslq solve hopper --view`"),
    ("view none.xml", "model file 'none.xml' does not exist"),
    ("view ok.npz --port 0", "port must be a whole number of at least 1"),
    ("view ok.npz --port 123456", "port must be at most 65535, got 123456"),
    ("view ok.npz --host nowhere.invalid", "the viewer cannot listen at 'nowhere.invalid'"),
    ("export ok.npz", "Missing argument 'output'"),
    ("export none.npz page.html", "there is no file none.npz"),
    ("export cut.npz page.html", "cut.npz is not a result saved by mjslq"),
    ("export ok.npz no/page.html", "cannot write no/page.html: there is no folder no"),
    ("export ok.npz folder.npz", "cannot write folder.npz: it is a folder"),
    ("explain none.npz", "there is no file none.npz"),
    ("explain foreign.npz", "foreign.npz is not a result saved by mjslq"),
    ("explain ok.npz --problem nothing", "unknown problem 'nothing'; there are: "),
    ("explain ok.npz --problem bad.toml", "bad.toml is no valid TOML"),
    ("explain ok.npz --problem van_der_pol", "the problem has", "but the result 10, 2 and 1"),
    ("compare hoper", "unknown problem 'hoper'", "did you mean 'hopper'?"),
    ("compare arm.xml", "'arm.xml' is a model"),
    ("compare hopper -m slk", "unknown method 'slk'; there are: "),
    ("compare hopper --plot x.doc", "unknown ending of a picture '.doc'; there are: .png, .svg, .pdf"),
    ("compare hopper --plot no/x.png", "cannot write no/x.png: there is no folder no"),
    ("compare hopper --view --port 0", "port must be a whole number of at least 1"),
    ("check nothing", "'nothing' is neither a model file (.xml, .urdf, .mjb), a task file (.toml), a robot's name"),
    ("check none.xml", "model file 'none.xml' does not exist"),
    ("check broken.xml", "broken.xml: it is no valid XML"),
    ("check arm.xml --steps 0", "steps must be a whole number of at least 1, got int 0"),
    ("check arm.xml --steps many", "--steps"),
    ("check arm.xml --seed -1", "seed must be a whole number of at least 0, got int -1"),
    ("check bad.toml", "bad.toml is no valid TOML"),
    ("reproduce nothing", "unknown paper 'nothing'; there are: slq, trust-region"),
    ("bench nothing", "unknown case 'nothing'; there are: hopper"),
    ("bench --starts 0", "starts must be a whole number of at least 1, got int 0"),
    ("bench --robots nothing", "unknown case 'nothing'; there are: "),
    ("sweep hoper", "unknown problem 'hoper'"),
    ("sweep arm.xml", "'arm.xml' is a model"),
    ("sweep hopper -s height=1:", "height takes a range of numbers, first:last:step, such as 1:50:5, got '1:'"),
    ("sweep hopper -s height=1:2:0", "height=1:2:0 has no values"),
    ("sweep hopper -s height=5:1:1", "height=5:1:1 has no values"),
    ("sweep hopper -s heigth=1", "unknown setting", "did you mean 'height'?"),
    ("sweep hopper -s height=", "height takes a value, values with commas or a range", "got nothing"),
    ("sweep hopper -s height", "--set takes NAME=VALUES, such as height=1:50:5, got 'height'"),
    ("sweep hopper --seeds -1", "seeds must be a whole number of at least 0, got int -1"),
    ("sweep hopper --executor cluster", "unknown executor 'cluster'; there are: processes, threads, dask, ray"),
    ("sweep hopper --workers 0", "workers must be a whole number of at least 1, got int 0"),
    ("sweep hopper --executor threads --workers 0", "workers must be a whole number of at least 1"),
    ("sweep hopper --address tcp://x", "an address belongs to the executors dask and ray"),
    ("sweep hopper --out ok.npz", "cannot write to ok.npz: File exists"),
    ("sweep hopper --out ok.npz/sub", "cannot write to ok.npz/sub: Not a directory"),
    ("sweep hopper -m slk", "unknown method 'slk'"),
    ("new none.xml", "model file", "none.xml' does not exist"),
    ("new broken.xml", "broken.xml: it is no valid XML"),
    ("new still.xml", "still.xml has no actuators, so there is nothing to optimize"),
    ("new pnda", "unknown robot 'pnda'; there are: ", "did you mean 'panda'?"),
    ("new arm.xml -o x.txt", "a task file ends in .toml, got 'x.txt'"),
    ("new arm.xml -o no/x.toml", "cannot write no/x.toml: there is no folder no"),
    ("new arm.xml -o empty.toml", "empty.toml exists already; name another file with --output"),
    ("schema extra", "unexpected extra argument"),
    ("slove hopper", "No such command 'slove'"),
]


@pytest.mark.parametrize("row", COMMANDS, ids=lambda row: row[0][:60])
def test_wrong_commands(row, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    command, *fragments = row
    before = sorted(os.listdir(folder))
    code, out, err = run(command, monkeypatch, capsys)
    assert (code, out) == (2, ""), err
    assert err.startswith("mjslq: ") and err.endswith("\n")
    one_sentence(err[:-1], *fragments)
    assert sorted(os.listdir(folder)) == before


def test_what_cannot_be_saved_is_saved_elsewhere(folder, monkeypatch, capsys, tmp_path):
    """The folder goes away, or the disk fills up, while the solve is under way."""
    from mjslq import Result, load

    monkeypatch.chdir(folder)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    save = Result.save

    def full(result, path):
        if str(path) == "hop.npz":
            raise ValueError("cannot write hop.npz: No space left on device")
        save(result, path)

    monkeypatch.setattr(Result, "save", full)
    code, out, err = run("solve drag_particle -q --save hop.npz", monkeypatch, capsys)
    assert (code, out) == (2, "") and "No space left on device; the result is in " in err
    assert load(err.split("the result is in ")[1].strip()).success
    assert not (folder / "hop.npz").exists()
