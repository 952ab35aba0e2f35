"""What each kind of record of `drive_library.py` hides, on which plants, and what of it acts as one."""

from __future__ import annotations

from collections.abc import Callable

import drive_parts as parts
import numpy as np
from drive_parts import Draw, Told, Truth

ROBOTS = ("robot", "robot without heading")
Part = Callable[[str, Draw], Told]
ROBOT_KINDS: dict[str, tuple[Part, ...]] = {
    "rolling resistance": (parts.rolling,),
    "rolling resistance, speed gain": (parts.rolling, parts.speed_gain),
    "rolling resistance, speed bias": (parts.rolling, parts.speed_bias),
    "speed bias": (parts.speed_bias,),
}
KINDS: dict[str, tuple[Part, ...]] = {
    "nothing": (),
    "viscous friction": (parts.viscous,),
    "saturation": (parts.saturation,),
    "saturation, viscous friction": (parts.saturation, parts.viscous),
    "gain": (parts.gain,),
    "torque-speed limit": (parts.limit,),
    "torque-speed limit, viscous friction": (parts.limit, parts.viscous),
    "torque-speed limit, gain": (parts.limit, parts.gain),
    "sensor gain": (parts.sensor,),
    "sensor gain, viscous friction": (parts.sensor, parts.viscous),
    "sensor gain, gain": (parts.sensor, parts.gain),
    "slow actuator": (parts.slow_actuator,),
    "slow sensor": (parts.slow_sensor,),
    "slow sensor, viscous friction": (parts.slow_sensor, parts.viscous),
    "dead zone": (parts.dead,),
    "gain curve": (parts.curve,),
    "gain curve, viscous friction": (parts.curve, parts.viscous),
    "gain curve, dead zone": (parts.curve, parts.dead),
    "Dahl friction": (parts.dahl,),
    "LuGre friction": (parts.bristles,),
    "LuGre friction, viscous friction": (parts.bristles, parts.viscous),
    "dry friction": (parts.dry,),
    "elastic joint": (parts.soft,),
    "elastic joint, viscous friction": (parts.soft, parts.viscous),
    "elastic joint, gain": (parts.soft, parts.gain),
    "elastic joint, slow actuator": (parts.soft, parts.slow_actuator),
    "elastic joint, encoder on the motor": (parts.soft, parts.behind_spring),
    "backlash": (parts.play,),
    "backlash, rebound": (parts.bouncing,),
    "backlash, viscous friction": (parts.play, parts.viscous),
    "backlash, gain": (parts.play, parts.gain),
    "backlash, dead zone": (parts.play, parts.dead),
    "backlash, dry friction": (parts.play, parts.dry),
    "backlash, encoder on the motor": (parts.play, parts.behind),
}


KINDS |= ROBOT_KINDS
ONLY_NAMED = ("elasticity_behind_encoder",)
ASIDE: dict[Part, tuple[str, ...]] = {
    parts.soft: (), parts.play: (), parts.bouncing: (), parts.bristles: ("dahl_friction", "lugre_friction"),
    parts.behind_spring: ONLY_NAMED,
}  # fmt: skip
UNNAMED = ", nothing named"
KINDS |= {kind + UNNAMED: KINDS[kind] for kind in ("elastic joint", "backlash", "backlash, viscous friction")}

