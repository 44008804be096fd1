"""Expressions of laws in C++ (:mod:`sim_core.core.lowering`)."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn, Protocol

from sim_core.core.law_sources import Source, Sources
from sim_core.errors import ThinshellError

__all__ = ["OPERATORS", "Expressions", "LoweringError", "cpp_name", "inside"]

SCALAR = set("sqrt exp expm1 log sin cos tan tanh asin acos atan atan2 pow abs min max select floor ceil".split())
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


class Callee(Protocol):
    """A law that is called: its name in C++, its module and its arguments."""

    name: str
    source: Source
    parameters: list[str]
    written: set[str]


class Expressions:
    """Expressions of one function. ``locals``: its variables and arguments."""

    def __init__(self, sources: Sources, source: Source, node: ast.FunctionDef) -> None:
        self.sources, self.source, self.node = sources, source, node
        self.parameters = [a.arg for a in node.args.args]
        self._locals = {n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        self._locals.update(self.parameters)
        self._scopes: list[set[str]] = [set(self.parameters)]
        self._static: dict[str, Any] = {}

    def _callee(self, node: ast.Call) -> Callee | None:
        """The law that is called, or None."""
        raise NotImplementedError

    def _fail(self, node: ast.AST, what: str, remedy: str) -> NoReturn:
        line = getattr(node, "lineno", self.node.lineno)
        raise LoweringError(f"{self.source.path}:{line}: the law {self.node.name} {what}.", remedy)

    def _known(self, name: str) -> bool:
        return any(name in scope for scope in self._scopes)

    def _constant(self, node: ast.expr) -> Any:
        """Value of an expression of constants, or None."""
        inner = inside(node)
        if any(isinstance(n, ast.Name) and n.id in self._locals and n.id not in self._static for n in ast.walk(inner)):
            return None
        try:
            return self.sources.evaluate(self.source, inner, self._static)
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
        return cpp_name(node.id), 9

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

    def _shape(self, node: ast.Call) -> tuple[str, int, int] | None:
        """Least type of the entries, rows and columns of a matrix type that is called."""
        found = self.sources.expression(self.source, node.func.id) if isinstance(node.func, ast.Name) else None
        made = found[1] if found else None
        if not isinstance(made, ast.Call) or not re.fullmatch(
            r"(lang\.)?types\.(vector|matrix)", ast.unparse(made.func)
        ):
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
        short = re.sub(r"^(lang|math)\.", "", name)
        if short in SCALAR and (short != name or short in ("abs", "min", "max", "pow")):
            return f"{short}({self._list(node.args)})", 9
        if short == "static":
            return self._of(inside(node)), 0
        if short in ("cast", "i32", "f64", "int", "float"):
            real = ast.unparse(node.args[1]) == "lang.f64" if short == "cast" else short in ("f64", "float")
            return f"{'to_real<S>' if real else 'to_int'}({self._of(node.args[0])})", 9
        if short in ("Vector", "Matrix") and isinstance(node.args[0], ast.List):
            rows = node.args[0].elts
            flat = [e for r in rows for e in r.elts] if isinstance(rows[0], ast.List) else rows  # type: ignore[attr-defined]
            return self._matrix(flat, "int", len(rows), len(flat) // len(rows))
        if short in ("Matrix.zero", "Vector.zero", "Matrix.identity"):
            kind = "S" if ast.unparse(node.args[0]) == "lang.f64" else "int"
            sizes = ", ".join(str(self._constant(a)) for a in node.args[1:])
            return (f"identity<{kind}, {sizes}>()" if short == "Matrix.identity" else f"Mat<{kind}, {sizes}>{{}}"), 9
        if short == "Matrix.cols" and isinstance(node.args[0], ast.List):
            return f"columns({self._list(node.args[0].elts)})", 9
        if isinstance(node.func, ast.Attribute) and node.func.attr in METHODS and not name.startswith("lang."):
            return f"{self._of(node.func.value, 9)}.{node.func.attr}({self._list(node.args)})", 9
        known = ", ".join(sorted(SCALAR))
        self._fail(node, f"calls {name}", f"Laws call each other, methods of vectors, and {known}.")

    def _matrix(self, entries: Sequence[ast.expr], kind: str, rows: int, columns: int) -> tuple[str, int]:
        flat = [e for r in entries for e in (r.elts if isinstance(r, ast.List) else [r])]
        return f"matrix_of<{kind}, {rows}, {columns}>({self._list(flat)})", 9


def cpp_name(name: str) -> str:
    return f"{name}_" if name in RESERVED else name


def _number(value: bool | int | float) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"R({value!r})" if isinstance(value, float) else str(value) if value >= 0 else f"({value})"


def inside(node: ast.expr) -> ast.expr:
    """What stands in ``lang.static``, or the expression itself."""
    if not (isinstance(node, ast.Call) and ast.unparse(node.func) == "lang.static"):
        return node
    return node.args[0] if len(node.args) == 1 else ast.Tuple(node.args, ast.Load())
