"""The declared public API: the packages and modules whose ``__all__`` is kept stable, and their pages."""

from __future__ import annotations

import importlib

PUBLIC: dict[str, str] = {
    "sim_core": "Rigs, experiments and rollouts by their short names",
    "sim_core.rigs": "Rigs: what stands on the table",
    "sim_core.rigs.motion": "Experiments: how it is moved",
    "sim_core.scene": "A rig made runnable",
    "sim_core.simulate": "Rollouts and traces",
    "sim_core.trace_file": "Traces as files",
    "sim_core.batch": "Many rollouts side by side",
    "sim_core.gradients": "Derivatives of whole rollouts",
    "sim_core.postprocess": "Surfaces, strain, pressure and slip",
    "sim_core.preflight": "What looks wrong before anything runs",
    "sim_core.trajectories": "Trajectories for robots",
    "sim_core.effects": "Effects and their registry",
    "sim_core.effects.hooks": "Interfaces of effects",
    "sim_core.errors": "Errors",
    "sysid": "Recordings, fits and diagnoses by their short names",
    "sysid.recording": "Recordings read and written",
    "sysid.simulate": "Simulated recordings",
    "sysid.fit": "Fits",
    "sysid.diagnosis": "Diagnoses",
    "sysid.show": "Pictures, animations and pages",
}
"""Title of the page of each."""

HEAD = """# Python API

What these pages list is public: names in the `__all__` of these packages keep their meaning within a minor version.
Everything else may move. All quantities are SI; quaternions are x, y, z, w; arrays are NumPy arrays of `float64` with
the shapes that the docstrings state. Errors that a user can act on are `sim_core.errors.ThinshellError`.
"""


def names(module: str) -> list[str]:
    """The public names of a module, in alphabetical order."""
    return sorted(importlib.import_module(module).__all__)


def index() -> str:
    """The page that lists all as Markdown."""
    rows = [f"| [`{module}`]({module}.md) | {title} | {len(names(module))} |" for module, title in PUBLIC.items()]
    return "\n".join([HEAD, "| module | content | names |", "| --- | --- | --- |", *rows, ""])


def page(module: str) -> str:
    """The page of one module as Markdown, for mkdocstrings."""
    parts = [f"# {module}", f"{PUBLIC[module]}."]
    parts += [f"::: {module}.{name}" for name in names(module)]
    return "\n\n".join(parts) + "\n"
