"""The command line as a whole: listings, exit codes, interruptions, and the doctor."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import warnings
import xml.etree.ElementTree as ET
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

from sim_core.errors import ConfigError
from sim_core.rigs import config_folder
from sim_core.rigs.load import names_in
from sysid.cli import app, prove
from sysid.cli.doctor import _IMPORTS, _child, _ros_traps
from sysid.progress import interrupts_remembered, progress

THINSHELL = [sys.executable, "-m", "sysid"]
PRESS_POST = config_folder().parent / "bags" / "press_post"


def run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*THINSHELL, *words], capture_output=True, text=True, timeout=300)


def test_without_arguments_it_shows_its_help() -> None:
    done = run()
    assert done.returncode == 0
    assert done.stdout == run("--help").stdout
    for command in ("simulate", "fit", "diagnose", "inspect", "doctor", "prove"):
        assert command in done.stdout


@pytest.mark.parametrize(
    "command",
    [
        "simulate",
        "fit",
        "diagnose",
        "prove make",
        "prove record",
        "prove keep",
        "prove run",
        "prove score",
        "inspect",
        "track",
        "presses",
        "rigs",
    ],
)
def test_every_command_has_help(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main([*command.split(), "--help"]) == 0
    assert f"Usage: thinshell {command}" in capsys.readouterr().out


def test_every_number_on_the_command_line_has_bounds() -> None:
    """Those of :mod:`sysid.cli.bounds`, which say the value, the bound and the remedy."""
    commands = [*app.app.registered_commands, *prove.app.registered_commands]
    numbers = {}
    for command in commands:
        assert command.callback is not None
        for name, hint in get_type_hints(command.callback, include_extras=True).items():
            kinds = {get_args(hint)[0], *get_args(get_args(hint)[0])} if get_args(hint) else {hint}
            if kinds & {int, float}:
                numbers[f"{command.name} {name}"] = hint.__metadata__[0]
    assert {"fit starts", "coverage spread", "soak steps", "make cases", "simulate seed"} <= set(numbers)
    for where, option in numbers.items():
        assert option.parser is not None, where
        with pytest.raises(ConfigError, match=rf"--{where.split()[1].replace('_', '-')} is 'nan', not a .*number"):
            option.parser("nan")


def test_rigs_lists_all_rigs_and_experiments(capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["rigs"]) == 0
    shown = capsys.readouterr().out
    for name in names_in("rigs") + names_in("experiments"):
        assert name in shown


def test_params_as_json_names_units_and_bounds(capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["params", "card_press", "--json"]) == 0
    rows = {row["name"]: row for row in json.loads(capsys.readouterr().out)}
    assert rows["card.E_pa"]["unit"] == "Pa"
    assert rows["card.nu"]["upper"] == 0.5
    assert rows["contacts.gel-card.stiffness_pa_per_m"]["value"] is None


def test_a_defect_is_one_sentence_and_a_traceback_only_on_demand(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(kind: str) -> list[str]:
        raise RuntimeError(f"no {kind}")

    monkeypatch.setattr("sim_core.rigs.load.names_in", broken)
    assert app.main(["rigs"]) == 1
    short = capsys.readouterr().err
    assert "defect of the program: RuntimeError: no rigs" in short
    assert "Traceback" not in short
    assert app.main(["rigs", "--debug"]) == 1
    assert "Traceback" in capsys.readouterr().err


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def broken(kind: str) -> list[str]:
        raise ModuleNotFoundError("No module named 'meshio'", name="meshio")

    monkeypatch.setattr("sim_core.rigs.load.names_in", broken)
    assert app.main(["rigs"]) == 2
    assert "'meshio' is not installed. Run 'thinshell doctor'" in capsys.readouterr().err


def test_a_reader_that_goes_away_is_no_error() -> None:
    child = subprocess.Popen([*THINSHELL, "rigs"], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert child.stdout is not None
    assert child.stderr is not None
    child.stdout.close()
    assert child.stderr.read() == b""
    assert child.wait(timeout=300) == 141


def test_an_interrupt_ends_it_with_130_and_leaves_nothing(tmp_path: Path) -> None:
    child = subprocess.Popen(
        [*THINSHELL, "simulate", "forming", "form", "--out", str(tmp_path / "bag")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # a background shell ignores it
    )
    assert child.stderr is not None
    assert re.search(r" \d %.*step 1 of", child.stderr.readline())
    child.send_signal(signal.SIGINT)
    _, errors = child.communicate(timeout=300)
    assert child.returncode == 130
    assert "Traceback" not in errors and errors.endswith("thinshell: interrupted.\n")
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def report() -> dict[str, Any]:
    """What the doctor says of this machine; and its exit code."""
    done = run("doctor", "--json")
    return {**json.loads(done.stdout), "code": done.returncode}


@pytest.mark.slow
def test_the_doctor_finds_a_working_core(report: dict[str, Any]) -> None:
    findings = {finding["name"]: finding for finding in report["findings"]}
    assert report["works"]
    assert report["code"] == 0
    assert findings["Compiled core"]["state"] == "ok"
    assert findings["Python"]["state"] == "ok"
    assert findings["Modules"]["state"] == "ok"
    assert findings["Fit"]["state"] == "ok"
    assert all(finding["remedy"] for finding in findings.values() if finding["state"] != "ok")


@pytest.mark.slow
def test_the_doctor_misses_what_a_dependency_needs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All that is in pyproject.toml is there, and yet no command works."""
    (tmp_path / "apsw.py").write_text("raise ModuleNotFoundError(\"No module named 'apsw'\")")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    found = _child("Modules", _IMPORTS, "imported", "install it", core=True)
    assert (found.state, found.core) == ("missing", True) and "No module named 'apsw'" in found.detail


