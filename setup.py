"""What a colcon build needs: version, packages, executables, and files under share/.

The rest is in pyproject.toml. These parts are here because ``colcon build --symlink-install`` runs this
file without pyproject.toml next to it, and because colcon cannot read a package whose pyproject.toml
gives ``requires-python``.
"""

import subprocess
import sys
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.build_py import build_py
from setuptools.command.develop import develop

ROOT = Path(__file__).resolve().parent
SHARE = Path("share/thinshell_ros")


def share_files() -> list[tuple[str, list[str]]]:
    """Target folder and files of package.xml, config/ and launch/."""
    folders: dict[Path, list[str]] = {SHARE: ["package.xml"]}
    for top in ("config", "launch"):
        for path in sorted((ROOT / top).rglob("*")):
            if path.is_file():
                relative = path.relative_to(ROOT)
                folders.setdefault(SHARE / relative.parent, []).append(relative.as_posix())
    return [(folder.as_posix(), files) for folder, files in folders.items()]


def compile_core(into: Path) -> None:
    """Compile the core of sim_core to ``into``. Without a compiler it is compiled at first use, where there is one by
    then; there are no rollouts before that."""
    sys.path.insert(0, str(ROOT))
    try:
        from sim_core.core.build import find_or_build

        print(f"compiled core: {find_or_build((into,))}")
    except OSError as error:
        print(f"The compiled core was not built: {error}.", file=sys.stderr)
    finally:
        sys.path.remove(str(ROOT))


def compile_laws(base: Path) -> None:
    """Compile the laws of all effects of the package that was built in ``base``. Without them they are compiled at
    first use, as a user's own are."""
    into = base / "sim_core" / "core" / "built" / "laws"
    command = [sys.executable, "-m", "sim_core.shipped_laws", str(into.resolve())]
    done = subprocess.run(command, cwd=base, capture_output=True, text=True)
    if done.returncode:
        print(f"The laws of effects were not built: {(done.stderr.splitlines() or ['']).pop()}", file=sys.stderr)
    else:
        print(done.stdout.strip())


class BuildWithCore(build_py):
    """Builds the modules, and the compiled core next to them (in place where the package is installed for editing,
    where laws of effects are compiled at first use)."""

    def run(self) -> None:
        super().run()
        base = ROOT if self.editable_mode else Path(self.build_lib)
        compile_core(base / "sim_core" / "core" / "built")
        if not self.editable_mode:
            compile_laws(base)


class DevelopWithCore(develop):
    """Installs for editing the way colcon does with --symlink-install."""

    def run(self) -> None:
        super().run()
        compile_core(ROOT / "sim_core" / "core" / "built")


setup(
    name="thinshell_ros",
    cmdclass={"build_py": BuildWithCore, "develop": DevelopWithCore},
    version="0.1.0",
    python_requires=">=3.10,<3.14",
    packages=find_packages(str(ROOT), include=["sim_core*", "sysid*", "thinshell_ros*"]),
    data_files=[("share/ament_index/resource_index/packages", ["resource/thinshell_ros"]), *share_files()],
    entry_points={
        "console_scripts": [
            "thinshell = sysid.cli.app:main",
            "sim_node = thinshell_ros.sim_node:main",
            "tf_node = thinshell_ros.tf_node:main",
            "marker_node = thinshell_ros.marker_node:main",
            "record_node = thinshell_ros.record_node:main",
            "sysid_node = thinshell_ros.sysid_node:main",
            "replay_node = thinshell_ros.replay_node:main",
        ],
    },
)
