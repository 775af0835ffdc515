"""Converts a device file to a MuJoCo model, independently of the board's code, so that the two can be compared."""

import math
import os
import tomllib
from collections.abc import Sequence
from typing import Any

__all__ = ["from_device", "joint_angles"]

Z = "0 0 1"


def from_device(path: str | os.PathLike[str], *, timestep: float = 5e-5) -> str:
    """Returns the MJCF of a device file. The hinges q0, q1, .. are the actuated joints, and the site `tip` is the tip.

    Each actuated joint has a motor actuator with gear 1 (N m). Joint friction is included; transmissions, limits and
    motors are not. Slightly compliant constraints close a closed linkage. `joint_angles` returns the angles of its
    passive hinges. A delta's platform is carried by three slides along the base's axes, and one body with two hinges
    stands for a pair of rods.
    """
    with open(path, "rb") as file:
        device = tomllib.load(file)
    build = {
        "paddle": _paddle,
        "serial-3r": _serial,
        "five-bar": _five_bar,
        "five-bar-turret": _five_bar_turret,
        "parallelogram": _parallelogram,
        "paddles": _paddles,
        "chain": _chain,
        "delta": _delta,
    }[device["mechanism"]]
    bodies, equality = build(device)
    gravity = (list(device.get("gravity", [])) + [0.0, 0.0, 0.0])[:3]
    count = len(device["joint"])
    motors = "".join(f'<motor joint="q{joint}" gear="1"/>' for joint in range(count))
    return (
        f'<mujoco model="{device["name"]}"><compiler angle="radian" inertiafromgeom="false"/>'
        f'<option timestep="{timestep}" gravity="{_numbers(*gravity)}" integrator="implicitfast">'
        '<flag contact="disable"/></option>'
        f"<worldbody>{bodies}</worldbody>"
        f"<equality>{equality}</equality><actuator>{motors}</actuator></mujoco>"
    )


def joint_angles(path: str | os.PathLike[str], q: Any) -> dict[str, float]:
    """Returns the angle of every hinge (rad) and the travel of every slide (m) of `from_device` with the actuated joints at q."""
    with open(path, "rb") as file:
        device = tomllib.load(file)
    q = [float(angle) for angle in q]
    angles = {f"q{joint}": angle for joint, angle in enumerate(q)}
    kind = device["mechanism"]
    if kind == "parallelogram":
        # The angles are absolute, the crank points along -(cos q2, sin q2), and opposite links are parallel.
        angles["fore"] = q[2] - q[1]
        angles["coupler"] = q[1] - q[2] - math.pi
    if kind in ("five-bar", "five-bar-turret"):
        # Computes the tip, left or right of the line from C to D, and from it the distal angles.
        one, two = q[-2:]
        geometry = device["geometry"]
        half = geometry["base"] / 2
        c = (-half + geometry["proximal"][0] * math.cos(one), geometry["proximal"][0] * math.sin(one))
        d = (half + geometry["proximal"][1] * math.cos(two), geometry["proximal"][1] * math.sin(two))
        across = math.hypot(d[0] - c[0], d[1] - c[1])
        a, b = geometry["distal"]
        along = (across**2 + a**2 - b**2) / (2 * across)
        height = geometry["assembly"] * math.sqrt(a**2 - along**2)
        e = ((d[0] - c[0]) / across, (d[1] - c[1]) / across)
        tip = (c[0] + along * e[0] - height * e[1], c[1] + along * e[1] + height * e[0])
        angles["distal0"] = math.atan2(tip[1] - c[1], tip[0] - c[0]) - one
        angles["distal1"] = math.atan2(tip[1] - d[1], tip[0] - d[0]) - two
    if kind == "delta":
        geometry = device["geometry"]
        azimuths = _azimuths(device)
        place = _delta_tip(geometry, azimuths, q)
        angles |= dict(zip(("x", "y", "z"), place, strict=True))
        for index, (azimuth, angle) in enumerate(zip(azimuths, q, strict=True)):
            # The rod in the frame of the leg, whose y axis is across the leg.
            cosine, sine = math.cos(azimuth), math.sin(azimuth)
            reach = geometry["base"] + geometry["upper"] * math.cos(angle)
            out = cosine * place[0] + sine * place[1] + geometry["platform"] - reach
            up = place[2] - geometry["upper"] * math.sin(angle)
            angles[f"rod{index}"] = math.atan2(up, out) - angle
            angles[f"lean{index}"] = math.asin((cosine * place[1] - sine * place[0]) / geometry["fore"])
    return angles


