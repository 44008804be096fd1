"""The reference of the command line, from the commands themselves."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from typing import Any

import typer

from sysid.cli.app import app

HEAD = """# Command line

This page is made from the commands. `thinshell COMMAND --help` prints the same.

Exit codes: 0, done; 1, a defect of the program, a validation row that is missed, or a soak that found one; 2, input
that cannot be used, with one paragraph that says what to do; 3, a fit that did not converge; 4, a fit or a
diagnosis of which the model misses the recordings by more than ten times their noise; 130, interrupted.
"""


def commands() -> dict[str, Any]:
    """All commands by their full name, groups resolved."""

    def below(command: Any, prefix: str) -> Iterator[tuple[str, Any]]:
        inner = getattr(command, "commands", None)
        if inner is None or (" " in prefix and getattr(command, "invoke_without_command", False)):
            yield prefix, command
        for name, child in sorted((inner or {}).items()):
            yield from below(child, f"{prefix} {name}")

    return dict(below(typer.main.get_command(app), "thinshell"))


def page() -> str:
    """The page as Markdown."""
    return "\n\n".join([HEAD, *(_section(name, command) for name, command in commands().items())]) + "\n"


def _section(name: str, command: Any) -> str:
    arguments = [p for p in command.params if p.param_type_name == "argument"]
    options = [p for p in command.params if p.param_type_name == "option" and p.name != "help"]
    usage = " ".join([name, *(_metavar(p) for p in arguments)])
    lines = [f"## {name}", "", f"`{usage}`", "", inspect.cleandoc(command.help or ""), ""]
    if arguments or options:
        lines += ["| | default | meaning |", "| --- | --- | --- |"]
    lines += [_row(f"`{_metavar(p)}`", p) for p in arguments]
    lines += [
        _row(f"`{' '.join([', '.join([*p.opts, *p.secondary_opts]), p.metavar or '']).strip()}`", p) for p in options
    ]
    return "\n".join(lines)


def _metavar(parameter: Any) -> str:
    return str(parameter.metavar or parameter.name.upper())


def _row(name: str, parameter: Any) -> str:
    value = parameter.default
    shown = "" if value is None or callable(value) or value in (False, (), []) else f"`{value}`"
    cells = ["required" if parameter.required else shown, (parameter.help or "").replace("|", "\\|")]
    return f"| {name.replace('|', chr(92) + '|')} | " + " | ".join(cells) + " |"
