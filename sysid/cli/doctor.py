"""``thinshell doctor``: what is installed, what works, and how to mend what does not.

Everything that could take the process down with it (ROS, MKL) is tried in a child process.
"""

from __future__ import annotations

import importlib.util
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Annotated, Literal

import typer

State = Literal["ok", "warn", "missing"]

PYTHONS = ((3, 10), (3, 13))
WANTED_DISK_GB = 2.0
PATIENCE_S = 600
"""Time that each check gets [s]: on a busy machine the tiny fit takes minutes."""

_CORE = """
from sim_core.core.library import load
assert load().functions is not None, load().lack
"""

OF_EXTRAS = ("distributed", "gymnasium", "stable_baselines3", "torch", "viser", "pytetwild", "pyvista", "pyarrow")
"""Modules that only extras bring."""

_SUPERNODES = """
from sim_core.core.library import load
assert load().supernodes
"""

_IMPORTS = f"""
import importlib, pkgutil
import sim_core, sysid
for package in (sim_core, sysid):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if not module.name.endswith("__main__"):
            try:
                importlib.import_module(module.name)
            except ModuleNotFoundError as error:
                if (error.name or "").partition(".")[0] not in {OF_EXTRAS}:
                    raise
"""
"""All that any command imports."""

_FIT = """
import tempfile
from pathlib import Path
from sim_core.rigs import parse_rig, with_parameters
from sim_core.rigs.motion import Experiment
from sysid.fit import FitOptions, fit_runs
from sysid.model.load import load_run
from sysid.model.predictor import SerialPredictor
from sysid.simulate import simulate_to_bag
rig = parse_rig({
    "name": "doctor",
    "solver": {"dt_s": 0.1, "inertia": False},
    "bodies": {"strip": {
        "type": "sheet",
        "shape": {"type": "rectangle", "length_m": 0.1, "width_m": 0.02, "cells": [4, 1], "pattern": "crossed"},
        "material": {"E_pa": 2.0e9, "nu": 0.3, "thickness_m": 1.0e-4, "density_kg_m3": 1000.0},
    }},
    "clamps": [
        {"name": "jaw", "body": "strip", "region": {"x_m": [-0.05, -0.025]}, "mount": "world"},
        {"name": "grip", "body": "strip", "region": {"x_m": [0.025, 0.05]}, "mount": "hand"},
    ],
    "end_effectors": {"hand": {"start": {"position_m": [0.05, 0.0, 0.0]}}},
    "sensors": {"gauge": {"type": "wrench", "on": "hand", "rate_hz": 10.0,
                          "noise": {"force_n": 0.01, "torque_nm": 1.0e-4}}},
}, "the rig of the doctor")
pull = [{"type": "wait", "duration_s": 0.5},
        {"type": "waypoints", "speed_m_s": 1.0e-3, "poses": [{"position_m": [1.0e-3, 0.0, 0.0]}]}]
experiment = Experiment.model_validate({"name": "pull", "motions": {"hand": pull}})
with tempfile.TemporaryDirectory() as folder:
    simulate_to_bag(with_parameters(rig, {"strip.E_pa": 3.0e9}), experiment, Path(folder) / "bag", seed=1)
    run = load_run(rig, Path(folder) / "bag")
    options = FitOptions(nuisance=["none"], intervals="quadratic", robust=False)
    result, _ = fit_runs(rig, [run], ["strip.E_pa"], options, engine=SerialPredictor())
found = result.estimates[0].value
assert abs(found / 3.0e9 - 1.0) < 0.02, f"fitted {found:.4g} Pa where 3e9 Pa was simulated"
"""
"""Simulates, records, reads and fits a strip that is pulled."""

_ROS_LOOPBACK = """
import time
import rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("thinshell_doctor")
heard = []
node.create_subscription(String, "~/echo", lambda message: heard.append(message.data), 1)
publisher = node.create_publisher(String, "~/echo", 1)
end = time.monotonic() + 10.0
while not heard and time.monotonic() < end:
    publisher.publish(String(data="here"))
    rclpy.spin_once(node, timeout_sec=0.1)
node.destroy_node()
rclpy.try_shutdown()
raise SystemExit(0 if heard else "no message came back within 10 s")
"""