@pytest.mark.slow
@pytest.mark.ros
def test_the_doctor_hears_itself_over_ros(report: dict[str, Any]) -> None:
    pytest.importorskip("rclpy")
    findings = {finding["name"]: finding for finding in report["findings"]}
    assert findings["ROS 2 loopback"]["state"] == "ok"


def test_the_doctor_knows_the_traps_of_the_ros_wheels() -> None:
    guarded = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1", "LD_LIBRARY_PATH": "/elsewhere"}
    assert "LD_LIBRARY_PATH lacks" in next(_ros_traps(guarded)).detail
    other = {"RMW_IMPLEMENTATION": "rmw_nothing_cpp"}
    assert "unset RMW_IMPLEMENTATION" in list(_ros_traps(other))[-1].remedy


def test_ctrl_c_that_something_swallows_ends_the_command_before_its_work() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores it
    try:
        with interrupts_remembered():
            with suppress(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(1.0)
            with pytest.raises(KeyboardInterrupt), progress("work"):
                pytest.fail("the work has begun")
        with interrupts_remembered(), progress("work"):
            pass
    finally:
        signal.signal(signal.SIGINT, before)


def test_package_xml_has_the_version_of_the_package() -> None:
    root = Path(__file__).resolve().parents[2]
    assert ET.parse(root / "package.xml").findtext("version") == version("thinshell_ros")


@pytest.mark.parametrize("command", [["fit", "--params", "strip.E"], ["diagnose"]])
def test_a_recording_of_another_rig_is_said_before_anything_is_simulated(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its topics serve the rig, and yet its frames and numbers of markers are others: what differs is named first, with
    the remedy, and it is refused."""
    first, *others = command
    words = [first, "strip_coarse", str(PRESS_POST), *others, "--out", str(tmp_path / "out")]

    def begun(*given: Any, **more: Any) -> None:
        raise AssertionError("a simulation has begun")

    monkeypatch.setattr("sim_core.simulate.Simulation.__init__", begun)
    monkeypatch.setattr("sysid.model.parallel_predictor.ParallelPredictor.__enter__", begun)
    assert app.main(words) == 2
    said = capsys.readouterr().err
    first = said.splitlines()[0]
    assert "is in the frame 'tactile_left_gel', in the rig" in first and "27 markers (0 to 26), the rig 33" in first
    assert "Give the rig that it was recorded with" in first
    assert "--despite" in said


@pytest.mark.parametrize(("absent", "works"), [(("gymnasium", "viser"), True), (("scipy",), False)])
def test_the_doctor_does_not_ask_for_what_extras_bring(absent: tuple[str, ...], works: bool) -> None:

    hidden = f"import sys; sys.modules.update(dict.fromkeys({absent}))"
    done = subprocess.run([sys.executable, "-c", f"{hidden}\n{_IMPORTS}"], capture_output=True, text=True, timeout=300)
    assert (done.returncode == 0) == works, done.stderr
    assert works or "scipy" in done.stderr


def test_settings_are_listed_with_unit_meaning_and_origin(capsys: pytest.CaptureFixture[str]) -> None:
    assert app.main(["settings", "uncertainty"]) == 0
    shown = capsys.readouterr().out
    assert "  conflict_sd = 3 sd  (statistics)\n      Standard deviations of the difference" in shown
    assert app.main(["settings", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["uncertainty"]["conflict_sd"] == 3.0
    assert app.main(["settings", "kitchen"]) == 2
    refused = capsys.readouterr().err
    assert "There are no settings of 'kitchen'. Choose one of " in refused and "uncertainty" in refused


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("fit r a --held-out b c d --out o", "fit r a --held-out b --held-out c --held-out d --out o"),
        ("fit r a --held-out b --held-out c --out o", "fit r a --held-out b --held-out c --out o"),
        ("fit r a --held-out=b --out o", "fit r a --held-out=b --out o"),
        ("fit r --out o --held-out b c -- a", "fit r --out o --held-out b --held-out c -- a"),
        ("fit r a b --out o", "fit r a b --out o"),
    ],
)
def test_an_option_takes_all_the_words_behind_it(words: str, expected: str) -> None:
    assert app.each_named(words.split()) == expected.split()


def test_warnings_are_sentences(capsys: pytest.CaptureFixture[str]) -> None:
    """Without the line of the program that gave them; those that are for developers go where they went."""
    with pytest.warns(RuntimeWarning, match="divide by zero"), app._warnings_in_words():
        warnings.warn("card.stl: Seams were welded.", UserWarning, stacklevel=1)
        warnings.warn("divide by zero", RuntimeWarning, stacklevel=1)
    assert capsys.readouterr().err == "warning: card.stl: Seams were welded.\n"