def _azimuths(device: dict[str, Any]) -> list[float]:
    return [float(angle) for angle in device["geometry"].get("azimuth", [0.0, 2 * math.pi / 3, 4 * math.pi / 3])]


def _delta_tip(geometry: dict[str, Any], azimuths: list[float], q: list[float]) -> list[float]:
    """Returns the tip of a delta (m), which is at a rod's length from three centres."""
    centres = []
    for azimuth, angle in zip(azimuths, q, strict=True):
        out = geometry["base"] - geometry["platform"] + geometry["upper"] * math.cos(angle)
        centres.append((out * math.cos(azimuth), out * math.sin(azimuth), geometry["upper"] * math.sin(angle)))
    one, two = ([far - near for far, near in zip(centre, centres[0], strict=True)] for centre in centres[1:])
    normal = _cross(one, two)
    area = _dot(normal, normal)
    mixed = [b * _dot(one, one) - a * _dot(two, two) for a, b in zip(one, two, strict=True)]
    centre = [value / (2 * area) for value in _cross(mixed, normal)]
    height = geometry.get("assembly", 1) * math.sqrt((geometry["fore"] ** 2 - _dot(centre, centre)) / area)
    return [p + c + height * n for p, c, n in zip(centres[0], centre, normal, strict=True)]


def _cross(a: Sequence[float], b: Sequence[float]) -> list[float]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _dot(a: Sequence[float], b: Sequence[float]) -> float:
    return sum(x * y for x, y in zip(a, b, strict=True))


def _numbers(*values: float) -> str:
    return " ".join(repr(float(value)) for value in values)


def _hinge(name: str, axis: str, joint: dict[str, Any] | None) -> str:
    friction = ""
    if joint is not None:
        friction = (
            f' armature="{float(joint["inertia"])!r}" damping="{float(joint.get("viscous", 0.0))!r}"'
            f' frictionloss="{float(joint.get("coulomb", 0.0))!r}"'
        )
    kind = "slide" if joint is not None and joint.get("type") == "prismatic" else "hinge"
    return f'<joint name="{name}" type="{kind}" axis="{axis}"{friction}/>'


def _inertial(link: dict[str, float]) -> str:
    normal = link["inertia"]
    # MuJoCo requires inertia about every axis of a body, although only the normal axis matters in a plane.
    axial = link.get("inertia_axial", 0.0) or 1e-3 * normal
    across = link.get("inertia_transverse", normal)
    return f'<inertial pos="{_numbers(link["com"], 0, 0)}" mass="{link["mass"]!r}" diaginertia="{_numbers(axial, across, normal)}"/>'


def _handle(device: dict[str, Any]) -> str:
    mass = device.get("handle", {}).get("mass", 0.0)
    body = f'<inertial pos="0 0 0" mass="{mass!r}" diaginertia="1e-15 1e-15 1e-15"/>' if mass else ""
    return body + '<site name="tip"/>'


def _body(name: str, at: float, content: str) -> str:
    return f'<body name="{name}" pos="{_numbers(at, 0, 0)}">{content}</body>'


