"""The command line as a user meets it: in a process of its own."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest

import mjslq

COMMAND = [sys.executable, "-m", "mjslq.cli"]


def hear_ctrl_c():
    """In a new process: undo that a shell's background jobs ignore interrupts, and their children with them."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def run(*arguments, cwd=None):
    return subprocess.run([*COMMAND, *arguments], capture_output=True, text=True, timeout=120, cwd=cwd)


def refused(*arguments):
    """Standard error of a command that has to end in one sentence and status 2."""
    outcome = run(*arguments)
    assert outcome.returncode == 2, outcome
    assert "Traceback" not in outcome.stderr
    assert outcome.stdout == ""
    return outcome.stderr


def test_help_is_quick_and_imports_nothing_heavy():
    code = "import sys, mjslq.cli; print(sorted({'mujoco', 'numba', 'viser', 'numpy', 'scipy'} & set(sys.modules)))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert loaded.stdout.strip() == "[]"
    shown = run("--help")
    assert shown.returncode == 0
    for command in ("list", "solve", "view", "export", "check"):
        assert command in shown.stdout


def test_list_names_every_problem_and_its_parameters():
    shown = run("list").stdout
    for name in mjslq.problems.names():
        assert name in shown
    assert "height=" in shown


def test_solve_saves_what_it_prints(tmp_path):
    file = tmp_path / "hop.npz"
    outcome = run("solve", "hopper", "--set", "height=5", "--save", str(file), "--json")
    assert outcome.returncode == 0, outcome.stderr
    printed = json.loads(outcome.stdout)
    saved = mjslq.load(file)
    assert printed["status"] == "converged"
    assert printed["cost"] == saved.cost
    assert printed["final_state"] == saved.trajectory.X[-1].tolist()
    assert printed["parameters"]["height"] == 5
    assert "|gradient|" in outcome.stderr  # progress goes elsewhere than the result


def test_summary_tells_height_and_phases():
    outcome = run("solve", "hopper", "-s", "height=20")
    assert outcome.returncode == 0
    assert "stance, flight, stance" in outcome.stdout
    assert "of 20 in" in outcome.stdout


def test_quiet_means_quiet():
    outcome = run("solve", "drag_particle", "--set", "beta=0.01", "--quiet")
    assert (outcome.returncode, outcome.stdout, outcome.stderr) == (0, "", "")


def test_status_1_when_iterations_run_out():
    outcome = run("solve", "hopper", "-s", "max_iterations=2")
    assert outcome.returncode == 1
    assert "max_iterations" in outcome.stdout


def test_without_arguments_there_is_help():
    shown = run()
    assert shown.returncode == 0 and "Usage" in shown.stdout


def test_preset_and_alias(tmp_path):
    common = ["solve", "drag_particle", "-s", "beta=0.05", "--quiet", "--json"]
    outcome = run(*common, "-m", "ilqr", "--preset", "sideris-bobrow", "-s", "line_search=armijo")
    assert outcome.returncode == 0, outcome
    printed = json.loads(outcome.stdout)
    assert (printed["method"], printed["iterations"]) == ("slq", 21)
    assert printed["options"]["acceleration"] is False and printed["options"]["rescue"] is False


def test_status_1_when_an_error_ends_the_solve():
    code = """
import mjslq.cli, mjslq.problems, mjslq.costs
def broken():
    problem = mjslq.problems.get("van_der_pol")
    def cost(trajectory):
        if abs(trajectory.U).max() > 0.0:
            raise RuntimeError("the cost broke")
        return 1.0
    problem._terms[0].cost = cost
    return problem
made = broken()
mjslq.problems.get = lambda name, **given: made
mjslq.cli.sys.argv[1:] = ["solve", "van_der_pol", "--quiet"]
mjslq.cli.main()
"""
    outcome = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert outcome.returncode == 1, outcome
    assert "Traceback" not in outcome.stderr and "RuntimeError: the cost broke." in outcome.stderr