TURNING = ("arm", "motor")
PLACED_KINDS: dict[str, tuple[tuple[Part, ...], tuple[str, ...]]] = {
    "directional friction": ((parts.directional,), ("arm", "motor", "slide")),
    "directional friction, viscous friction": ((parts.directional, parts.viscous), TURNING),
    "directional friction, bias": ((parts.directional, parts.bias), TURNING),
    "directional friction, gain": ((parts.directional, parts.gain), TURNING),
    "load friction": ((parts.load,), ("arm", "motor", "slide")),
    "load friction, viscous friction": ((parts.load, parts.viscous), TURNING),
    "load friction, dry friction": ((parts.load, parts.dry), TURNING),
    "load friction, gain": ((parts.load, parts.gain), TURNING),
    "reflected inertia": ((parts.rotor,), ("arm", "motor", "oscillator", "rod", "two_link")),
    "reflected inertia, viscous friction": ((parts.rotor, parts.viscous), ("arm", "oscillator")),
    "reflected inertia, gain": ((parts.rotor, parts.gain), ("arm", "oscillator")),
    "directional gain": ((parts.two_gains,), TURNING),
    "directional gain, viscous friction": ((parts.two_gains, parts.viscous), TURNING),
    "directional gain, bias": ((parts.two_gains, parts.bias), TURNING),
    "directional gain, dead zone": ((parts.two_gains, parts.dead), TURNING),
    "constant force": ((parts.push,), ("arm", "motor", "rod", "cart_pole", "cart_pole_urdf")),
    "constant force, viscous friction": ((parts.push, parts.viscous), ("cart_pole", "cart_pole_urdf")),
    "constant force, bias": ((parts.push, parts.bias), TURNING),
    "constant force, dry friction": ((parts.push, parts.dry), TURNING),
    "constant force, dead zone": ((parts.push, parts.dead), TURNING),
    "constant force, tilt": ((parts.push, parts.tilt), ("rod",)),
    "tilt": ((parts.tilt,), ("rod",)),
    "payload": ((parts.weight,), ("rod", "two_link")),
    "payload, viscous friction": ((parts.weight, parts.viscous), ("rod", "two_link")),
    "payload, reflected inertia": ((parts.weight, parts.rotor), ("rod", "two_link")),
    "payload, heavier link": ((parts.weight, parts.heavier), ("two_link",)),
    "late sensor": ((parts.late_sensor,), TURNING),
    "late sensor, viscous friction": ((parts.late_sensor, parts.viscous), TURNING),
    "late sensor, late command": ((parts.late_sensor, parts.late_command), TURNING),
    "late sensor, slow actuator": ((parts.late_sensor, parts.slow_actuator), TURNING),
}
KINDS |= {kind: hidden for kind, (hidden, _) in PLACED_KINDS.items()}
PLACED = {kind: plants for kind, (_, plants) in PLACED_KINDS.items()} | dict.fromkeys(ROBOT_KINDS, ROBOTS)
"""Kinds that are made on plants of their own, whichever are asked for."""


def hidden(plant: str, kind: str, seed: int) -> tuple[dict[str, float], Truth]:
    """What the rig is told, and the effects that are to be found with their numbers."""
    rng = np.random.default_rng([seed, *kind.encode(), *plant.encode()])
    told: dict[str, float] = {}
    truth: Truth = {}
    for part in KINDS[kind]:
        numbers, names = part(plant, lambda: float(rng.uniform(0.8, 1.25)))
        told, truth = told | numbers, truth | names
    return told, as_one(plant, truth)


def as_one(plant: str, truth: Truth) -> Truth:
    """What is hidden, in the words in which data can tell it: of two that act as one the one that both make."""
    truth = dict(truth)
    if {"encoder on the motor", "joint_elasticity"} <= set(truth):
        truth.pop("encoder on the motor")
        truth["elasticity_behind_encoder"] = truth.pop("joint_elasticity")
    if "filtered_reading" in truth and plant != "arm":  # linear, read by one sensor: named by its actuator
        truth["input_lag"] = {"T": truth.pop("filtered_reading")["lag"]}
    if {"sensor_gain", "input_gain"} <= set(truth) and plant != "arm":  # linear, read by one sensor
        truth["input_gain"] = {"ratio": truth["input_gain"]["ratio"] * truth.pop("sensor_gain")["ratio"]}
    if {"directional_friction", "input_bias"} <= set(truth):
        levels, level = truth["directional_friction"], truth.pop("input_bias")["bias"]
        truth["directional_friction"] = {"F_p": levels["F_p"] - level, "F_m": levels["F_m"] + level}
    if {"constant_force", "input_bias"} <= set(truth):
        truth["input_bias"] = {"bias": truth["input_bias"]["bias"] + truth.pop("constant_force")["F_0"]}
    if {"late_reading", "input_delay"} <= set(truth):
        truth["input_delay"] = {"delay": truth["input_delay"]["delay"] + truth.pop("late_reading")["late"]}
    if {"payload", "reflected_inertia"} <= set(truth) and plant == "rod":  # one joint: a moment and an inertia
        m, r = truth["payload"].values()
        turned = m * r**2 + truth.pop("reflected_inertia")["I"]
        truth["payload"] = {"m_p": (m * r) ** 2 / turned, "r": turned / (m * r)}
    return truth
