"""Lower the laws, Taichi functions in restricted Python, to a C++ header.

A law is written once. Taichi executes it as the reference; this module translates the same source text, without
importing Taichi or anything else, to templates in ``namespace thinshell::laws::<module>`` that are instantiated with
``double``, ``float`` and dual numbers (``include/small.hpp``, ``include/dual.hpp``). Translation is syntax by syntax:

| Python | C++ |
| --- | --- |
| a function of x, y | ``template <class A0, class A1> auto f(const A0 x, const A1 y)``; ``ti.template()``: ``A0 &&x`` |
| a variable assigned once | ``const auto`` |
| a variable that changes | ``auto``, real numbers in S, the common scalar of all arguments |
| ``c[i]``, ``c[t, i, j]`` | ``c[i]``, ``c(t, i, j)`` |
| ``ti.static(range(3))``; over a tuple of numbers | a loop to unroll; one block for each |
| ``return a, b`` | ``tuple_of(a, b)`` |

Variables live in the block in which they are assigned first, as in Taichi. Constants of modules become numbers. What
cannot be translated raises :class:`LoweringError` with function, line and remedy.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from sim_core.core.law_sources import PACKAGE, Source, Sources, decorators
from sim_core.errors import ThinshellError

__all__ = ["Library", "LoweringError", "header"]

SCALAR = set("sqrt exp log sin cos tan tanh asin acos atan atan2 pow abs min max select floor ceil".split())
METHODS = set(
    "norm norm_sqr normalized dot cross outer_product transpose trace determinant inverse sum max min".split()
)
RESERVED = SCALAR | set(
    "S R lift matrix_of tuple_of columns identity matmul divide floor_divide floor_modulo power to_int to_real laws "
    "thinshell alignas auto bool case catch char class const constexpr default delete do double enum explicit export "
    "extern float friend goto inline int long mutable namespace new operator private protected public register short "
    "signed sizeof static struct switch template this throw typedef typename union unsigned using virtual void "
    "volatile".split()
)
OPERATORS: dict[type, tuple[str, int]] = {
    ast.Or: ("||", 1), ast.And: ("&&", 2), ast.Eq: ("==", 4), ast.NotEq: ("!=", 4), ast.Lt: ("<", 4),
    ast.LtE: ("<=", 4), ast.Gt: (">", 4), ast.GtE: (">=", 4), ast.Add: ("+", 5), ast.Sub: ("-", 5),
    ast.Mult: ("*", 6), ast.Div: ("/", 6),
}  # fmt: skip
"""C++ operators and how strongly they bind; unary ones bind with 7."""
CALLED = {
    ast.Div: "divide", ast.FloorDiv: "floor_divide", ast.Mod: "floor_modulo", ast.MatMult: "matmul", ast.Pow: "pow",
}  # fmt: skip
"""Operators that are functions in C++."""


class LoweringError(ThinshellError):
    """A law in words that C++ has no counterpart for."""


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


class Function:
    """One function in C++. ``written``: numbers of the arguments that it writes to."""

    def __init__(self, library: Library, source: Source, node: ast.FunctionDef) -> None:
        self.library, self.source, self.node, self.name = library, source, node, _cpp(node.name)
        self.written: set[str] = set()
        self._indent = 0
        self.kernel = "ti.kernel" in decorators(node)
        self.parameters = [a.arg for a in node.args.args]
        self._static: dict[str, Any] = {}
        self._scopes: list[set[str]] = [set(self.parameters)]
        self._lines: list[str] = []
        self._fresh = 0
        stores = [n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
        self._locals = {*self.parameters, *stores}
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
        return self.kernel or (annotation is not None and ast.unparse(annotation) == "ti.template()")

    def _write(self) -> str:
        if self.node.args.vararg or self.node.args.kwarg or self.node.args.kwonlyargs or self.node.args.defaults:
            self._fail(self.node, "has arguments that are not all positional and given", "Name each argument.")
        declared, copies = [], []
        for i, name in enumerate(self.parameters):
            if self._by_reference(name):
                declared.append(f"A{i} &&{_cpp(name)}")
            elif name in self._changed:
                declared.append(f"const A{i} {name}_given")
                copies.append(f"  auto {_cpp(name)} = lift<S>({name}_given);")
            else:
                declared.append(f"const A{i} {_cpp(name)}")
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

    def _fail(self, node: ast.AST, what: str, remedy: str) -> NoReturn:
        line = getattr(node, "lineno", self.node.lineno)
        raise LoweringError(f"{self.source.path}:{line}: the law {self.node.name} {what}.", remedy)

    def _emit(self, line: str) -> None:
        self._lines.append(" " * self._indent + line)

    @contextmanager
    def _block(self, indent: int = 0) -> Iterator[None]:
        before, self._indent = self._indent, indent or self._indent + 2
        self._scopes.append(set())
        yield
        self._scopes.pop()
        self._indent = before

    def _known(self, name: str) -> bool:
        return any(name in scope for scope in self._scopes)

    def _base(self, node: ast.expr) -> str:
        while isinstance(node, ast.Subscript):
            node = node.value
        return node.id if isinstance(node, ast.Name) else ""

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
        if isinstance(node.value, ast.Call) and ast.unparse(node.value.func) != "ti.loop_config":
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
        value = _inside(node.value)
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
                f"auto {_cpp(target.id)} = lift<S>({value});" if lifted else f"const auto {_cpp(target.id)} = {value};"
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
        self._emit(f"while ({self._of(node.test)}) {{")
        with self._block():
            self._body(node.body)
        self._emit("}")

    def _do_For(self, node: ast.For) -> None:
        over = _inside(node.iter)
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
                self._fail(node, f"loops over {ast.unparse(over)}", "Loop over range(n), or ti.static of constants.")
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
                i, last = _cpp(name), f"{name}_end"
                bounded = f"int {i} = {first}, {last} = {self._of(end)}; {i} < {last}; ++{i}"
                self._emit(f"{'THINSHELL_UNROLL ' if static else ''}for ({bounded}) {{")
                self._scopes[-1].add(name)
                self._indent += 2
            with self._block(self._indent):
                self._body(node.body)
            for _ in names:
                self._indent -= 2
                self._emit("}")

    # ---- expressions

    def _constant(self, node: ast.expr) -> Any:
        """Value of an expression of constants, or None."""
        inner = _inside(node)
        if any(isinstance(n, ast.Name) and n.id in self._locals and n.id not in self._static for n in ast.walk(inner)):
            return None
        try:
            return self.library.evaluate(self.source, inner, self._static)
        except ValueError:
            return None

    def _list(self, nodes: Iterable[ast.expr]) -> str:
        return ", ".join(self._of(n) for n in nodes)

    def _of(self, node: ast.expr, binding: int = 0) -> str:
        """An expression; in parentheses if it binds less than ``binding``."""
        if isinstance(node, ast.Name | ast.Attribute | ast.Subscript) and isinstance(node.ctx, ast.Load):
            value = self._constant(node)
            if isinstance(value, bool | int | float) and math.isfinite(value):
                return _number(value)
        handle = getattr(self, f"_of_{type(node).__name__}", None)
        if handle is None:
            self._fail(
                node, f"has the expression '{ast.unparse(node)}'", "Write it with numbers, vectors and matrices."
            )
        text, bound = handle(node)
        return text if bound >= binding else f"({text})"

    def _of_Constant(self, node: ast.Constant) -> tuple[str, int]:
        if not isinstance(node.value, bool | int | float) or not math.isfinite(node.value):
            self._fail(node, f"has the constant {node.value!r}", "Laws have numbers only.")
        return _number(node.value), 9

    def _of_Name(self, node: ast.Name) -> tuple[str, int]:
        if not self._known(node.id):
            if node.id in self._locals:
                self._fail(node, f"uses '{node.id}' outside of the block that assigns it first", "Assign it before.")
            self._fail(
                node, f"uses '{node.id}', which its module does not define as a number", "Pass it as an argument."
            )
        return _cpp(node.id), 9

    def _of_Attribute(self, node: ast.Attribute) -> tuple[str, int]:
        if node.attr != "shape":
            self._fail(node, f"uses '{ast.unparse(node)}'", "Laws know x.shape[k], x[i] and the methods of vectors.")
        return f"{self._of(node.value, 9)}.shape", 9

    def _of_Subscript(self, node: ast.Subscript) -> tuple[str, int]:
        at = node.slice
        if any(isinstance(n, ast.Slice) for n in ast.walk(at)):
            self._fail(node, f"takes the slice '{ast.unparse(node)}'", "Write a loop over its entries.")
        value = self._of(node.value, 9)
        return (f"{value}({self._list(at.elts)})" if isinstance(at, ast.Tuple) else f"{value}[{self._of(at)}]"), 9

    def _of_UnaryOp(self, node: ast.UnaryOp) -> tuple[str, int]:
        sign = "!" if isinstance(node.op, ast.Not) else "-" if isinstance(node.op, ast.USub) else "+"
        return f"{sign}{self._of(node.operand, 8)}", 7

    def _of_BinOp(self, node: ast.BinOp) -> tuple[str, int]:
        kind = type(node.op)
        if kind is ast.Pow and isinstance(power := self._constant(node.right), int):
            return f"power<{power}>({self._of(node.left)})", 9
        real = any(isinstance(n, ast.Constant) and isinstance(n.value, float) for n in (node.left, node.right))
        if kind in CALLED and not (kind is ast.Div and real):
            return f"{CALLED[kind]}({self._of(node.left)}, {self._of(node.right)})", 9
        if kind not in OPERATORS:
            self._fail(node, f"has the operator of '{ast.unparse(node)}'", "Use + - * / // % ** @.")
        sign, bound = OPERATORS[kind]
        return f"{self._of(node.left, bound)} {sign} {self._of(node.right, bound + 1)}", bound

    def _of_BoolOp(self, node: ast.BoolOp) -> tuple[str, int]:
        sign, bound = OPERATORS[type(node.op)]
        return f" {sign} ".join(self._of(v, bound + 1) for v in node.values), bound

    def _of_Compare(self, node: ast.Compare) -> tuple[str, int]:
        values, parts = [node.left, *node.comparators], []
        for a, op, b in zip(values, node.ops, values[1:], strict=False):
            if type(op) not in OPERATORS:
                self._fail(node, f"compares by '{ast.unparse(node)}'", "Use == != < <= > >=.")
            parts.append(f"{self._of(a, 5)} {OPERATORS[type(op)][0]} {self._of(b, 5)}")
        return " && ".join(parts), 4 if len(parts) == 1 else 2

    def _of_IfExp(self, node: ast.IfExp) -> tuple[str, int]:
        return f"select({self._list([node.test, node.body, node.orelse])})", 9

    # ---- calls

    def _callee(self, node: ast.Call) -> Function | None:
        """The law that is called, or None."""
        if not isinstance(node.func, ast.Name) or node.func.id in self._locals:
            return None
        found = self.library.find(self.source, node.func.id)
        return (
            self.library.need(found[0], found[0].functions[found[1]])
            if found and found[1] in found[0].functions
            else None
        )

    def _shape(self, node: ast.Call) -> tuple[str, int, int] | None:
        """Least type of the entries, rows and columns of a matrix type that is called."""
        found = self.library.expression(self.source, node.func.id) if isinstance(node.func, ast.Name) else None
        made = found[1] if found else None
        if not isinstance(made, ast.Call) or ast.unparse(made.func) not in ("ti.types.vector", "ti.types.matrix"):
            return None
        sizes = [int(ast.literal_eval(a)) for a in made.args[:-1]]
        return "R" if "f" in ast.unparse(made.args[-1]) else "int", sizes[0], sizes[1] if len(sizes) > 1 else 1

    def _of_Call(self, node: ast.Call) -> tuple[str, int]:
        name = ast.unparse(node.func)
        if node.keywords:
            self._fail(node, f"names arguments of {name}", "Give arguments by position.")
        if callee := self._callee(node):
            if len(node.args) != len(callee.parameters):
                self._fail(
                    node, f"calls {name} with {len(node.args)} of {len(callee.parameters)} arguments", "Give all."
                )
            return f"laws::{callee.source.space}::{callee.name}({self._list(node.args)})", 9
        if shape := self._shape(node):
            return self._matrix(node.args, *shape)
        short = re.sub(r"^(ti|math)\.", "", name)
        if short in SCALAR and (short != name or short in ("abs", "min", "max", "pow")):
            return f"{short}({self._list(node.args)})", 9
        if short == "static":
            return self._of(_inside(node)), 0
        if short in ("cast", "i32", "f64", "int", "float"):
            real = ast.unparse(node.args[1])[3:] == "f64" if short == "cast" else short in ("f64", "float")
            return f"{'to_real<S>' if real else 'to_int'}({self._of(node.args[0])})", 9
        if short in ("Vector", "Matrix") and isinstance(node.args[0], ast.List):
            rows = node.args[0].elts
            flat = [e for r in rows for e in r.elts] if isinstance(rows[0], ast.List) else rows  # type: ignore[attr-defined]
            return self._matrix(flat, "int", len(rows), len(flat) // len(rows))
        if short in ("Matrix.zero", "Vector.zero", "Matrix.identity"):
            kind = "S" if ast.unparse(node.args[0]) == "ti.f64" else "int"
            sizes = ", ".join(str(self._constant(a)) for a in node.args[1:])
            return (f"identity<{kind}, {sizes}>()" if short == "Matrix.identity" else f"Mat<{kind}, {sizes}>{{}}"), 9
        if short == "Matrix.cols" and isinstance(node.args[0], ast.List):
            return f"columns({self._list(node.args[0].elts)})", 9
        if isinstance(node.func, ast.Attribute) and node.func.attr in METHODS and not name.startswith("ti."):
            return f"{self._of(node.func.value, 9)}.{node.func.attr}({self._list(node.args)})", 9
        known = ", ".join(sorted(SCALAR))
        self._fail(node, f"calls {name}", f"Laws call each other, methods of vectors, and {known}.")

    def _matrix(self, entries: Sequence[ast.expr], kind: str, rows: int, columns: int) -> tuple[str, int]:
        flat = [e for r in entries for e in (r.elts if isinstance(r, ast.List) else [r])]
        return f"matrix_of<{kind}, {rows}, {columns}>({self._list(flat)})", 9


def _cpp(name: str) -> str:
    return f"{name}_" if name in RESERVED else name


def _number(value: bool | int | float) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"R({value!r})" if isinstance(value, float) else str(value) if value >= 0 else f"({value})"


def _inside(node: ast.expr) -> ast.expr:
    """What stands in ``ti.static``, or the expression itself."""
    if not (isinstance(node, ast.Call) and ast.unparse(node.func) == "ti.static"):
        return node
    return node.args[0] if len(node.args) == 1 else ast.Tuple(node.args, ast.Load())


def _ranges(node: ast.expr, count: int) -> list[list[ast.expr]] | None:
    """Bounds of the loops that ``range`` or ``ti.ndrange`` stand for."""
    name = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
    if name == "range" and count == 1:
        return [node.args]  # type: ignore[attr-defined]
    if name == "ti.ndrange" and len(node.args) == count:  # type: ignore[attr-defined]
        return [[a] for a in node.args]  # type: ignore[attr-defined]
    return None


def header(modules: Iterable[str] | None = None) -> str:
    """C++ header of the laws of some modules, by default of all of ``sim_core``."""
    library = Library()
    if modules is None:
        files = sorted(p for p in PACKAGE.rglob("*.py") if "ti.func" in (text := p.read_text()) or "ti.kernel" in text)
        modules = [".".join(p.relative_to(PACKAGE.parent).with_suffix("").parts) for p in files]
    for module in modules:
        source = library.source(module)
        assert source is not None, module
        for name in source.laws:
            library.need(source, source.functions[name])
    return library.text()


if __name__ == "__main__":
    print(header(), end="")