def test_status_3_when_the_start_blows_up():
    outcome = run("solve", "hopper", "-s", "engine=function", "-s", "stiffness=1e9", "-s", "gravity=1e14")
    assert outcome.returncode == 3, outcome
    assert "blew up" in outcome.stdout


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["solve", "hoper"], "did you mean 'hopper'?"),
        (["solve", "hopper", "--method", "slk"], "unknown method 'slk'; there are: auto, slq"),
        (["solve", "hopper", "--preset", "sideris-bobrow"], "method 'auto' has no presets; 'slq' has: sideris-bobrow"),
        (["solve", "hopper", "-m", "slq", "--preset", "bobrow"], "there are: sideris-bobrow"),
        (["solve", "hopper", "-m", "newton", "--preset", "sideris-bobrow"], "method 'newton' has no presets"),
        (["solve", "hopper", "--nonsense"], "--nonsense"),
        (["solve", "hopper", "--port", "high"], "--port"),
        (["solve"], "Missing argument"),
        (["slove", "hopper"], "slove"),
        (["solve", "hopper", "-s", "heigth=3"], "did you mean 'height'?"),
        (["solve", "hopper", "-s", "height"], "NAME=VALUE"),
        (["solve", "hopper", "-s", "height=tall"], "height must be a number"),
        (["solve", "hopper", "-s", "alpha=-1"], "alpha must be positive"),
        (["solve", "hopper", "-s", "horizon=2.5"], "horizon must be a whole number"),
        (["solve", "hopper", "-m", "slq", "-s", "line_search=brent"], "quadratic-fit"),
        (["solve", "hopper", "-s", "curvature=perhaps"], "there are: auto, always, never"),
        (["solve", "hopper", "--save", "no/such/folder/hop.npz"], "no folder"),
        (["solve", "hopper", "--save", "."], "it is a folder"),
        (["compare", "hopper", "--plot", "no/such/costs.svg"], "no folder"),
        (["check", "hopper", "--seed", "-1"], "seed must be a whole number of at least 0"),
        (["check", "hopper", "--steps", "0"], "steps must be a whole number of at least 1"),
        (["view", "missing.npz"], "there is no file missing.npz"),
        (["export", "missing.npz", "page.html"], "there is no file missing.npz"),
        (["export", "missing.npz", "film.avi"], "unknown ending of an exported file '.avi'; there are: .html, .mp4"),
        (["export", "missing.npz", "hop.png", "--size", "3x"], "--size takes WIDTHxHEIGHT, such as 1280x720"),
        (["export", "missing.npz", "no/hop.csv"], "there is no folder no"),
        (["check", "missing.xml"], "does not exist"),
        (["check", "nothing"], "neither a model file"),
    ],
)
def test_wrong_input_is_answered_in_a_sentence(arguments, said):
    message = refused(*arguments)
    assert said in message
    assert len(message.strip().splitlines()) == 1


def test_a_file_that_is_no_result(tmp_path):
    file = tmp_path / "notes.npz"
    file.write_text("not a result")
    assert "not a result" in refused("view", str(file))


def test_a_broken_model_is_named(tmp_path):
    file = tmp_path / "broken.xml"
    file.write_text("<mujoco><worldbody><geom/></mujoco>")
    assert "broken.xml" in refused("check", str(file))


def test_check_reports_parts_and_errors(tmp_path):
    file = tmp_path / "arm.xml"
    file.write_text(
        '<mujoco><option timestep="0.01"/><worldbody><body><joint name="j" axis="0 1 0"/>'
        '<geom size=".05" pos=".3 0 0" mass="1"/></body></worldbody><actuator><motor joint="j"/></actuator></mujoco>'
    )
    outcome = run("check", str(file), cwd=tmp_path)
    assert outcome.returncode == 0, outcome
    assert "hinge joints" in outcome.stdout
    assert "Jacobian" in outcome.stdout
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_interrupt_keeps_the_best_iterate(tmp_path):
    """Ctrl-C in the middle: the result is saved all the same, and the status says what happened."""
    file = tmp_path / "hop.npz"
    # Steepest descent goes on for ever here, so that there is a middle to interrupt on any machine.
    arguments = ["solve", "hopper", "-m", "gradient", "-s", "tol=0", "-s", "max_iterations=1000000"]
    process = subprocess.Popen(
        [*COMMAND, *arguments, "--save", str(file)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=hear_ctrl_c,
    )  # fmt: skip
    for line in process.stderr:  # it is iterating once the third iterate is on the screen
        if line.split()[:1] == ["3"]:
            break
    process.send_signal(signal.SIGINT)
    rest = process.communicate(timeout=60)
    assert process.returncode == 130, rest
    assert "Traceback" not in rest[1]
    result = mjslq.load(file)
    assert result.status is mjslq.Status.INTERRUPTED
    assert result.cost <= result.log[0].cost
    assert result.cost == min(entry.cost for entry in result.log) or result.cost < result.log[-1].cost


def test_view_prints_its_address_and_ends_with_ctrl_c(tmp_path):
    mjslq.solve(mjslq.problems.get("hopper", height=1.0)).save(tmp_path / "hop.npz")
    process = subprocess.Popen(
        [*COMMAND, "view", str(tmp_path / "hop.npz"), "--port", "8123"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=os.environ | {"PYTHONUNBUFFERED": "1"},
        preexec_fn=hear_ctrl_c,
    )  # fmt: skip
    line = process.stdout.readline()
    assert "http://127.0.0.1:" in line or "http://localhost:" in line, (line, process.stderr.read())
    time.sleep(0.2)  # into the waiting itself
    process.send_signal(signal.SIGINT)
    rest = process.communicate(timeout=30)
    assert "Traceback" not in rest[1]
    assert process.returncode in (0, 130)


def test_export_writes_one_page(tmp_path):
    mjslq.solve(mjslq.problems.get("hopper", height=1.0)).save(tmp_path / "hop.npz")
    outcome = run("export", "hop.npz", "hop.html", cwd=tmp_path)
    assert outcome.returncode == 0, outcome
    assert (tmp_path / "hop.html").stat().st_size > 100_000
