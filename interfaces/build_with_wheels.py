"""Build thinshell_interfaces where ROS is the wheels of the extra ``ros``; a machine with ROS builds it with colcon.

    python interfaces/build_with_wheels.py FOLDER

Makes a virtual environment in FOLDER with the generators of messages (300 MB), and the package in FOLDER/install. Needs
a C++ compiler and CMake, and the Python that runs this has to be of the version that the nodes run with. What to set
before nodes start is printed at the end.
"""

from __future__ import annotations

import subprocess
import sys
import sysconfig
from pathlib import Path

WHEELS = [
    "rclpy", "common-interfaces", "rmw-fastrtps-cpp", "rosidl-default-generators", "rosidl-core-generators",
    "ament-cmake", "ament-cmake-include-directories", "ament-cmake-export-interfaces", "ament-cmake-export-link-flags",
    "ament-cmake-export-targets", "ament-cmake-ros", "ament-cmake-gtest", "ament-cmake-gmock", "ament-cmake-pytest",
    "python-cmake-module", "pybind11-vendor", "ament-package",
]  # fmt: skip
OTHERS = ["catkin_pkg", "empy==3.3.4", "lark", "numpy>=2", "setuptools<80"]
BAKED_IN = (
    "/opt/python/cp311-cp311/lib/python3.11/site-packages/numpy/_core/include",
    "/opt/python/cp311-cp311/include/python3.11",
)
"""Folders of numpy and of Python on the machine that made the wheels, which their CMake files name."""


def main() -> int:
    """Build, and say how it is used."""
    words = sys.argv[1:]
    if len(words) != 1 or words[0].startswith("-"):
        helped = words in (["-h"], ["--help"])
        print(__doc__, file=sys.stdout if helped else sys.stderr)
        return 0 if helped else 2
    folder = Path(words[0]).absolute()
    if folder.exists() and not folder.is_dir():
        print(f"error: {words[0]} is a file, and a folder is wanted. Name a new folder.", file=sys.stderr)
        return 2
    prefix, built, install = folder / "venv", folder / "build", folder / "install"
    python = prefix / "bin" / "python"
    try:
        if not python.exists():
            subprocess.run([sys.executable, "-m", "venv", str(prefix)], check=True)
        named = [f"ros-jazzy-{name}" for name in WHEELS]
        subprocess.run([str(python), "-m", "pip", "install", "--quiet", *named, *OTHERS], check=True)
        numpy = subprocess.check_output([str(python), "-c", "import numpy; print(numpy.get_include())"], text=True)
        there = numpy.strip(), sysconfig.get_paths()["include"]
        for path in (prefix / "share").rglob("*.cmake"):
            text = given = path.read_text()
            for baked_in, here in zip(BAKED_IN, there, strict=True):
                text = text.replace(baked_in, here)
            if text != given:
                path.write_text(text)
        settings = {
            "CMAKE_PREFIX_PATH": prefix, "CMAKE_INSTALL_PREFIX": install, "Python3_EXECUTABLE": python,
            "BUILD_TESTING": "OFF",
        }  # fmt: skip
        defined = [f"-D{name}={value}" for name, value in settings.items()]
        environment = {"PATH": f"{prefix / 'bin'}:/usr/local/bin:/usr/bin:/bin", "AMENT_PREFIX_PATH": str(prefix)}
        source = Path(__file__).absolute().parent
        for command in (
            ["cmake", "-S", str(source), "-B", str(built), *defined],
            ["cmake", "--build", str(built), "--target", "install"],
        ):
            subprocess.run(command, check=True, env=environment)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    packages = next(install.glob("lib/python3*/site-packages"))
    print("Before nodes start:")
    print(f"export PYTHONPATH={packages}:$PYTHONPATH LD_LIBRARY_PATH={install / 'lib'}:$LD_LIBRARY_PATH")
    return 0


if __name__ == "__main__":
    sys.exit(main())