@dataclass(frozen=True)
class Finding:
    """One line of the report. ``core``: without it nothing works."""

    name: str
    state: State
    detail: str
    remedy: str = ""
    core: bool = False


def doctor_command(as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False) -> None:
    """Say what is installed, what works, and how to mend what does not.

    Exit code 0 if the simulator and the identification work (ROS is optional), 2 if not.
    """
    findings = []
    for finding in examine():
        findings.append(finding)
        if not as_json:
            print(f"{finding.state:8}{finding.name}: {finding.detail}", flush=True)
            if finding.remedy and finding.state != "ok":
                print(f"        -> {finding.remedy}", flush=True)
    works = all(finding.state != "missing" for finding in findings if finding.core)
    if as_json:
        print(json.dumps({"works": works, "findings": [asdict(finding) for finding in findings]}, indent=2))
    else:
        print("The core works." if works else "The core does not work: mend what is missing above.")
    if not works:
        raise typer.Exit(2)


def examine() -> Iterator[Finding]:
    """All checks, one after the other, each as soon as it is done."""
    yield _python()
    yield from _dependencies()
    remedy = "Install a C++ compiler (Debian, Ubuntu: apt-get install g++), or set CXX."
    yield _child("Compiled core", _CORE, "is there, or was compiled", remedy, core=True)
    yield _factorisation()
    remedy = "Install what is named there: pip install --upgrade --force-reinstall thinshell_ros."
    imports = _child("Modules", _IMPORTS, "all that the commands need is imported", remedy, core=True)
    yield imports
    if imports.state == "ok":
        remedy = "Run it again with nothing else running; then report it with the output of thinshell doctor --json."
        yield _child("Fit", _FIT, "a strip was simulated, recorded, read and fitted", remedy, core=True)
    yield from _ros()
    yield _chromium()
    yield _disk()


def _python() -> Finding:
    low, high = PYTHONS
    detail = f"{platform.python_version()} at {sys.executable}, {platform.system()} {platform.machine()}"
    if low <= sys.version_info[:2] <= high:
        return Finding("Python", "ok", detail, core=True)
    remedy = f"Use Python {low[0]}.{low[1]} to {high[0]}.{high[1]}."
    return Finding("Python", "missing", detail, remedy, core=True)


def _dependencies() -> Iterator[Finding]:
    try:
        wanted = requires("thinshell_ros") or []
    except PackageNotFoundError:
        yield Finding("thinshell_ros", "warn", "not installed, running from the source tree", "pip install -e .")
        return
    try:
        from packaging.requirements import Requirement
    except ImportError:
        yield Finding("packaging", "missing", "not installed", "pip install packaging", core=True)
        return
    for text in wanted:
        requirement = Requirement(text)
        extra = re.search(r"extra == ['\"](\w+)['\"]", str(requirement.marker or ""))
        if requirement.marker and not requirement.marker.evaluate({"extra": extra[1] if extra else ""}):
            continue
        optional = extra is not None or requirement.name == "py-mkl-pardiso"
        needed = f"needs {requirement.specifier}" if str(requirement.specifier) else "any version"
        remedy = f'pip install "{requirement.name}{requirement.specifier}"'
        label = f"{requirement.name} [{extra[1]}]" if extra else requirement.name
        try:
            found = version(requirement.name)
        except PackageNotFoundError:
            state: State = "warn" if optional else "missing"
            yield Finding(label, state, f"not installed, {needed}", remedy, core=not optional)
            continue
        fits = requirement.specifier.contains(found, prereleases=True)
        yield Finding(label, "ok" if fits else "warn", f"{found}, {needed}", "" if fits else remedy, core=not optional)


def _factorisation() -> Finding:
    if importlib.util.find_spec("pymklpardiso") is None:
        detail = "no wheel for this platform: scenes with wide meshes are slower"
        return Finding("MKL PARDISO", "warn", detail, "On Linux x86-64: pip install py-mkl-pardiso.")
    remedy = "pip install --force-reinstall py-mkl-pardiso, or uninstall it."
    return _child("MKL PARDISO", _SUPERNODES, "the compiled core has found it", remedy)


