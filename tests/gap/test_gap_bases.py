import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simgap.errors import UserError
from simgap.gap.bases import Blocks, Expressions, Monomials
from simgap.gap.bounds.linear import Basis, make_form, supremum
from tests.gap.gap_examples import PAPER, U, X

NAMES = (("x1", "x2"), ("u",))
TERM_SETS = {
    "paper": PAPER,
    "sines": ("sin(x1)", "cos(3*x2)", "u*x1", "1"),
    "smooth friction": ("tanh(x2/0.1)", "atan(5*x1)", "exp(x1)*x2", "u"),
    "fractions": ("1/(2 + x1)", "sqrt(1 + x2^2)", "log(3 + x1*x2)", "1"),
}
unit = st.floats(0.0, 1.0)


@st.composite
def boxes(draw, widest):
    corners = []
    for lo, hi in zip(X.lo, X.hi, strict=True):
        width = (hi - lo) * widest * draw(unit)
        a = min(lo + (hi - lo - width) * draw(unit), hi - width)
        corners.append((max(a, lo), min(max(a, lo) + width, hi)))
    return np.array(corners).T


@pytest.mark.parametrize("terms", TERM_SETS.values(), ids=TERM_SETS)
@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_range_over_a_box_holds_every_value_in_it(terms, data):
    q = np.array(data.draw(st.lists(st.floats(-10, 10), min_size=len(terms), max_size=len(terms))))
    form = make_form(Basis(terms, *NAMES), X, U, q, data.draw(st.floats(-1, 1)))
    lo, hi = data.draw(boxes(data.draw(st.sampled_from([1.0, 1e-2, 1e-6, 0.0]))))
    u = U[data.draw(st.integers(0, len(U) - 1))]
    below, above = form.box_range(lo[None], hi[None], u[None])
    inner = lo + (hi - lo) * np.random.default_rng(3).random((200, 2))
    inner = np.clip(np.concatenate([inner, [lo, hi, [lo[0], hi[1]], [hi[0], lo[1]]]]), lo, hi)
    values = _exact(terms, q, form.offset, inner, u)
    assert below[0] <= values.min()
    assert values.max() <= above[0]


def _exact(terms, q, offset, x, u):
    """Values in extended precision, written out without the package's parser or code generation."""
    names = {"sin": np.sin, "cos": np.cos, "tanh": np.tanh, "atan": np.arctan, "exp": np.exp, "sqrt": np.sqrt}
    names |= {"log": np.log, "x1": x[:, 0].astype(np.longdouble), "x2": x[:, 1].astype(np.longdouble)}
    names["u"] = np.longdouble(u[0])
    columns = [np.asarray(eval(t.replace("^", "**"), {}, names)) for t in terms]
    return sum(np.longdouble(c) * p for c, p in zip(q, columns, strict=True)) + np.longdouble(offset)


def test_range_over_a_tiny_box_is_tight():
    form = make_form(Basis(PAPER, *NAMES), X, U, np.array([0.3, -0.2, 0.1, 1.0, -2.0, 0.5, 0.1]))
    lo, hi = np.array([[0.1, 0.2]]), np.array([[0.1002, 0.2010]])
    below, above = form.box_range(lo, hi, U[:1])
    corners = np.array([[0.1, 0.2], [0.1002, 0.2], [0.1, 0.2010], [0.1002, 0.2010]])
    values = form.values(corners, U[:1].repeat(4, axis=0))
    assert above[0] - below[0] <= 1.001 * (values.max() - values.min())


def test_values_and_gradients_against_finite_differences():
    basis = Basis(TERM_SETS["fractions"], *NAMES)
    rng = np.random.default_rng(0)
    x, u = X.sample(rng, 50), U[rng.integers(0, 5, 50)]
    slopes = basis.evaluate_gradient(x, u)
    for j in range(2):
        step = np.zeros(2)
        step[j] = 1e-6
        differences = (basis.evaluate(x + step, u) - basis.evaluate(x - step, u)) / 2e-6
        np.testing.assert_allclose(slopes[:, :, j], differences, atol=1e-8)


def test_gradient_bound_is_the_supremum_of_a_quadratic():
    """sup |2 a x1 + b x2 + c| over the box is known; the paper's printed L2 of .168 was below it."""
    q = np.array([-0.5657, -0.0139, -0.0482, 0.1809, 0.0022, 0.0, 0.0081])
    form = make_form(Basis(PAPER, *NAMES), X, U, q)
    along1 = max(abs(2 * q[0] * a + q[2] * b + q[3]) for a in (-0.2, 0.2) for b in (-0.5, 0.5))
    assert form.gradient_bound[0] == pytest.approx(along1, rel=1e-6)
    assert form.gradient_bound[0] >= along1


def test_supremum_of_a_quadratic_inside_the_box():
    q = np.array([-1.0, -2.0, 0.0, 0.1, 0.4, 0.3, 0.0])  # peak at x1 = .05, x2 = .1
    form = make_form(Basis(PAPER, *NAMES), X, U, q)
    true = 0.1 * 0.05 / 2 + 0.4 * 0.1 / 2 + 0.3 * 1.2
    reached, bound = supremum(form, U)
    assert reached <= true + 1e-12
    assert true <= bound <= true + 1e-6


@pytest.mark.parametrize(
    ("kind", "size"),
    [
        (Monomials(degree=2), 9),  # 6 of x alone, u, u x1, u x2
        (Monomials(degree=0), 1),
        (Expressions(terms=PAPER), 7),
        (Blocks(blocks=(4, 4)), 1),
    ],
)
def test_kinds(kind, size):
    basis = Basis(kind.listed(*NAMES, X), *NAMES)
    assert basis.size == size
    assert basis.evaluate(np.zeros((3, 2)), np.zeros((3, 1))).shape == (3, size)


@pytest.mark.parametrize(
    ("terms", "says"),
    [
        (("x1", "x3"), "x3"),
        (("x1*x2", "x2*x1"), "the same"),
        ((), "no terms"),
        (("__import__('os')",), "calls"),
    ],
)
def test_terms_that_cannot_be(terms, says):
    with pytest.raises(UserError, match=says):
        Basis(terms, *NAMES)


@pytest.mark.parametrize("term", ["abs(x2)", "sign(x2)", "1/x1", "log(x1)", "sqrt(x1)"])
def test_terms_that_are_not_smooth_or_finite_on_the_domain(term):
    with pytest.raises(UserError):
        make_form(Basis((term, "1"), *NAMES), X, U, np.zeros(2))
