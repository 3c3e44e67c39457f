"""What the README and the demos show runs as it stands there."""

import re
import runpy
import sys
from pathlib import Path

import pytest

import mjslq

ROOT = Path(__file__).parent.parent
LONG = ROOT / "demos" / "09_receding_horizon.py"
DEMOS = sorted(file for file in ROOT.glob("demos/[0-9]*.py") if file != LONG)


@pytest.fixture
def seen(monkeypatch, tmp_path):
    """Results that were to be looked at, without a browser, in a folder of their own."""
    shown = []
    monkeypatch.setattr(mjslq, "view", lambda result, beside=(): shown.extend([result, *beside]))
    monkeypatch.chdir(tmp_path)
    return shown


def test_readme_example_swings_the_pendulum_up(seen, tmp_path, capsys):
    examples = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    names: dict = {}
    for example in examples:  # one after the other, as a reader would
        exec(compile(example, "README.md", "exec"), names)
    assert names["result"].success and names["result"].constraint_violation <= 1e-6
    (result,) = seen
    assert result.success
    assert abs(result.trajectory.X[-1, 0] - names["upright"][0]) < 0.01
    assert mjslq.load(tmp_path / "swing-up.npz").cost == result.cost
    assert "converged" in capsys.readouterr().out
    assert {file.name for file in tmp_path.iterdir()} >= {"swing-up.html", "swing-up.csv", "policy.npz"}


def test_readme_shows_pictures_and_paths_that_are_there():
    text = (ROOT / "README.md").read_text()
    assert len(text.splitlines()) <= 250
    named = re.findall(r'(?:src|srcset)="([^"]+)"', text) + re.findall(r"`((?:demos|assets|tests)/[^` ]+)`", text)
    assert len(named) >= 6
    for name in named:
        assert (ROOT / name).exists(), name
    for picture in (ROOT / "demos" / "pictures").iterdir():
        assert picture.stat().st_size < 250_000, picture


def test_tasks_of_the_readme_are_tasks(tmp_path, seen):
    """The one that is shown, with an arm that has what it names."""
    (shown,) = re.findall(r"```toml\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    arm = (ROOT / "assets" / "double_pendulum.xml").read_text()
    site = '<site name="hand" pos="0 0 0.1"/>'
    body = re.search(r"<body[^>]*>", arm)[0]
    (tmp_path / "robot.xml").write_text(
        arm.replace(body, body + site)
        .replace('<key name="hanging"', '<key name="home"')
        .replace("<joint name", '<joint range="-4 4" limited="true" name')
    )
    (tmp_path / "robot.toml").write_text(shown)
    assert mjslq.load_task(tmp_path / "robot.toml").problem.horizon > 10


def test_readme_names_every_method_and_command():
    text = (ROOT / "README.md").read_text()
    for name in mjslq.methods():
        assert f"`{name}`" in text
    for command in (
        "list",
        "solve",
        "new",
        "explain",
        "compare",
        "reproduce",
        "view",
        "export",
        "check",
        "bench",
        "sweep",
    ):
        assert f"mjslq {command}" in text


@pytest.mark.parametrize("demo", DEMOS, ids=[demo.stem for demo in DEMOS])
def test_demo_runs(demo, seen, monkeypatch):
    monkeypatch.setattr(sys, "argv", [str(demo)])
    runpy.run_path(str(demo), run_name="__main__")
    assert seen and all(result.success for result in seen)


@pytest.mark.slow
def test_the_closed_loops_of_the_demo_end_where_they_should(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [str(LONG)])
    runpy.run_path(str(LONG), run_name="__main__")
    ends = [float(line.rsplit(" ", 1)[1]) for line in capsys.readouterr().out.splitlines()]
    assert len(ends) == 3 and max(ends) < 0.1


def test_the_policy_elsewhere_keeps_the_pole_up(seen, monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(sys, "argv", ["11", str(tmp_path / "poles.png")])
    runpy.run_path(str(ROOT / "demos" / "11_policy_elsewhere.py"), run_name="__main__")
    found = re.findall(r"ends (\S+) rad from upright with feedback, (\S+) without", capsys.readouterr().out)
    ends = [(abs(float(closed)), abs(float(opened))) for closed, opened in found]
    assert len(ends) == 3 and all(closed < 0.01 for closed, _ in ends)
    assert ends[0][1] < 0.01 and all(opened > 1.0 for _, opened in ends[1:])
    assert (tmp_path / "poles.png").stat().st_size > 10_000
