"""Conditions on the variables of a recorded system, such as ``hypot(x, y) < 0.5 at any step``.

A condition is an expression in the syntax of Python. It is parsed, checked against lists of names,
functions and operators, and evaluated on arrays. Nothing else of Python can be reached.

=================  ================================================================================
part               allowed
=================  ================================================================================
names              variables of the system, ``pi``
operators          ``+ - * / ** %``, ``< <= > >= == !=``, ``and``, ``or``, ``not``, parentheses
functions          abs, sqrt, exp, log, sin, cos, tan, arcsin, arccos, arctan, arctan2, hypot,
                   minimum, maximum, wrap (an angle to ±π)
when               ``at any step`` (the default), ``at every step``, ``at the end``
=================  ================================================================================
"""

import ast
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from study.common.arrays import Array, Booleans
from study.common.errors import BadInput, nearest, shown

OPERATORS: Mapping[type, Callable[..., Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.Mod: np.mod,
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
    ast.Eq: np.equal,
    ast.NotEq: np.not_equal,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
    ast.Not: np.logical_not,
    ast.And: np.logical_and,
    ast.Or: np.logical_or,
}


def wrap(angle: Array) -> Array:
    """An angle in rad, moved by whole turns to between -π and π."""
    return np.asarray(np.mod(angle + np.pi, 2 * np.pi) - np.pi)


FUNCTIONS: Mapping[str, tuple[Callable[..., Any], int]] = {
    **{name: (getattr(np, name), 1) for name in ("abs", "sqrt", "exp", "log", "sin", "cos", "tan")},
    **{name: (getattr(np, name), 1) for name in ("arcsin", "arccos", "arctan")},
    **{name: (getattr(np, name), 2) for name in ("arctan2", "hypot", "minimum", "maximum")},
    "wrap": (wrap, 1),
}
"""Function and number of arguments, by name."""
CONSTANTS = {"pi": np.pi}
WHEN = {
    "at any step": np.logical_or,
    "at every step": np.logical_and,
    "at the end": None,
}
"""How the steps of a trajectory are joined."""
LONGEST = 1000
"""Characters of an expression, at most."""


@dataclass(frozen=True)
class Expression:
    """A checked expression.

    Attributes:
        text: as it was written.
        node: its syntax tree.
        names: the variables that it uses.
    """

    text: str
    node: ast.expr
    names: tuple[str, ...]

    @classmethod
    def parse(cls, text: str, known: Iterable[str], subject: str) -> "Expression":
        """Parse and check a condition without ``at …``.

        Args:
            text: the expression.
            known: names of the variables.
            subject: begins the error.

        Raises:
            BadInput: the text is no expression, or uses what is not allowed.
        """
        if len(text) > LONGEST:
            raise BadInput(f"{subject}: the expression has more than {LONGEST} characters")
        try:
            node = ast.parse(text.strip(), mode="eval").body
            names = dict.fromkeys(_check(node, list(known), subject))
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise BadInput(
                f"{subject}: got {shown(text)}; write a condition such as x > 3"
            ) from None
        if not _is_condition(node):
            raise BadInput(f"{subject}: got {shown(text)}; it has no comparison, such as x > 3")
        return cls(text, node, tuple(names))

    def evaluate(self, values: Mapping[str, Array]) -> Booleans:
        """Whether the condition holds, for variables [...] by name.

        A condition on a value that is not finite does not hold.
        """
        with np.errstate(all="ignore"):
            holds = np.asarray(_evaluate(self.node, values), bool)
        finite = np.ones(holds.shape, bool)
        for name in self.names:
            finite = finite & np.isfinite(values[name])
        return np.asarray(holds & finite)


@dataclass(frozen=True)
class Condition:
    """A condition on a trajectory.

    Attributes:
        expression: on a state.
        when: a key of `WHEN`.
    """

    expression: Expression
    when: str

    @classmethod
    def parse(cls, text: str, known: Iterable[str], subject: str) -> "Condition":
        """Parse and check ``EXPRESSION at any step``; see `Expression.parse`."""
        match = re.fullmatch(r"(.*?)\s+(at\s+.*)", text.strip(), re.DOTALL)
        expression, when = (
            (match[1], " ".join(match[2].split())) if match else (text, "at any step")
        )
        if when not in WHEN:
            raise BadInput(f"{subject}: got {shown(when)}; {nearest(when, WHEN)}")
        return cls(Expression.parse(expression, known, subject), when)

    def so_far(self, values: Mapping[str, Array]) -> Booleans:
        """Whether the condition holds for the part of a trajectory up to each step.

        Args:
            values: by name, [..., T] over the steps.

        Returns:
            [..., T]; the last step is the outcome of the whole trajectory.
        """
        holds = self.expression.evaluate(values)
        join = WHEN[self.when]
        return holds if join is None else np.asarray(join.accumulate(holds, axis=-1))


def _check(node: ast.AST, known: list[str], subject: str) -> list[str]:
    """The names of variables in a tree in which everything is allowed.

    Raises:
        BadInput: something is not.
    """
    children: list[ast.AST]
    match node:
        case ast.Name(id=name) if name in known:
            return [name]
        case ast.Name(id=name) if name in CONSTANTS:
            return []
        case ast.Name(id=name):
            raise BadInput(f"{subject}: no variable '{name}'; {nearest(name, known)}")
        case ast.Constant(value=bool() | int() | float()):
            return []
        case ast.BinOp(left=left, op=operator, right=right) if type(operator) in OPERATORS:
            children = [left, right]
        case ast.UnaryOp(op=operator, operand=operand) if type(operator) in OPERATORS:
            children = [operand]
        case ast.BoolOp(values=values):
            children = list(values)
        case ast.Compare(left=left, ops=ops, comparators=others) if all(
            type(operator) in OPERATORS for operator in ops
        ):
            children = [left, *others]
        case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
            if name not in FUNCTIONS:
                raise BadInput(f"{subject}: no function '{name}'; {nearest(name, FUNCTIONS)}")
            if len(arguments) != FUNCTIONS[name][1]:
                raise BadInput(
                    f"{subject}: {name} has {len(arguments)} arguments; it takes "
                    f"{FUNCTIONS[name][1]}"
                )
            children = list(arguments)
        case _:
            part = ast.unparse(node)
            raise BadInput(
                f"{subject}: {shown(part)} is not allowed; use variables, numbers, "
                f"operators and the functions {', '.join(FUNCTIONS)}"
            )
    return [name for child in children for name in _check(child, known, subject)]


def _is_condition(node: ast.expr) -> bool:
    """Whether the value of a tree is true or false."""
    match node:
        case ast.Compare():
            return True
        case ast.BoolOp(values=values):
            return all(map(_is_condition, values))
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return _is_condition(operand)
    return False


def _evaluate(node: ast.expr, values: Mapping[str, Array]) -> Any:
    match node:
        case ast.Name(id=name):
            return values[name] if name in values else CONSTANTS[name]
        case ast.Constant(value=value):
            return float(value)  # type: ignore[arg-type]
        case ast.BinOp(left=left, op=operator, right=right):
            return OPERATORS[type(operator)](_evaluate(left, values), _evaluate(right, values))
        case ast.UnaryOp(op=operator, operand=operand):
            return OPERATORS[type(operator)](_evaluate(operand, values))
        case ast.BoolOp(op=operator, values=parts):
            joined = _evaluate(parts[0], values)
            for part in parts[1:]:
                joined = OPERATORS[type(operator)](joined, _evaluate(part, values))
            return joined
        case ast.Compare(left=left, ops=ops, comparators=others):
            terms = [_evaluate(term, values) for term in (left, *others)]
            holds: Any = True
            for comparison, first, second in zip(ops, terms, terms[1:], strict=False):
                holds = np.logical_and(holds, OPERATORS[type(comparison)](first, second))
            return holds
        case ast.Call(func=ast.Name(id=name), args=arguments):
            return FUNCTIONS[name][0](*(_evaluate(argument, values) for argument in arguments))
    raise AssertionError(f"{ast.dump(node)} was not checked")
