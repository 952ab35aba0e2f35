"""What delayed and lagged commands do to the plant, against sums over a fine clock; twins that remember."""

import numpy as np
import pytest

from simgap.config.load import load_case
from simgap.config.plant import AddedEffect
from simgap.errors import UserError
from simgap.simulators.commands import CommandMemory, CommandPath
from simgap.simulators.rollouts import make_simulator

TAU, FINE = 0.02, 2000
VALUES = [-1.0, 0.0, 1.0]


def effects(delay, lag, more=()):
    found = [AddedEffect(name="input_delay", on="u", parameters={"delay": delay})] if delay else []
    found += [AddedEffect(name="input_lag", on="u", parameters={"T": lag})] if lag else []
    return [*found, *more]


def by_the_clock(delay, lag, commands, gain=1.0, bias=0.0):
    """Mean over quarters of tau of what the plant feels, from steps of tau / 2000; the first command held before."""
    h = TAU / FINE
    felt, z = [], gain * commands[0] + bias
    for n in range(len(commands) * FINE):
        k = int(np.floor((n + 0.5) * h / TAU - delay / TAU))
        drive = gain * commands[max(k, 0)] + bias
        new = drive + (z - drive) * np.exp(-h / lag) if lag else drive
        felt.append(0.5 * (z + new) if lag else drive)
        z = new
    return np.mean(np.reshape(felt, (len(commands), 4, FINE // 4)), axis=2), z


@pytest.mark.parametrize("delay", [0.0, 0.3 * TAU, TAU, 1.7 * TAU, 2.0 * TAU])
@pytest.mark.parametrize("lag", [0.0, 0.4 * TAU, 3.0 * TAU])
def test_commands_on_their_way(delay, lag):
    commands = np.random.default_rng(4).choice(VALUES, 9)
    gain = AddedEffect(name="input_gain", on="u", parameters={"ratio": 1.2})
    bias = AddedEffect(name="input_bias", on="u", parameters={"bias": 0.1})
    memory = CommandMemory(CommandPath.of(effects(delay, lag, (bias, gain)), "u", VALUES, 0.0), TAU)
    memory.rest(float(commands[0]))
    got = np.array([memory.step(float(c), 4) for c in commands])
    want, z = by_the_clock(delay, lag, commands, 1.2, 0.1)
    assert np.abs(got - want).max() < 2e-3  # a command may fall between two ticks of the clock
    if lag:
        assert memory.output == pytest.approx(z, abs=2e-3)


def test_memory_that_the_controller_knows_is_not_acted_out_twice():
    path = CommandPath.of(effects(1.25 * TAU, 0.0), "u", VALUES, TAU)
    assert path.delay == pytest.approx(0.25 * TAU)
    assert CommandPath.of(effects(0.75 * TAU, 0.0), "u", VALUES, TAU).delay == 0.0


def twin(vary, found, **more):
    changes = {
        "domain.tau": TAU, "domain.U": {"u": {"values": [-1.2, 0.0, 1.2]}},
        "simulator": {"engine": "mujoco", "substeps": 4, "damping": {"joint": 0.0},
                      "effects": [e.model_dump() for e in found]}, **more,
    }  # fmt: skip
    return vary("pendulum", changes)


def rod(x, felt):
    """Semi-implicit Euler of the rod with the mean input of each step."""
    q, v = x
    for u in felt:
        v += TAU / 4 * 3.0 * (-0.5 * 9.81 * np.sin(q) + u)
        q += TAU / 4 * v
    return np.array([q, v])


def test_a_twin_feels_late_commands_and_its_range_holds_them(vary):
    path = twin(vary, effects(0.6 * TAU, 0.0))
    simulator = make_simulator(load_case(path), path.parent)
    x, u = np.array([[0.05, 0.1]]), np.array([[0.0]])
    lo, hi = simulator.spread(x, u)
    late = [1.2, 1.2, 0.4 * 1.2, 0.0]  # 0.6 tau are two quarters and four tenths of the third
    assert np.allclose(hi[0], rod(x[0], late), atol=1e-12)
    assert np.allclose(lo[0], rod(x[0], [-f for f in late]), atol=1e-12)
    rng = np.random.default_rng(0)
    state = x[0] + rng.normal(size=2) * 1e-3
    simulator.reset(state)
    sent = rng.choice([-1.2, 0.0, 1.2], 30)
    for k, command in enumerate(sent):
        least, largest = simulator.spread(state[None], np.array([[command]])) if k else (None, None)
        if k:
            simulator._memory[0].past = [float(sent[k - 1])]
            simulator._place(state)
        after = simulator.advance(np.array([command]))
        if k:
            before = sent[k - 1]
            assert np.allclose(after, rod(state, [before, before, 0.4 * before + 0.6 * command, command]), atol=1e-12)
            assert (after >= least[0] - 1e-12).all()
            assert (after <= largest[0] + 1e-12).all()
        state = after
    simulator.close()


def test_rollouts_with_memory_do_not_depend_on_their_order(vary):
    path = twin(vary, effects(0.6 * TAU, 0.01))
    simulator = make_simulator(load_case(path), path.parent)
    rng = np.random.default_rng(2)
    x, u = rng.uniform(-0.1, 0.1, (20, 2)), rng.choice([-1.2, 0.0, 1.2], (20, 1))
    once, order = simulator.rollouts(x, u), rng.permutation(20)
    assert np.array_equal(once[order], simulator.rollouts(x[order], u[order]))
    lo, hi = simulator.spread(x, u)
    assert (once >= lo - 1e-12).all()
    assert (once <= hi + 1e-12).all()
    simulator.close()


def test_a_lagged_state_without_a_lagging_simulator_is_refused(vary):
    slow = [e.model_dump() for e in effects(0.0, 0.02)]
    state = {"plant.states.u_lagged": {"unit": "N*m", "lag_of": "u"}, "domain.X.u_lagged": [-1.2, 1.2]}
    path = twin(vary, [], **{"plant.effects": slow, **state})
    with pytest.raises(UserError, match=r"simulator\.effects.*input_lag"):
        make_simulator(load_case(path), path.parent)


def robot(vary, root, found):
    """The robot's poses after the same two commands, with effects on them."""
    model = {"simulator.urdf": str(root / "configs/models/turtlebot.urdf"), "simulator.effects": found}
    path = vary("turtlebot", {**model, "simulator.substeps": 100, "simulator.poses": 20})
    simulator = make_simulator(load_case(path), path.parent)
    simulator.reset(np.zeros(3))
    poses = np.array([simulator.advance(np.array(u)) for u in ([0.2, 0.0], [0.1, 0.0])])
    simulator.close()
    return poses


def test_the_robot_acts_out_effects_on_its_commands(vary, root):
    def on(name, target, **parameters):
        return [{"name": name, "on": target, "parameters": parameters}]

    plain = robot(vary, root, [])
    late = robot(vary, root, on("input_delay", "v", delay=0.4))
    assert plain[0, 0] - late[0, 0] == pytest.approx(0.4 * 0.2, abs=0.01)  # 0.4 s at rest instead of at 0.2 m/s
    assert plain[1, 0] - late[1, 0] == pytest.approx(0.4 * 0.1, abs=0.01)  # of which the second command gives half back
    halved = robot(vary, root, on("input_gain", "v", ratio=0.5))
    assert halved[1, 0] == pytest.approx(0.5 * plain[1, 0], rel=0.05)
    uneven = robot(vary, root, on("wheel_mismatch", "plant", ratio=1.05))
    assert uneven[1, 2] == pytest.approx(0.05 * 0.3 / 0.23, rel=0.15)  # the right wheel goes 5 % farther over 0.3 m
    slowed = robot(vary, root, on("rolling_resistance", "plant", loss=0.05))
    assert plain[0, 0] - slowed[0, 0] == pytest.approx(0.05, abs=0.005)
    assert plain[1, 0] - slowed[1, 0] == pytest.approx(0.1, abs=0.01)
    with pytest.raises(UserError, match=r"simulator\.effects.*lateral_slip"):
        robot(vary, root, on("lateral_slip", "plant", ratio=0.05))
