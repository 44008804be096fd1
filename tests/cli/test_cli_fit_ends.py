"""How the command line ends a fit that did not converge or was interrupted."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from sim_core.rigs import load_rig, with_parameters
from sim_core.rigs.motion import load_experiment
from sysid.cli.app import main
from sysid.progress import interrupts_reported
from sysid.simulate import simulate_to_bag

FIT = ("fit", "strip_coarse", "--params", "strip.E,strip.nu", "--nuisance", "none")


@dataclass
class Ended:
    """What the command line asks of a result."""

    converged: bool
    no_success: str = ""

    def table(self) -> str:
        return "the table"


@pytest.mark.parametrize(
    ("converged", "pressed", "missed", "code"),
    [
        (1, 0, "", 0),
        (0, 0, "", 3),
        (0, 0, "far", 3),
        (1, 0, "This is no success.", 4),
        (0, 1, "", 130),
        (1, 1, "", 130),
    ],
)
def test_the_exit_code_says_whether_the_fit_converged_and_ctrl_c_was_pressed(
    converged: bool,
    pressed: bool,
    missed: str,
    code: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fitted(*given: Any, **more: Any) -> Ended:
        if pressed:
            with suppress(KeyboardInterrupt):
                os.kill(os.getpid(), signal.SIGINT)
                time.sleep(1.0)
        return Ended(bool(converged), missed)

    monkeypatch.setattr("sysid.workflow.fit_bags", fitted)
    (tmp_path / "run.mcap").touch()
    out = tmp_path / "out"
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores it
    try:
        assert main([*FIT, str(tmp_path / "run.mcap"), "--out", str(out)]) == code
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().out == f"the table\n\nReport: {out / 'report.html'}\n"


def test_a_fit_that_is_interrupted_twice_keeps_what_it_found(tmp_path: Path) -> None:
    """Ctrl-C is answered; pressed again while the simulations that are on end, it takes nothing."""
    bag, out = tmp_path / "run", tmp_path / "out"
    truth = with_parameters(load_rig("strip_coarse"), {"strip.E_pa": 2e5})
    simulate_to_bag(truth, load_experiment("pull_taut"), bag, seed=0)
    child = subprocess.Popen(
        [sys.executable, "-m", "sysid", *FIT, str(bag), "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),  # a background shell ignores it
    )
    assert child.stdout is not None and child.stderr is not None
    said = ""
    while "evaluation" not in said:
        said = child.stderr.readline()
        assert said, child.stdout.read()
    child.send_signal(signal.SIGINT)
    while "Interrupted: what was found so far" not in said:
        said = child.stderr.readline()
        assert said, child.stdout.read()
    time.sleep(0.3)
    child.send_signal(signal.SIGINT)
    table, errors = child.communicate(timeout=300)
    assert child.returncode == 130 and errors.endswith("thinshell: interrupted.\n")
    assert "The fit did not converge: interrupted" in table and "strip.E_pa" in table
    result = json.loads((out / "fit.json").read_text())
    assert not result["converged"] and (out / "report.html").is_file()


def test_ctrl_c_is_not_lost_where_it_cannot_be_answered(monkeypatch: pytest.MonkeyPatch) -> None:
    """The reader of stderr has gone with it."""

    class Gone:
        def write(self, text: str) -> int:
            raise BrokenPipeError

        def flush(self) -> None:
            raise BrokenPipeError

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores it
    try:
        with pytest.raises(KeyboardInterrupt), interrupts_reported("Interrupted.") as pressed:
            monkeypatch.setattr(sys, "stderr", Gone())
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1.0)
    finally:
        signal.signal(signal.SIGINT, before)
    assert pressed.is_set()


def test_ctrl_c_pressed_again_while_results_are_written_does_nothing(capfd: pytest.CaptureFixture[str]) -> None:
    """The third time it ends the command."""

    def press() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1.0)

    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores it
    try:
        with interrupts_reported("Interrupted."):
            with pytest.raises(KeyboardInterrupt):
                press()
            try:
                press()
            except KeyboardInterrupt:
                pytest.fail("the second one does what the first one did")
            with pytest.raises(KeyboardInterrupt):
                press()
    finally:
        signal.signal(signal.SIGINT, before)
    assert capfd.readouterr().err.count("Interrupted.") == 3
