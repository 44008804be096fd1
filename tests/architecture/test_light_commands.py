"""A command loads what it works with: those that only read and list start without simulator, plots and optimisers."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

SIMULATOR = {"sim_core.scene", "sim_core.kernels"}
OPTIONAL = {"cv2", "jinja2", "matplotlib", "meshio", "PIL", "rosbags.rosbag1", "scipy.optimize", "scipy.stats"}
READING = {"mcap", "rosbags", "scipy", "sqlite3"}
ARRAYS = {"numpy", "yaml", "sim_core.rigs", "sim_core.effects"}

LIGHT = {
    "settings": SIMULATOR | OPTIONAL | READING | ARRAYS,
    "effects": SIMULATOR | OPTIONAL | READING,
    "params card_press": SIMULATOR | OPTIONAL | READING,
    "inspect bags/press_post": SIMULATOR | OPTIONAL,
}
"""Modules that a command must not load, by the command."""

EVERY_HELP = """
import typer
from sysid.cli.app import app
def paths(group, *above):
    for name, command in group.commands.items():
        yield (*above, name)
        if hasattr(command, "commands"):
            yield from paths(command, *above, name)
command = typer.main.get_command(app)
found = list(paths(command))
assert ("fit",) in found and ("prove", "run") in found, found
for path in [(), *found]:
    assert command.main([*path, "--help"], "thinshell", standalone_mode=False) == 0
"""


def loaded_by(code: str) -> set[str]:
    """Names of all modules that a fresh interpreter has loaded after some code."""
    code += "\nimport sys; print('loaded', *sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return set(done.stderr.rpartition("loaded ")[2].split())


@pytest.mark.parametrize("command", LIGHT)
def test_a_light_command_loads_nothing_that_it_has_no_use_for(command: str) -> None:
    code = f"from sysid.cli.app import main\nassert main({command.split()}) == 0"
    assert not loaded_by(code) & LIGHT[command]


def test_the_help_of_every_command_loads_no_arrays_and_nothing_that_works_on_them() -> None:
    assert not loaded_by(EVERY_HELP) & (SIMULATOR | OPTIONAL | READING | ARRAYS)


def test_the_packages_themselves_load_nothing_but_the_standard_library() -> None:
    others = {name.partition(".")[0] for name in loaded_by("import sim_core, sysid") - loaded_by("pass")}
    assert others <= {"sim_core", "sysid", *sys.stdlib_module_names}


def test_what_is_loaded_is_seen() -> None:
    assert loaded_by("import yaml") & ARRAYS == {"yaml"}
