"""Whatever is wrong with the input: one paragraph with the remedy, exit code 2, nothing written."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from sim_core.rigs import config_folder
from sysid.cli.app import main

GOOD_RIG = (config_folder() / "rigs" / "card_press.yaml").read_text()
PRESS_POST = str(config_folder().parent / "bags" / "press_post")
GOOD_MOTION = "name: test\nmotions:\n  finger:\n    - {type: press, depth_m: 0.004}\n"


def rig(old: str, new: str) -> dict[str, str]:
    """The card rig with one place changed, as my.yaml."""
    assert old in GOOD_RIG
    return {"my.yaml": GOOD_RIG.replace(old, new, 1)}


def motion(old: str, new: str) -> dict[str, str]:
    """A press with one place changed, as move.yaml."""
    assert old in GOOD_MOTION
    return {"move.yaml": GOOD_MOTION.replace(old, new, 1)}


@dataclass
class Fault:
    """Command line, files that lie in the working folder, and what stderr must say."""

    command: str | list[str]
    says: str
    files: dict[str, str] = field(default_factory=dict)


SIMULATE = "simulate my.yaml press_hold_release --out out"
SLIDE = "simulate card_press slide --out o --set"
MOVE = "simulate card_press move.yaml --out out"
FIT = "fit card_press a.mcap --params card.E --out result"
BAG = {"a.mcap": "this is no recording"}

FAULTS: dict[str, Fault] = {
    # the command line
    "no such command": Fault("simulat", "No such command"),
    "no such option": Fault("rigs --fast", "No such option"),
    "rig left out": Fault("simulate", "Missing argument"),
    "output left out": Fault("simulate card_press slide", "--out"),
    "a diagnosis has no seed": Fault("diagnose card_press a.mcap --out o --seed 1", "--seed"),
    "seed is a word": Fault("simulate card_press slide --out o --seed one", "--seed"),
    "no cases": Fault("prove make --out o --cases 0", "--cases"),
    "no starts": Fault(f"{FIT} --starts 0", "--starts is 0, but must be at least 1. Write a larger whole number", BAG),
    "half a start": Fault(f"{FIT} --starts 1.5", r"--starts is '1\.5', not a whole number. Write a whole", BAG),
    "negative seed": Fault(f"{FIT} --seed=-1", "--seed is -1, but must be at least 0. Write a larger", BAG),
    "too fine": Fault(
        "simulate card_press slide --out o --refine 9", "--refine is 9, but must be from 1 to 8. Write a smaller"
    ),
    "no spread": Fault("coverage card_press slide --params gel.E --spread nan", "--spread is 'nan', not a number"),
    # files
    "rig misspelt": Fault("params card_pres", r"Did you mean 'card_press'\?"),
    "rig file missing": Fault("params ./rig.yaml", r"not exist.*mean 'my_rig\.yaml'", {"my_rig.yaml": ""}),
    "rig is a folder": Fault("params ./folder/", "is a folder", {"folder/x": ""}),
    "rig is empty": Fault("params my.yaml", r"my\.yaml is empty", {"my.yaml": ""}),
    "rig is a list": Fault("params my.yaml", "not a mapping", {"my.yaml": "- 1\n"}),
    "rig is no text": Fault("params my.yaml", "not a text file", {"my.yaml": "\udcff\udcfe"}),
    "tab": Fault("params my.yaml", r"line 2.*tab", {"my.yaml": "name: x\n\tbodies: 1\n"}),
    "key twice": Fault("params my.yaml", r"line 2.*'name' is given twice", {"my.yaml": "name: x\nname: y\n"}),
    "empty name": Fault(["params", " "], "is empty"),
    # rigs
    "unknown key": Fault(SIMULATE, r"Did you mean 'bodies'", rig("bodies:", "bodys:")),
    "wrong unit": Fault(SIMULATE, r"write length_m: 0\.1", rig("length_m: 0.10", "length_mm: 100")),
    "metres as millimetres": Fault(SIMULATE, "must be at most 10", rig("length_m: 0.10", "length_m: 100")),
    "number as text": Fault(SIMULATE, "not a number", rig("width_m: 0.03", "width_m: '0.03'")),
    "not a number": Fault(SIMULATE, "not a finite number", rig("width_m: 0.03", "width_m: .nan")),
    "incompressible": Fault(SIMULATE, r"must be less than 0\.5", rig("nu: 0.45", "nu: 0.5")),
    "unknown body": Fault(SIMULATE, "Did you mean 'card'", rig("[gel, card]", "[gel, cart]")),
    "clamp off the card": Fault(SIMULATE, "misses 'card'", rig("[-0.05, -0.04]", "[-50, -45]")),
    "overlay of nothing": Fault(SIMULATE, "neither a file nor one", {"my.yaml": "overlay_of: nothing\n"}),
    "overlay of itself": Fault(SIMULATE, "in a circle", {"my.yaml": "overlay_of: ./my.yaml\n"}),
    # parameters
    "unknown parameter": Fault(f"{SLIDE} card.F=1", "no parameter 'card.F'"),
    "parameter without value": Fault(f"{SLIDE} card.E", "not of the form name=value"),
    "parameter is a word": Fault(f"{SLIDE} card.E=stiff", "'stiff' is not a number"),
    "parameter not finite": Fault(f"{SLIDE} card.E=inf", "not finite"),
    "parameter out of bounds": Fault(f"{SLIDE} card.nu=0.9", r"must be at most 0\.5"),
    "parameter twice": Fault(f"{SLIDE} card.E=1e9 --set sheet.E=2e9", "given twice"),
    "quantity misspelt for a fit": Fault(
        "fit card_press a.mcap --params gel.F --out o", "Did you mean 'gel.E_pa'", BAG
    ),
    "quantity misspelt for a bag": Fault(
        "fit card_press a.mcap b.mcap --params gel.E --per-bag gel.F --out o", "Did you mean 'gel.E_pa'", BAG
    ),
    "quantity misspelt in a plan": Fault("plan card_press slide --params gel.F", "Did you mean 'gel.E_pa'"),
    "quantity misspelt in coverage": Fault("coverage card_press slide --params gel.F", "Did you mean 'gel.E_pa'"),
    "quantity misspelt for gradients": Fault(
        "check-gradients card_press slide --params gel.F", "Did you mean 'gel.E_pa'"
    ),
    "sensor misspelt": Fault("plan card_press slide --params gel.E --without outsid", "Did you mean 'outside'"),
    "nuisance misspelt": Fault("plan card_press slide --params gel.E --nuisance tme", "Did you mean 'time'"),
    "fit of nothing known": Fault("fit card_press a.mcap --params card.Q --out o", "no parameter", BAG),
    "fit with unknown nuisance": Fault(
        "fit card_press a.mcap --params card.E --nuisance clock --out o", "no nuisance 'clock'", BAG
    ),
    "own value of what is not fitted": Fault(
        "fit card_press a.mcap b.mcap --params card.E --per-bag gel.E --out o", "gel.E_pa.*but is not fitted", BAG
    ),
    "own value of one bag": Fault(
        "fit card_press a.mcap --params card.E --per-bag card.E --out o", "there is only one", BAG
    ),
    "fit of an empty name": Fault("fit card_press a.mcap --params card.E,,gel.E --out o", "empty name", BAG),
    # motions
    "experiment misspelt": Fault("simulate card_press slid --out o", "Did you mean 'slide'"),
    "unknown motion": Fault(MOVE, "Did you mean 'press'", motion("type: press", "type: presss")),
    "speed in mm": Fault(MOVE, r"write speed_m_s: 0\.005", motion("0.004", "0.004, speed_mm_s: 5")),
    "negative speed": Fault(MOVE, "greater than 0", motion("0.004", "0.004, speed_m_s: -1")),
    "depth left out": Fault(MOVE, "depth_m is missing", motion(", depth_m: 0.004", "")),
    "no direction": Fault(MOVE, "Give a direction", motion("0.004", "0.004, along: [0, 0, 0]")),
    "no such end effector": Fault(MOVE, r"Known: finger", motion("finger:", "gripper:")),
    "no motion at all": Fault(MOVE, "neither motions nor duration_s", {"move.yaml": "name: test\n"}),
    "too long": Fault(MOVE, "more than 2000000", motion("0.004", "1.0, speed_m_s: 1.0e-6, times: 100")),
    # recordings
    "recording named as one of ROS 1": Fault(
        "simulate card_press press_post --out run.bag",
        r"run\.bag has the name of a ROS 1 bag.* Name a folder, run, or a single file, run\.mcap",
    ),
    "held-out recordings missing": Fault(
        f"fit card_press {PRESS_POST} --params gel.E --held-out none other --out o", r"none does not exist"
    ),
    "recording missing": Fault("inspect no.bag", r"no\.bag does not exist"),
    "recording is no recording": Fault("inspect a.mcap", r"a\.mcap", BAG),
    "recording is empty": Fault("inspect a.mcap", r"a\.mcap", {"a.mcap": ""}),
    "folder without recording": Fault("inspect bag", "bag", {"bag/notes.txt": "hello"}),
    "recording to fit missing": Fault("fit card_press b.mcap --params card.E --out result", "does not exist"),
    "held-out missing": Fault(f"{FIT} --held-out b.mcap", r"b\.mcap does not exist", BAG),
    "recording of another rig": Fault(
        ["fit", "material_bench", PRESS_POST, "--params", "gel.E", "--out", "o"],
        r"press_post does not match the rig 'material_bench': it lacks the pose of 'gripper'.*Give the rig that it was",
    ),
    "recording with other topics": Fault(
        ["inspect", PRESS_POST, "--rig", "my.yaml"],
        r"press_post does not match the rig 'card_press': it lacks the readings of 'wrench_gel' \(cell/wrench\).*it "
        r"has .*/tactile/left/wrench.*write the topics of the recording into this one, as in sensors\.wrench_gel\.",
        {"my.yaml": GOOD_RIG.replace("tactile/left/", "cell/").replace("outside/", "side/")},
    ),
    "recording twice": Fault("diagnose card_press a.mcap ./a.mcap --out result", "given twice", BAG),
    "window is held out": Fault(f"{FIT} --held-out a.mcap@1:2", "readings from 1 to 2 s are given both", BAG),
    "held-out is used": Fault(f"{FIT} --held-out a.mcap", "both to use and to hold out", BAG),
    "recording to track missing": Fault("track no.bag --out o", "does not exist"),
    "recording of presses missing": Fault("presses tactip_cr no.bag --out o", "does not exist"),
    "benchmark missing": Fault("prove score nowhere", "nowhere does not exist"),
    "rig and recording exchanged": Fault(
        ["fit", PRESS_POST, "card_press", "--params", "gel.E", "--out", "o"],
        "press_post is a folder, not a YAML file. This looks like a recording; rigs and experiments come before",
    ),
    "rig and experiment exchanged": Fault(
        "simulate move.yaml my.yaml --out o",
        "move.yaml is an experiment, and a rig is wanted",
        {**rig("", ""), **motion("", "")},
    ),
    "rig for an experiment": Fault(
        "simulate card_press my.yaml --out o", "my.yaml is a rig, and an experiment is wanted", rig("", "")
    ),
    "window of an instant": Fault(
        ["fit", "card_press", f"{PRESS_POST}@0:0.01", "--params", "gel.E", "--out", "o"],
        "has readings of its first instant only.*Give a longer recording, or a longer window",
    ),
    # output
    "output exists": Fault("simulate card_press slide --out taken", "already exists", {"taken/x": ""}),
    "output below a file": Fault("simulate card_press slide --out file/o", "file is a file", {"file": ""}),
    "result exists": Fault(FIT, "already exists", {**BAG, "result/x": ""}),
}  # fmt: skip


def snapshot(folder: Path) -> dict[Path, bytes]:
    """Every file below a folder and its content."""
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def prepare(fault: Fault, folder: Path) -> list[str]:
    """Write the files of a fault; return its words."""
    for file, text in fault.files.items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, errors="surrogateescape")
    return fault.command if isinstance(fault.command, list) else fault.command.split()


def check(fault: Fault, code: int, output: str, errors: str) -> None:
    """One paragraph, with what the fault must say, and nothing else."""
    assert code == 2, errors
    assert output == ""
    assert re.search(fault.says, errors), errors
    assert errors.startswith("thinshell: ")
    assert errors.count("\n") == 1
    assert errors.rstrip().endswith((".", "?", ")"))
    assert "Traceback" not in errors


@pytest.mark.parametrize("name", FAULTS)
def test_one_paragraph_and_nothing_written(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = prepare(FAULTS[name], tmp_path)
    before = snapshot(tmp_path)
    monkeypatch.chdir(tmp_path)
    code = main(words)
    output, errors = capsys.readouterr()
    check(FAULTS[name], code, output, errors)
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize(
    "name",
    [
        "no such command",
        "tab",
        "wrong unit",
        "parameter twice",
        "unknown motion",
        "recording is no recording",
    ],
)
def test_the_same_as_a_command(name: str, tmp_path: Path) -> None:
    words = prepare(FAULTS[name], tmp_path)
    before = snapshot(tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "sysid", *words], cwd=tmp_path, capture_output=True, text=True, timeout=300
    )
    check(FAULTS[name], done.returncode, done.stdout, done.stderr)
    assert snapshot(tmp_path) == before


def test_a_truncated_recording_is_read_as_far_as_it_goes_and_left_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = sorted((config_folder().parent / "bags").rglob("*.mcap"))[0]
    cut = tmp_path / "cut.mcap"
    shutil.copy(whole, cut)
    cut.write_bytes(cut.read_bytes()[: cut.stat().st_size // 2])
    before = snapshot(tmp_path)
    assert main(["inspect", str(cut)]) == 0
    output, errors = capsys.readouterr()
    assert "messages were recovered" in output
    assert "Traceback" not in errors
    assert snapshot(tmp_path) == before
