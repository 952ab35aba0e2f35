"""What drives and sensors do, as a rig is told it and as the library names it, with sizes that are drawn."""

from __future__ import annotations

import math
from collections.abc import Callable

from tests.undeclared.joints import JOINTS

# sizes that each plant can show: largest command, a typical speed, a viscous friction; the heavy slide hardly moves
SCALES = {
    "arm": (3.0, 4.0, 0.06), "motor": (3.0, 4.0, 0.06), "slide": (3.0, 1.5, 0.2), "oscillator": (3.0, 2.0, 0.15),
    "rod": (3.0, 3.0, 0.1), "two_link": (1.2, 3.0, 0.03), "cart_pole": (1.8, 2.0, 0.02),
    "cart_pole_urdf": (1.0, 1.0, 0.02),
}  # fmt: skip
Truth = dict[str, dict[str, float]]
Draw = Callable[[], float]
Told = tuple[dict[str, float], Truth]


def limit(plant: str, draw: Draw) -> Told:
    """A torque-speed line that the largest commands reach."""
    top, speed, _ = SCALES[plant]
    stall = 0.8 * draw() * top
    fall = 0.5 * draw() * stall / speed
    return {"stall": stall, "fall": fall}, {"torque_speed_limit": {"T_s": stall, "k": fall}}


def viscous(plant: str, draw: Draw) -> Told:
    """Friction in proportion to the speed."""
    b = SCALES[plant][2] * draw()
    return {"viscous": b}, {"viscous_friction": {"b": b}}


def saturation(plant: str, draw: Draw) -> Told:
    """A limit at about half of the largest command."""
    limit = 0.55 * draw() * SCALES[plant][0]
    return {"limit": limit}, {"input_saturation": {"limit": limit}}


def gain(plant: str, draw: Draw) -> Told:
    """A drive that is weaker than declared, by about an eighth."""
    ratio = 1.0 - 0.12 * draw()
    return {"ratio_p": ratio, "ratio_m": ratio}, {"input_gain": {"ratio": ratio}}


def curve(plant: str, draw: Draw) -> Told:
    """Iron that saturates, half again above the largest command."""
    return {"soft": 1.3 * draw() * SCALES[plant][0]}, {"input_curve": {}}  # a tanh is none of its curves


def sensor(plant: str, draw: Draw) -> Told:
    """A sensor that reads about a twentieth too much."""
    ratio = 1.0 + 0.05 * draw()
    return {"sensor": ratio}, {"sensor_gain": {"ratio": ratio}}


def slow_actuator(plant: str, draw: Draw) -> Told:
    """A lag of about 20 ms of the drive."""
    lag = 0.02 * draw()
    return {"act": lag}, {"input_lag": {"T": lag}}


def slow_sensor(plant: str, draw: Draw) -> Told:
    """A lag of about 20 ms of the reading."""
    lag = 0.02 * draw()
    return {"sense": lag}, {"filtered_reading": {"lag": lag}}


def dead(plant: str, draw: Draw) -> Told:
    """A dead zone of about a sixteenth of the largest command."""
    width = 0.06 * draw() * SCALES[plant][0]
    return {"dead": width}, {"input_dead_zone": {"width": width}}


def soft(plant: str, draw: Draw) -> Told:
    """A motor of about a tenth of the link's inertia on a spring: a resonance at about 8 Hz, damped by about 8 %."""
    link = JOINTS[plant][0]
    motor = 0.1 * draw() ** 2 * link
    stiff = (2.0 * math.pi * 8.0 * draw() ** 2) ** 2 * motor / (1.0 + motor / link)
    damper = 2.0 * 0.08 * draw() * math.sqrt(stiff * motor)
    told = {"motor": motor, "stiff": stiff, "soft_c": damper}
    return told, {"joint_elasticity": {"I": motor, "k": stiff, "c": damper}}


def play(plant: str, draw: Draw) -> Told:
    """A gap that a third of the largest command crosses in about 25 ms; stiff stops, half critically damped."""
    top = SCALES[plant][0]
    motor = 0.08 * draw() ** 2 * JOINTS[plant][0]
    gap = top / 3.0 * (0.025 * draw()) ** 2 / (2.0 * motor)
    quick = 600.0 * draw()
    told = {"motor": motor, "gap": gap, "stiff": motor * quick**2, "soft_c": 2.0 * 0.5 * draw() * motor * quick}
    return told, {"backlash": {"b": gap, "I": motor}}


def bouncing(plant: str, draw: Draw) -> Told:
    """The same gap between stops that give back 0.6 to 0.8 of the speed."""
    told, truth = play(plant, draw)
    return told | {"soft_c": 0.22 * draw() * math.sqrt(told["stiff"] * told["motor"])}, truth


def behind(plant: str, draw: Draw) -> Told:
    """The encoder on the motor, and play behind it, which no effect of the library is."""
    return {"behind": 1.0}, {"encoder on the motor": {}}