def _ros() -> Iterator[Finding]:
    if importlib.util.find_spec("rclpy") is None:
        detail = "not installed (optional: only the nodes need it)"
        remedy = "On Linux x86-64: pip install 'thinshell_ros[ros]', or source the setup file of a ROS 2 Jazzy."
        yield Finding("ROS 2", "warn", detail, remedy)
        return
    yield from _ros_traps(os.environ)
    remedy = "Mend what is said of ROS above; else reinstall it, or source its setup file again."
    imported = _child("ROS 2 import", "import rclpy, geometry_msgs.msg, sensor_msgs.msg", "rclpy loads", remedy)
    yield imported
    if imported.state == "ok":
        remedy = "Check that the firewall lets this machine talk to itself (UDP on the loopback interface)."
        yield _child("ROS 2 loopback", _ROS_LOOPBACK, "a message went out and came back", remedy)


def _ros_traps(environment: Mapping[str, str]) -> Iterator[Finding]:
    """Settings that are known to break the ROS wheels without saying so."""
    library = str(Path(sys.prefix) / "lib")
    guard = "_ROS_WHEELS_BOOTSTRAP_COMPLETE"
    if guard in environment and library not in environment.get("LD_LIBRARY_PATH", "").split(":"):
        detail = f"{guard} is set, but LD_LIBRARY_PATH lacks {library}: rclpy cannot load its libraries"
        yield Finding("ROS 2 start-up", "warn", detail, f"unset {guard}")
    chosen = environment.get("RMW_IMPLEMENTATION", "rmw_fastrtps_cpp")
    folders = [library, *environment.get("LD_LIBRARY_PATH", "").split(":")]
    if not any((Path(folder) / f"lib{chosen}.so").exists() for folder in folders if folder):
        detail = f"RMW_IMPLEMENTATION is {chosen}, which is not installed: nodes exit with code 102 and no message"
        yield Finding("ROS 2 middleware", "warn", detail, "unset RMW_IMPLEMENTATION, or install that middleware.")


def _chromium() -> Finding:
    browser = _first("chromium", "chromium-browser", "google-chrome")
    driver = _first("chromedriver")
    if browser and driver:
        return Finding("Chromium", "ok", f"{browser} with {driver}")
    lacking = "no browser" if not browser else "no chromedriver"
    remedy = "Only the tests of reports need it: apt-get install chromium chromium-driver."
    return Finding("Chromium", "warn", f"{lacking} on the PATH", remedy)


def _first(*names: str) -> str | None:
    return next((path for path in map(shutil.which, names) if path), None)


def _disk() -> Finding:
    free = min(shutil.disk_usage(folder).free for folder in (Path.cwd(), Path(tempfile.gettempdir()))) / 1e9
    detail = f"{free:.1f} GB free here and in {tempfile.gettempdir()}"
    if free >= WANTED_DISK_GB:
        return Finding("Disk", "ok", detail)
    return Finding("Disk", "warn", detail, f"Make room: recordings and reports want {WANTED_DISK_GB:g} GB.")


def _child(name: str, code: str, good: str, remedy: str = "", core: bool = False) -> Finding:
    """Run code in a process of its own; its exit decides."""
    bad: State = "missing" if core else "warn"
    with tempfile.TemporaryDirectory() as folder:
        script = Path(folder) / "check.py"
        script.write_text(code, encoding="utf-8")
        root = str(Path(__file__).resolve().parents[2])
        path = os.pathsep.join([root, *filter(None, [os.environ.get("PYTHONPATH")])])
        environment = {
            **os.environ,
            "PYTHONPATH": path,
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": folder,
        }
        try:
            done = subprocess.run(
                [sys.executable, str(script)],
                env=environment,
                capture_output=True,
                text=True,
                timeout=PATIENCE_S,
                cwd=folder,
            )
        except subprocess.TimeoutExpired:
            return Finding(name, bad, f"did not finish in {PATIENCE_S} s", remedy, core)
    if done.returncode == 0:
        return Finding(name, "ok", good, core=core)
    last = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
    return Finding(name, bad, f"failed with exit code {done.returncode}: {last}", remedy, core)