def _paddle(device: dict[str, Any]) -> tuple[str, str]:
    joint = _hinge("q0", Z, device["joint"][0])
    empty = '<inertial pos="0 0 0" mass="1e-12" diaginertia="1e-15 1e-15 1e-15"/>'
    own = _inertial(device["link"][0]) if "link" in device else empty
    handle = _body("handle", device["geometry"]["length"], _handle(device))
    return _body("paddle", 0.0, joint + own + handle), ""


def _paddles(device: dict[str, Any]) -> tuple[str, str]:
    bodies = ""
    for index, (length, joint) in enumerate(zip(device["geometry"]["lengths"], device["joint"], strict=True)):
        one = {"joint": [joint], "geometry": {"length": length}} | (
            {"link": [device["link"][index]]} if "link" in device else {}
        )
        body, _ = _paddle(one)
        for name in ("q0", "paddle", "handle", "tip"):
            body = body.replace(f'name="{name}"', f'name="{name if index == 0 else f"{name}-{index}"}"')
        bodies += body.replace(f'name="q0-{index}"', f'name="q{index}"')
    return bodies, ""


def _chain(device: dict[str, Any]) -> tuple[str, str]:
    joints, links = device["joint"], device["link"]
    inner = f'<body name="handle" pos="{_numbers(*device["geometry"]["tip"])}">{_handle(device)}</body>'
    for index in reversed(range(len(joints))):
        joint, link = joints[index], links[index]
        hinge = _hinge(f"q{index}", _numbers(*joint.get("axis", [0.0, 0.0, 1.0])), joint)
        inertial = (
            f'<inertial pos="{_numbers(*link["com"])}" mass="{link["mass"]!r}" fullinertia="{_numbers(*link["inertia"])}"/>'
        )
        origin, (roll, pitch, yaw) = joint.get("origin", [0.0] * 3), joint.get("rpy", [0.0] * 3)
        # Half angles of the rotation Rz(yaw) Ry(pitch) Rx(roll).
        (sr, cr), (sp, cp), (sy, cy) = ((math.sin(a / 2), math.cos(a / 2)) for a in (roll, pitch, yaw))
        turned = _numbers(
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        )
        place = f'pos="{_numbers(*origin)}" quat="{turned}"'
        inner = f'<body name="link{index}" {place}>{hinge}{inertial}{inner}</body>'
    return inner, ""


def _delta(device: dict[str, Any]) -> tuple[str, str]:
    geometry, (arm, rod, platform) = device["geometry"], device["link"]
    upper, fore = geometry["upper"], geometry["fore"]
    mass = 2 * rod["mass"]
    across = mass * fore**2 / 12
    # MuJoCo requires some inertia about a slender rod's own axis.
    pair = (
        f'<inertial pos="{_numbers(fore / 2, 0, 0)}" mass="{mass!r}" diaginertia="{_numbers(1e-6 * across, across, across)}"/>'
    )
    own = f'<inertial pos="{_numbers(arm["com"], 0, 0)}" mass="{arm["mass"]!r}" diaginertia="{_numbers(*[arm["inertia"]] * 3)}"/>'
    bodies, ends, equality = "", "", ""
    for index, azimuth in enumerate(_azimuths(device)):
        hinges = _hinge(f"rod{index}", "0 -1 0", None) + _hinge(f"lean{index}", Z, None)
        rods = _body(f"rods{index}", upper, f'{hinges}{pair}<site name="end{index}" pos="{_numbers(fore, 0, 0)}"/>')
        leg = _body(f"arm{index}", geometry["base"], _hinge(f"q{index}", "0 -1 0", device["joint"][index]) + own + rods)
        bodies += f'<body name="leg{index}" euler="0 0 {azimuth!r}">{leg}</body>'
        end = _numbers(geometry["platform"] * math.cos(azimuth), geometry["platform"] * math.sin(azimuth), 0)
        ends += f'<site name="platform{index}" pos="{end}"/>'
        equality += (
            f'<connect site1="platform{index}" site2="end{index}" solref="0.0002 1" solimp="0.99999 0.99999 1e-6"/>'
        )
    slides = "".join(
        f'<joint name="{name}" type="slide" axis="{axis}"/>' for name, axis in (("x", "1 0 0"), ("y", "0 1 0"), ("z", Z))
    )
    total = platform["mass"] + device.get("handle", {}).get("mass", 0.0)
    point = f'<inertial pos="0 0 0" mass="{total!r}" diaginertia="1e-15 1e-15 1e-15"/>'
    return f'{bodies}<body name="platform">{slides}{point}{ends}<site name="tip"/></body>', equality


