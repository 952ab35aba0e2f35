"""Random formulas of the fragment, drawn as trees and written as text."""

NAMES = ("a", "b", "c")


def text(tree):
    kind, *parts = tree
    if kind in NAMES or kind in ("true", "false"):
        return kind
    if kind in ("!", "X", "F", "G"):
        return f"{kind} ({text(parts[0])})"
    if kind in ("F<", "G<"):
        return f"{kind[0]}[<= {parts[0]}] ({text(parts[1])})"
    return f"({text(parts[0])}) {kind} ({text(parts[1])})"


def draw(rng, depth, operators):
    if depth == 0 or rng.random() < 0.15:
        name = NAMES[rng.integers(3)]
        return ("!", (name,)) if rng.random() < 0.4 else (name,)
    kind = operators[rng.integers(len(operators))]
    if kind in ("F<", "G<"):
        return (kind, int(rng.integers(0, 4)), draw(rng, depth - 1, operators))
    if kind in ("X", "F", "G"):
        return (kind, draw(rng, depth - 1, operators))
    return (kind, draw(rng, depth - 1, operators), draw(rng, depth - 1, operators))


STATE = ("&", "|", "->")
COSAFE = ("&", "|", "X", "F", "U", "F<", "G<")
SAFE = ("&", "|", "X", "G", "W", "R", "F<", "G<")


def conjunction(rng):
    """A formula of the fragment."""
    parts = []
    for _ in range(rng.integers(1, 4)):
        kind = rng.integers(4)
        if kind == 0:
            parts.append(draw(rng, 2, COSAFE))
        elif kind == 1:
            parts.append(draw(rng, 2, SAFE))
        elif kind == 2:
            parts.append(("G", draw(rng, 2, COSAFE)))
        else:
            parts.append(("G", ("F", draw(rng, 1, STATE))))
    whole = parts[0]
    for part in parts[1:]:
        whole = ("&", whole, part)
    return whole


def persistent(rng):
    whole = ("F", ("G", draw(rng, 2, STATE)))
    if rng.random() < 0.5:
        whole = ("&", ("G", draw(rng, 1, ("|",))), whole)
    return ("&", whole, ("F", ("G", draw(rng, 1, STATE)))) if rng.random() < 0.3 else whole
