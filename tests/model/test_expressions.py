"""Expressions of strangers: read as written, or refused in one line and at once."""

import time

import pytest
import sympy as sp

from simgap.errors import UserError
from simgap.model.expressions import DEEPEST, LONGEST, MOST_PARTS, parse
from simgap.model.symbolic import Parameter, SymbolicModel, Variable, symbol

X, Y = symbol("x"), symbol("y")


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("-9.81*sin(x)/2 + y^2", -9.81 * sp.sin(X) / 2 + Y**2),
        ("x - y - 1 + 2*x*y/4", X - Y - 1 + X * Y / 2),
        ("2**-3 * x", X / 8),
        ("max(-1, min(1, x))", sp.Max(-1, sp.Min(1, X))),
        ("sqrt(x^2 + 1)", sp.sqrt(X**2 + 1)),
        ("-pi/2", -sp.pi / 2),
        ("2^x", 2**X),
        (3.5, sp.Float(3.5)),
        (" + ".join(["x"] * 600), 600 * X),
        ("(" * 50 + "x" + ")" * 50, X),
    ],
)
def test_what_is_written_is_what_is_meant(text, wanted):
    assert parse(text, ["x", "y"]) == wanted


NUMBERS = ("1/0", "x/(y - y)", "log(0)", "sqrt(-1)*x", "sqrt(-1 - x^2)", "log(-2)", "(-8)^(1/3)",
           "tan(pi/2)", "max(1/0, x)", "max(sqrt(-1), x)", "exp(1000)", "exp(exp(exp(100)))", "0^-1", "x*1e300*1e300",
           "((9^100)^100)^100")  # fmt: skip
LIMITS = ("1e400", "9**9**9", "2**(10**9)", "x^101", "9" * 5001, "(" * 1500 + "x" + ")" * 1500, "-" * 3000 + "x",
          "sin(" * (DEEPEST + 5) + "x" + ")" * (DEEPEST + 5), " + ".join(["x"] * 3000), "x" * (LONGEST + 1),
          "+".join(["x"] * MOST_PARTS), "max(" + ",".join("xy" * 20) + ")")  # fmt: skip
OTHERS = ("", "sin()", "sin(x, y)", "min()", "sin(x=1)", "sin(*x)", "x.real", "x[0]", "[x]", "'x'", "1j", "True",
          "x < y", "x % y", "lambda: 1", "__import__('os')", "x y", "\x00", "x²", "١٢", "x if y else 1", "z",
          "f(x)", "(x", "x;y")  # fmt: skip


@pytest.mark.parametrize("text", [*NUMBERS, *LIMITS, *OTHERS])
def test_the_rest_is_one_short_line_at_once(text):
    began = time.process_time()
    with pytest.raises(UserError) as caught:
        parse(text, ["x", "y"])
    assert time.process_time() - began < 5.0
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    "text",
    [
        "abs(" + "+".join(f"sqrt(x*{k}+1)" for k in range(120)) + ")",
        "max(" + ",".join(f"x*{k}+y^{k}" for k in range(16)) + ")",
        "+".join(f"sqrt({k})" for k in range(2, 400)),
        "(1-" * 40 + "x" + ")^2" * 40,
    ],
)
def test_large_ones_within_the_limits_are_read_in_seconds(text):
    began = time.process_time()
    parse(text, ["x", "y"])
    assert time.process_time() - began < 10.0


def test_a_parameter_may_not_make_the_dynamics_infinite():
    model = SymbolicModel((Variable("x", "m"),), (), {"m": Parameter(0.0)}, (X / symbol("m"),))
    with pytest.raises(UserError, match="rate of 'x' is not a finite real number"):
        model.numeric()