def _serial(device: dict[str, Any]) -> tuple[str, str]:
    lengths = device["geometry"]["lengths"]
    inner = _body("handle", lengths[2], _handle(device))
    for index in (2, 1, 0):
        content = _hinge(f"q{index}", Z, device["joint"][index]) + _inertial(device["link"][index]) + inner
        inner = _body(f"link{index}", lengths[index - 1] if index else 0.0, content)
    return inner, ""


def _closed(device: dict[str, Any], first: int) -> tuple[str, str]:
    geometry, links, joints = device["geometry"], device["link"], device["joint"]
    arms = ""
    for side, at in ((0, -geometry["base"] / 2), (1, geometry["base"] / 2)):
        end = _body("handle", geometry["distal"][0], _handle(device)) if side == 0 else ""
        distal = _hinge(f"distal{side}", Z, None) + _inertial(links[2 + side]) + end
        if side == 1:
            distal += f'<site name="end" pos="{_numbers(geometry["distal"][1], 0, 0)}"/>'
        distal = _body(f"distal{side}", geometry["proximal"][side], distal)
        content = _hinge(f"q{first + side}", Z, joints[first + side]) + _inertial(links[side]) + distal
        arms += _body(f"proximal{side}", at, content)
    return arms, '<connect site1="tip" site2="end" solref="0.0002 1" solimp="0.99999 0.99999 1e-6"/>'


def _five_bar(device: dict[str, Any]) -> tuple[str, str]:
    return _closed(device, 0)


def _turret(device: dict[str, Any], axis: str, content: str) -> str:
    empty = '<inertial pos="0 0 0" mass="1e-12" diaginertia="1e-15 1e-15 1e-15"/>'
    return _body("turret", 0.0, _hinge("q0", axis, device["joint"][0]) + empty + content)


def _five_bar_turret(device: dict[str, Any]) -> tuple[str, str]:
    arms, equality = _closed(device, 1)
    return _turret(device, "1 0 0", arms), equality


def _parallelogram(device: dict[str, Any]) -> tuple[str, str]:
    geometry, joints = device["geometry"], device["joint"]
    upper, fore, crank, coupler = device["link"]
    # The forearm extends behind the elbow by the length of the crank, and the coupler is as long as the upper arm.
    forearm = _hinge("fore", Z, None) + _inertial(fore) + _body("handle", geometry["fore"], _handle(device))
    forearm += f'<site name="rear" pos="{_numbers(-geometry["crank"], 0, 0)}"/>'
    first = _hinge("q1", Z, joints[1]) + _inertial(upper) + _body("forearm", geometry["upper"], forearm)
    rod = _hinge("coupler", Z, None) + _inertial(coupler)
    rod += f'<site name="end" pos="{_numbers(geometry["upper"], 0, 0)}"/>'
    # The crank points opposite to the forearm, whose angle is the angle of joint 2.
    second = _hinge("q2", Z, joints[2]) + _inertial(crank) + _body("rod", geometry["crank"], rod)
    arms = _body("upper", 0.0, first)
    arms += f'<body name="crank" euler="0 0 {math.pi!r}">{second}</body>'
    equality = '<connect site1="rear" site2="end" solref="0.0002 1" solimp="0.99999 0.99999 1e-6"/>'
    return _turret(device, "0 1 0", arms), equality
