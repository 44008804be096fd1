"""Lower the laws, functions in restricted Python (:mod:`sim_core.core.language`), to a C++ header.

A law is written once. This module translates its source text, without importing it, to templates in ``namespace
thinshell::laws::<module>`` that are instantiated with ``double``, ``float`` and dual numbers (``include/small.hpp``,
``include/dual.hpp``). Translation is syntax by syntax:

| Python | C++ |
| --- | --- |
| a function of x, y | ``template <class A0, class A1> auto f(const A0 x, const A1 y)`` |
| an argument ``lang.template()`` | ``A0 &&x`` |
| a variable assigned once | ``const auto`` |
| a variable that changes | ``auto``, real numbers in S, the common scalar of all arguments |
| ``c[i]``, ``c[t, i, j]`` | ``c[i]``, ``c(t, i, j)`` |
| ``lang.static(range(3))``; over a tuple of numbers | a loop to unroll; one block for each |
| ``return a, b`` | ``tuple_of(a, b)`` |

Variables live in the block in which they are assigned first. Constants of modules become numbers. What
cannot be translated raises :class:`LoweringError` with function, line and remedy.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from sim_core.core.law_sources import PACKAGE, Source, Sources, decorators
from sim_core.core.lowering_expressions import OPERATORS, Expressions, LoweringError, cpp_name, inside

__all__ = ["Library", "LoweringError", "header"]


class Library(Sources):
    """Functions that are lowered together, those called before those that call them."""

    def __init__(self) -> None:
        super().__init__()
        self.functions: dict[tuple[str, str], Function | None] = {}
        """By module and name; None while one is being lowered."""

    def need(self, source: Source, node: ast.FunctionDef) -> Function:
        """A function, lowered after all that it calls."""
        key = source.name, node.name
        if key not in self.functions:
            self.functions[key] = None
            made = Function(self, source, node)
            del self.functions[key]  # those that it calls have come before it
            self.functions[key] = made
        found = self.functions[key]
        if found is None:
            raise LoweringError(f"{source.path}:{node.lineno}: the law {node.name} calls itself.", "Write a loop.")
        return found

    def law(self, function: Callable[..., Any]) -> Function:
        """A law by itself: a plain function of a module or a class, with its source in a file."""
        code = function.__code__
        source = self.source(function.__module__, Path(code.co_filename))
        for node in ast.walk(source.tree) if source else ():
            if isinstance(node, ast.FunctionDef) and node.name == function.__name__:
                if code.co_firstlineno in (node.lineno, *(d.lineno for d in node.decorator_list)):
                    assert source is not None
                    return self.need(source, node)
        raise LoweringError(
            f"{code.co_filename} does not hold the law {function.__name__}.", "Write it with def in a file."
        )

    def text(self) -> str:
        """The header with all functions that were needed."""
        spaces: dict[str, str] = {}
        out = ["// Written by sim_core.core.lowering.", "#pragma once", '#include "dual.hpp"', ""]
        for (module, _), function in self.functions.items():
            assert function is not None
            space = function.source.space
            if spaces.setdefault(space, module) != module:
                raise LoweringError(f"{module} and {spaces[space]} have the same last name.", "Rename one of them.")
            out += [f"namespace thinshell::laws::{space} {{", function.text, "}", ""]
        return "\n".join(out)


class Function(Expressions):
    """One function in C++. ``written``: numbers of the arguments that it writes to; ``branches``: whether what it does
    depends on its numbers otherwise than by ``max``, ``min``, ``abs`` and ``x if c else y``."""

    def __init__(self, library: Library, source: Source, node: ast.FunctionDef) -> None:
        super().__init__(library, source, node)
        self.library, self.name = library, cpp_name(node.name)
        self.kernel = "lang.kernel" in decorators(node)
        self.written: set[str] = set()
        self.branches = False
        self._indent = self._fresh = 0
        self._lines: list[str] = []
        stores = [n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
        self._loaded = {n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Load)}
        self._changed = {n for n in stores if stores.count(n) > 1} | (set(stores) & set(self.parameters))
        self._returns = sum(isinstance(n, ast.Return) for n in ast.walk(node))
        for part in ast.walk(node):
            if isinstance(part, ast.AugAssign) and isinstance(part.target, ast.Name):
                self._changed.add(part.target.id)
            elif isinstance(part, ast.Subscript) and isinstance(part.ctx, ast.Store):
                self._changed.add(self._base(part))
            elif isinstance(part, ast.Call) and (callee := self._callee(part)):
                for argument, parameter in zip(part.args, callee.parameters, strict=False):
                    if parameter in callee.written and isinstance(argument, ast.Name):
                        self._changed.add(argument.id)
        self.written = {p for p in self.parameters if p in self._changed and self._by_reference(p)}
        self.text = self._write()

    # ---- the frame

    def _by_reference(self, parameter: str) -> bool:
        annotation = self.node.args.args[self.parameters.index(parameter)].annotation
        return self.kernel or (annotation is not None and ast.unparse(annotation) == "lang.template()")

    def _write(self) -> str:
        if self.node.args.vararg or self.node.args.kwarg or self.node.args.kwonlyargs or self.node.args.defaults:
            self._fail(self.node, "has arguments that are not all positional and given", "Name each argument.")
        declared, copies = [], []
        for i, name in enumerate(self.parameters):
            if self._by_reference(name):
                declared.append(f"A{i} &&{cpp_name(name)}")
            elif name in self._changed:
                declared.append(f"const A{i} {name}_given")
                copies.append(f"  auto {cpp_name(name)} = lift<S>({name}_given);")
            else:
                declared.append(f"const A{i} {cpp_name(name)}")
        with self._block(2):
            self._body(self.node.body)
        body = "\n".join(copies + self._lines)
        types = ", ".join(f"A{i}" for i in range(len(self.parameters)))
        using = [f"  using S = Scalar<{types}>;"] if re.search(r"\b[SR][(,>]", body) else []
        using += ["  using R = Real<S>;"] if re.search(r"\bR[(,]", body) else []
        summary = (ast.get_docstring(self.node) or "").partition("\n")[0]
        head = [f"// {summary}"] if summary else []
        if self.parameters:
            head.append(f"template <{', '.join(f'class A{i}' for i in range(len(self.parameters)))}>")
        kind = "auto" if self._returns else "void"
        head.append(f"THINSHELL_FN {kind} {self.name}({', '.join(declared)}) {{")
        return "\n".join([*head, *using, body, "}"])

    def _emit(self, line: str) -> None:
        self._lines.append(" " * self._indent + line)

    @contextmanager
    def _block(self, indent: int = 0) -> Iterator[None]:
        before, self._indent = self._indent, indent or self._indent + 2
        self._scopes.append(set())
        yield
        self._scopes.pop()
        self._indent = before

    def _base(self, node: ast.expr) -> str:
        while isinstance(node, ast.Subscript):
            node = node.value
        return node.id if isinstance(node, ast.Name) else ""

    def _callee(self, node: ast.Call) -> Function | None:
        """The law that is called, or None."""
        if not isinstance(node.func, ast.Name) or node.func.id in self._locals:
            return None
        found = self.library.find(self.source, node.func.id)
        if not found or found[1] not in found[0].functions:
            return None
        callee = self.library.need(found[0], found[0].functions[found[1]])
        self.branches |= callee.branches
        return callee

    # ---- statements

    def _body(self, statements: Sequence[ast.stmt]) -> None:
        for statement in statements:
            handle = getattr(self, f"_do_{type(statement).__name__}", None)
            if handle is None:
                word = type(statement).__name__.lower()
                self._fail(statement, f"has a statement that laws do not have, '{word}'", "Use if, for, while, return.")
            handle(statement)

    def _do_Pass(self, node: ast.Pass) -> None:
        pass

    def _do_Break(self, node: ast.Break) -> None:
        self._emit("break;")

    def _do_Continue(self, node: ast.Continue) -> None:
        self._emit("continue;")

    def _do_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Call) and ast.unparse(node.value.func) != "lang.loop_config":
            self._emit(f"{self._of(node.value)};")

    def _do_Return(self, node: ast.Return) -> None:
        if node.value is None:
            self._emit("return;")
        elif isinstance(node.value, ast.Tuple):
            self._emit(f"return tuple_of({self._list(node.value.elts)});")
        else:
            value = self._of(node.value)
            self._emit(f"return {value};" if self._returns == 1 else f"return lift<S>({value});")

    def _do_Assign(self, node: ast.Assign) -> None:
        target = node.targets[0]
        if len(node.targets) > 1:
            self._fail(node, "assigns to several variables at once", "Write one assignment a line.")
        if not isinstance(target, ast.Tuple):
            self._set(target, self._of(node.value))
            return
        value = inside(node.value)
        self._fresh += 1
        name = f"t{self._fresh}_"
        if isinstance(value, ast.Tuple):
            for i, part in enumerate(value.elts):
                self._emit(f"const auto {name}{i} = {self._of(part)};")
            given = [f"{name}{i}" for i in range(len(value.elts))]
        else:
            self._emit(f"const auto {name} = {self._of(value)};")
            given = [f"{name}.a{i}" for i in range(len(target.elts))]
        for part, source in zip(target.elts, given, strict=True):
            if not (isinstance(part, ast.Name) and part.id not in self._loaded):
                self._set(part, source)

    def _set(self, target: ast.expr, value: str) -> None:
        if isinstance(target, ast.Name) and not self._known(target.id):
            self._scopes[-1].add(target.id)
            lifted = target.id in self._changed
            self._emit(
                f"auto {cpp_name(target.id)} = lift<S>({value});"
                if lifted
                else f"const auto {cpp_name(target.id)} = {value};"
            )
        elif isinstance(target, ast.Name | ast.Subscript):
            self._emit(f"{self._of(target)} = {value};")
        else:
            self._fail(target, "assigns to what is neither a variable nor an entry", "Assign to x or x[i].")

    def _do_AugAssign(self, node: ast.AugAssign) -> None:
        target = self._of(node.target)
        if type(node.op) in (ast.Add, ast.Sub, ast.Mult, ast.Div):
            self._emit(f"{target} {OPERATORS[type(node.op)][0]}= {self._of(node.value)};")
        else:
            self._emit(f"{target} = {self._of(ast.BinOp(node.target, node.op, node.value))};")

    def _do_If(self, node: ast.If) -> None:
        known = self._constant(node.test)
        if known is not None:
            self._body(node.body if known else node.orelse)
            return
        self.branches = True
        self._emit(f"if ({self._of(node.test)}) {{")
        with self._block():
            self._body(node.body)
        if node.orelse:
            self._emit("} else {")
            with self._block():
                self._body(node.orelse)
        self._emit("}")

    def _do_While(self, node: ast.While) -> None:
        if node.orelse:
            self._fail(node, "has a loop with else", "Write what follows after the loop.")
        self.branches = True
        self._emit(f"while ({self._of(node.test)}) {{")
        with self._block():
            self._body(node.body)
        self._emit("}")

    def _do_For(self, node: ast.For) -> None:
        over = inside(node.iter)
        static = over is not node.iter
        targets = node.target.elts if isinstance(node.target, ast.Tuple) else [node.target]
        names = [t.id for t in targets if isinstance(t, ast.Name)]
        ranges = _ranges(over, len(names))
        leaves = any(isinstance(n, ast.Break | ast.Continue) for n in ast.walk(node))
        if node.orelse or len(names) != len(targets) or (leaves and (ranges is None or len(names) > 1)):
            self._fail(
                node, "has a loop that laws do not have", "Write 'for i in range(n):', loop in loop, without else."
            )
        if ranges is None:
            values = self._constant(over) if static else None
            if values is None:
                self._fail(node, f"loops over {ast.unparse(over)}", "Loop over range(n), or lang.static of constants.")
            for value in values:
                before = dict(self._static)
                self._static.update(zip(names, value if len(names) > 1 else [value], strict=True))
                self._emit("{")
                with self._block():
                    self._body(node.body)
                self._emit("}")
                self._static = before
            return
        with self._block(self._indent):
            for name, bounds in zip(names, ranges, strict=True):
                first, end = ("0", bounds[0]) if len(bounds) == 1 else (self._of(bounds[0]), bounds[1])
                if len(bounds) > 2:
                    self._fail(node, "counts in steps", "Loop over range(first, end).")
                i, last = cpp_name(name), f"{name}_end"
                bounded = f"int {i} = {first}, {last} = {self._of(end)}; {i} < {last}; ++{i}"
                self._emit(f"{'THINSHELL_UNROLL ' if static else ''}for ({bounded}) {{")
                self._scopes[-1].add(name)
                self._indent += 2
            with self._block(self._indent):
                self._body(node.body)
            for _ in names:
                self._indent -= 2
                self._emit("}")


def _ranges(node: ast.expr, count: int) -> list[list[ast.expr]] | None:
    """Bounds of the loops that ``range`` or ``lang.ndrange`` stand for."""
    name = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
    if name == "range" and count == 1:
        return [node.args]  # type: ignore[attr-defined]
    if name == "lang.ndrange" and len(node.args) == count:  # type: ignore[attr-defined]
        return [[a] for a in node.args]  # type: ignore[attr-defined]
    return None


def header(modules: Iterable[str] | None = None) -> str:
    """C++ header of the laws of some modules, by default of all of ``sim_core``."""
    library = Library()
    if modules is None:
        files = sorted(
            p for p in PACKAGE.rglob("*.py") if "lang.func" in (text := p.read_text()) or "lang.kernel" in text
        )
        modules = [".".join(p.relative_to(PACKAGE.parent).with_suffix("").parts) for p in files]
    for module in modules:
        source = library.source(module)
        assert source is not None, module
        for name in source.laws:
            library.need(source, source.functions[name])
    return library.text()


if __name__ == "__main__":
    print(header(), end="")
