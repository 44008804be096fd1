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
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from typing import Annotated, Literal

import typer

State = Literal["ok", "warn", "missing"]

PYTHONS = ((3, 10), (3, 13))
WANTED_DISK_GB = 2.0

_LOCAL_NAMES = re.compile(r"^\s*([A-Za-z0-9._-]+)\s*(?:\[[^]]*\])?\s*([^;]*)(?:;\s*(.*))?$")

_PARDISO = """
import numpy, scipy.sparse
from pypardiso import spsolve
a = scipy.sparse.diags([2.0, 3.0, 4.0], format="csr")
assert numpy.allclose(spsolve(a, numpy.array([2.0, 3.0, 4.0])), 1.0)
"""

_QDLDL = """
import numpy, scipy.sparse, qdldl
a = scipy.sparse.diags([2.0, 3.0, 4.0], format="csc")
assert numpy.allclose(qdldl.Solver(a).solve(numpy.array([2.0, 3.0, 4.0])), 1.0)
"""

_TAICHI = """
import tempfile, pathlib
folder = pathlib.Path(tempfile.mkdtemp())
(folder / "kernel.py").write_text('''
import taichi as ti
ti.init(arch=ti.cpu, default_fp=ti.f64, log_level=ti.ERROR)
@ti.kernel
def total(n: ti.i32) -> ti.f64:
    s = 0.0
    for i in range(n):
        s += 0.5
    return s
assert total(10) == 5.0
''')
import runpy
runpy.run_path(str(folder / "kernel.py"))
"""

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
raise SystemExit(0 if heard == ["here"] or "here" in heard else 3)
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
    yield _child("Taichi", _TAICHI, "starts and compiles a kernel", "pip install --force-reinstall taichi", core=True)
    yield from _factorisation()
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
    from packaging.requirements import Requirement

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
