"""Gaps with known answers, and a bare PyBullet pendulum that shares no code with the package's simulators."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager

import numpy as np

from simgap.config.gap import GapSection, LipschitzSection
from simgap.gap.bases import Monomials
from simgap.geometry import Box, Grid
from tests.gap.fit_in_memory import GapSamples

X = Box([-0.2, -0.5], [0.2, 0.5])
U = np.linspace(-1.2, 1.2, 5)[:, None]
PAPER = ("x1^2", "x2^2", "x1*x2", "x1", "x2", "u", "1")


def gap_section(basis=None, **options):
    """A case's section `gap`; options of its part `lipschitz` are given by their names alone."""
    own = {k: options.pop(k) for k in list(options) if k in LipschitzSection.model_fields}
    return GapSection(basis=basis or Monomials(), lipschitz=own, **options)


def smooth(x, u):
    """Smooth, not in the span of the paper's basis."""
    d2 = -0.012 * np.sin(x[..., 0]) + 0.004 * u[..., 0] - 3e-4 * x[..., 1] ** 3
    return np.stack([0.005 * d2, d2], axis=-1)


def coulomb(x, u, jump=6e-4):
    """The smooth one with dry friction: a jump of 2 * jump at x2 = 0."""
    d = smooth(x, u)
    step = jump * np.sign(x[..., 1])
    return d - np.stack([0.005 * step, step], axis=-1)


def on_grid(function, eps=0.011, box=X, inputs=U, **more):
    """Samples of a gap function of (x, u) on the covering grid."""
    grid = Grid.covering(box, eps)
    x = np.broadcast_to(grid.centres()[:, None, :], (grid.size, len(inputs), box.size))
    d = function(x, inputs[None].repeat(grid.size, 0))
    return GapSamples(grid, inputs, np.ascontiguousarray(d), ("x1", "x2"), ("u",), **more)


def off_grid(function, n=20_000, seed=11, box=X, inputs=U):
    """Random states and inputs with their gap."""
    rng = np.random.default_rng(seed)
    x, u = box.sample(rng, n), inputs[rng.integers(0, len(inputs), n)]
    return x, u, function(x, u)


@contextmanager
def quiet_stdout():
    """Engines print on the file descriptor, past sys.stdout."""
    sys.stdout.flush()
    kept, null = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(null)


def pendulum_gap(urdf, inertia_from_file, tau=0.005):
    """d(x, u) of PyBullet against the paper's explicit Euler pendulum, one step from rest of everything hidden."""
    import pybullet as p

    def gap(x, u):
        flat_x, flat_u = x.reshape(-1, 2), u.reshape(-1)
        out = np.empty_like(flat_x)
        with quiet_stdout():
            client = p.connect(p.DIRECT)
            p.setGravity(0, 0, -9.81, physicsClientId=client)
            p.setTimeStep(tau, physicsClientId=client)
            flags = p.URDF_USE_INERTIA_FROM_FILE if inertia_from_file else 0
            body = p.loadURDF(str(urdf), useFixedBase=True, flags=flags, physicsClientId=client)
            p.setJointMotorControl2(body, 0, p.VELOCITY_CONTROL, force=0, physicsClientId=client)
            for k, (state, torque) in enumerate(zip(flat_x, flat_u, strict=True)):
                p.resetJointState(body, 0, state[0], state[1], physicsClientId=client)
                p.setJointMotorControl2(body, 0, p.TORQUE_CONTROL, force=torque, physicsClientId=client)
                p.stepSimulation(physicsClientId=client)
                out[k] = p.getJointState(body, 0, physicsClientId=client)[:2]
            p.disconnect(client)
        a, v = flat_x.T
        euler = np.stack([a + tau * v, v - 1.5 * 9.81 * tau * np.sin(a) + 3.0 * tau * flat_u], axis=-1)
        return (out - euler).reshape(x.shape)

    return gap
