"""The laws' Python source as text: functions, constants and imports of modules, without running them."""

from __future__ import annotations

import ast
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["PACKAGE", "Source", "Sources", "decorators"]

PACKAGE = Path(__file__).resolve().parents[1]


def decorators(node: ast.FunctionDef) -> set[str]:
    """Its decorators as they are written."""
    return {ast.unparse(d) for d in node.decorator_list}


class Source:
    """One module: its functions, and the expressions that its constants and imports stand for."""

    def __init__(self, name: str, path: Path) -> None:
        self.name, self.path = name, path
        self.tree = ast.parse(path.read_text(), str(path))
        self.functions: dict[str, ast.FunctionDef] = {}
        self.constants: dict[str, tuple[ast.expr, int | None]] = {}
        self.imports: dict[str, tuple[str, str]] = {}
        for node in self.tree.body:
            if isinstance(node, ast.FunctionDef):
                self.functions[node.name] = node
            elif isinstance(node, ast.ImportFrom) and node.module:
                self.imports.update({a.asname or a.name: (node.module, a.name) for a in node.names})
            elif isinstance(node, ast.Assign):
                target = node.targets[0]
                several = isinstance(target, ast.Tuple)
                for i, name_node in enumerate(target.elts if isinstance(target, ast.Tuple) else [target]):
                    if isinstance(name_node, ast.Name):
                        self.constants[name_node.id] = node.value, i if several else None

    @property
    def space(self) -> str:
        """Its C++ namespace."""
        return self.name.rpartition(".")[2]

    @property
    def laws(self) -> list[str]:
        """Its functions that are declared as laws."""
        return [name for name, node in self.functions.items() if decorators(node) & {"lang.func", "lang.kernel"}]


class Sources:
    """Modules by name, read when they are asked for first."""

    def __init__(self) -> None:
        self._sources: dict[str, Source | None] = {}

    def source(self, name: str, path: Path | None = None) -> Source | None:
        """A module; without ``path`` one of the project's, None where there is none of that name."""
        if name not in self._sources:
            path = path or PACKAGE.parent / (name.replace(".", "/") + ".py")
            self._sources[name] = Source(name, path) if path.is_file() else None
        return self._sources[name]

    def find(self, source: Source, name: str) -> tuple[Source, str] | None:
        """Where a name of a module is defined."""
        if name in source.imports:
            module, attribute = source.imports[name]
            origin = self.source(module)
            return self.find(origin, attribute) if origin else None
        return (source, name) if name in source.functions or name in source.constants else None

    def expression(self, source: Source, name: str) -> tuple[Source, ast.expr, int | None] | None:
        """What a constant is assigned, where, and which part of that it is."""
        found = self.find(source, name)
        return (found[0], *found[0].constants[found[1]]) if found and found[1] in found[0].constants else None

    def evaluate(self, source: Source, node: ast.expr, known: Mapping[str, Any]) -> Any:
        """Value of an expression of constants. Raises ``ValueError`` where its text alone does not give one."""
        names: dict[str, Any] = {"range": range, "math": math, "float": float, "int": int, "len": len}
        for part in ast.walk(node):
            if isinstance(part, ast.Name) and part.id in known:
                names[part.id] = known[part.id]
            elif isinstance(part, ast.Name) and part.id not in names:
                found = self.expression(source, part.id)
                if found is None:
                    raise ValueError(part.id)
                value = self.evaluate(found[0], found[1], {})
                names[part.id] = value if found[2] is None else value[found[2]]
            elif isinstance(part, ast.Attribute) and ast.unparse(part.value) != "math":
                raise ValueError(ast.unparse(part))
        try:
            return eval(compile(ast.Expression(node), str(source.path), "eval"), {"__builtins__": {}}, names)
        except Exception as error:
            raise ValueError(str(error)) from error
