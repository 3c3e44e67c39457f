"""Task files on the command line: written, solved, checked; mistakes end in one sentence."""

import json
import shutil
from pathlib import Path

from test_cli import refused, run

import mjslq

ASSETS = Path(__file__).parent.parent / "assets"


def test_new_solve_check_and_schema(tmp_path):
    shutil.copy(ASSETS / "double_pendulum.xml", tmp_path)
    written = run("new", "double_pendulum.xml", cwd=tmp_path)
    assert written.returncode == 0, written.stderr
    assert "mjslq solve double_pendulum.toml --save double_pendulum.npz --view" in written.stderr
    text = (tmp_path / "double_pendulum.toml").read_text()
    assert 'model = "double_pendulum.xml"' in text
    outcome = run("solve", "double_pendulum.toml", "--save", "r.npz", "--json", cwd=tmp_path)
    assert outcome.returncode == 0, outcome.stderr
    assert json.loads(outcome.stdout)["cost"] == mjslq.load(tmp_path / "r.npz").cost
    asked = run("solve", "double_pendulum.toml", "-q", "-m", "slq", "--set", "max_iterations=1", cwd=tmp_path)
    assert asked.returncode == 1 and not asked.stderr
    assert run("check", "double_pendulum.toml", cwd=tmp_path).returncode == 0
    assert json.loads(run("schema").stdout)["title"] == "TaskFile"


def test_wrong_uses_end_in_one_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert "'none.toml' does not exist" in refused("solve", "none.toml")
    assert "unknown robot 'pnda'" in refused("new", "pnda")
    assert "a task file ends in .toml" in refused("new", "ur5", "-o", "task.txt")
    assert "there is no folder" in refused("new", "ur5", "-o", "none/task.toml")
    (tmp_path / "ur5.toml").write_text("")
    assert "exists already" in refused("new", "ur5")
    assert "model: is missing" in refused("solve", "ur5.toml")
    task = str(ASSETS / "tasks" / "cart_pole.toml")
    assert "unknown option 'heigth'" in refused("solve", task, "--set", "heigth=3")
    assert "unknown method 'sql'" in refused("solve", task, "-m", "sql")
    assert "`mjslq new" in refused("solve", str(ASSETS / "acrobot.xml"))
    assert "'go2' is a robot" in refused("solve", "go2")