def behind_spring(plant: str, draw: Draw) -> Told:
    """The encoder on the motor, and a spring behind it."""
    return behind(plant, draw)


def dahl(plant: str, draw: Draw) -> Told:
    """Dry friction that builds up over a hundredth of the way that a second takes."""
    force, way = 0.04 * draw() * SCALES[plant][0], 0.01 * draw() * SCALES[plant][1]
    return {"F_c": force, "d": way}, {"dahl_friction": {"F_c": force, "d": way}}


def bristles(plant: str, draw: Draw) -> Told:
    """A breakaway force of 1.6 times the sliding one, told apart by speeds of a few hundredths of the typical one."""
    told, _ = dahl(plant, draw)
    rise, slow = 0.6 * draw(), 0.08 * draw() * SCALES[plant][1]
    force = told["F_c"]
    truth = {"lugre_friction": {"F_c": force, "d": told["d"], "rise": rise, "v_s": slow}}
    return told | {"F_s": (1.0 + rise) * force, "v_s": slow}, truth


def dry(plant: str, draw: Draw) -> Told:
    """Coulomb friction of about a twenty-fifth of the largest command."""
    force = 0.04 * draw() * SCALES[plant][0]
    return {"F_p": force, "F_m": force}, {"coulomb_friction": {"F_c": force}}


def rolling(plant: str, draw: Draw) -> Told:
    """Speed that the wheels lose to their resistance, m/s."""
    loss = 0.02 * draw()
    return {"rolling": loss}, {"rolling_resistance": {"loss": loss}}


def speed_gain(plant: str, draw: Draw) -> Told:
    """A robot that drives a tenth slower than it is told."""
    ratio = 1.0 - 0.1 * draw()
    return {"speed_gain": ratio}, {"input_gain": {"ratio": ratio}}


def speed_bias(plant: str, draw: Draw) -> Told:
    """A robot that drives 0.02 m/s faster than it is told."""
    bias = 0.02 * draw()
    return {"speed_bias": bias}, {"input_bias": {"bias": bias}}


def directional(plant: str, draw: Draw) -> Told:
    """Friction that is twice as large forwards as backwards."""
    forwards, backwards = (share * draw() * SCALES[plant][0] for share in (0.05, 0.025))
    return {"F_p": forwards, "F_m": backwards}, {"directional_friction": {"F_p": forwards, "F_m": backwards}}


def load(plant: str, draw: Draw) -> Told:
    """A tenth of the drive's force, lost to friction."""
    share = 0.1 * draw()
    return {"mu": share}, {"load_friction": {"mu": share}}


def rotor(plant: str, draw: Draw) -> Told:
    """An eighth of what the drive moves."""
    link = {"rod": 1.0 / 3.0, "two_link": 0.084, **{n: numbers[0] for n, numbers in JOINTS.items()}}[plant]
    inertia = 0.12 * draw() * link
    return {"armature" if plant == "two_link" else "I": inertia}, {"reflected_inertia": {"I": inertia}}


def two_gains(plant: str, draw: Draw) -> Told:
    """A drive that is stronger forwards and weaker backwards."""
    up, down = 1.0 + 0.06 * draw(), 1.0 - 0.1 * draw()
    return {"ratio_p": up, "ratio_m": down}, {"input_directional_gain": {"ratio_p": up, "ratio_m": down}}


def bias(plant: str, draw: Draw) -> Told:
    """A fiftieth of the largest command, added to all of them."""
    level = 0.02 * draw() * SCALES[plant][0]
    return {"bias": level}, {"input_bias": {"bias": level}}


def push(plant: str, draw: Draw) -> Told:
    """A force that is always there: on the joint that the drive moves, or on the pole that no drive moves."""
    force = 0.04 * draw() * SCALES[plant][0]
    return {"push": force}, {"constant_force": {"F_0": force}}


def tilt(plant: str, draw: Draw) -> Told:
    """A base that leans by about 0.03 rad."""
    angle = 0.03 * draw()
    return {"tilt": angle}, {"gravity_tilt": {"tilt": angle}}


def weight(plant: str, draw: Draw) -> Told:
    """A point mass on the link: somewhere on the rod, at the tip of the second of two."""
    mass, place = 0.15 * draw(), 0.6 if plant == "two_link" else 0.8 * draw()
    return {"payload": mass, "place": place}, {"payload": {"m_p": mass, "r": place}}


def heavier(plant: str, draw: Draw) -> Told:
    """The second of two links, a tenth heavier than declared, its inertia too."""
    ratio = 1.0 + 0.1 * draw()
    return {"m2": ratio}, {"parameter_error": {"ratio": ratio}}


def late_command(plant: str, draw: Draw) -> Told:
    """Commands that act about 10 ms later."""
    delay = 0.01 * draw()
    return {"wait": delay}, {"input_delay": {"delay": delay}}


def late_sensor(plant: str, draw: Draw) -> Told:
    """Readings of what was about 12 ms before."""
    delay = 0.012 * draw()
    return {"late": delay}, {"late_reading": {"late": delay}}
