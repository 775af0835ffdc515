"""Haptic devices: model, stable walls, simulated and real boards, as numpy arrays.

>>> import haptic_bridge as hb
>>> device = hb.Device("devices/coupled-five-bar.toml")
>>> device.range([2.6, 1.75], [0.94, -0.34], rate_hz=20000, cutoff_hz=500)["area_ratio"]
>>> with hb.Board("sim") as board:
...     board.load(device)
...     board.arm()
...     board.force([0.5, 0.0])

Exceptions are HapticError and its subclasses, with the messages of the `haptic` tool. SI units everywhere, angles in rad.
`mjcf` converts a device file to a MuJoCo model.
"""

from . import mjcf
from ._native import (
    Board,
    Device,
    HapticError,
    ImpossibleError,
    LinkError,
    Recording,
    RefusedError,
    RequestError,
    Scene,
    Simulation,
    State,
    UnansweredError,
    __version__,
    boards,
    measure_range,
    read_recording,
)

__all__ = [
    "Board",
    "Device",
    "HapticError",
    "ImpossibleError",
    "LinkError",
    "Recording",
    "RefusedError",
    "RequestError",
    "Scene",
    "Simulation",
    "State",
    "UnansweredError",
    "__version__",
    "boards",
    "measure_range",
    "mjcf",
    "read_recording",
]
