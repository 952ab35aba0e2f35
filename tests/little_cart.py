"""A cart in equations, the least case that every stage takes: what tests of engines and of faults begin from."""

import yaml

CASE = {
    "name": "cart",
    "plant": {
        "states": {"x": {"unit": "m"}, "v": {"unit": "m/s"}},
        "inputs": {"F": {"unit": "N"}},
        "symbolic": {"dynamics": {"x": "v", "v": "F"}},
    },
    "domain": {"tau": 0.01, "X": {"x": [-1, 1], "v": [-1, 1]}, "U": {"F": {"values": [-1, 0, 1]}}},
}


def write_cart(folder, **sections):
    """`cart.yaml` in a folder, with further sections; -> its path."""
    path = folder / "cart.yaml"
    path.write_text(yaml.safe_dump(CASE | sections, sort_keys=False))
    return path
