import pathlib

import pytest

import haptic_bridge as hb

DEVICES = pathlib.Path(__file__).parents[2] / "devices"


@pytest.fixture
def devices():
    return DEVICES


@pytest.fixture
def five_bar():
    return hb.Device(DEVICES / "coupled-five-bar.toml")


@pytest.fixture
def vouched():
    """The same, with what a board that asks for what a real one asks needs of a file."""
    text = (DEVICES / "coupled-five-bar.toml").read_text()
    text = text.replace("[joint.motor]\n", "[joint.motor]\nverified = true\n")
    return hb.Device.parse(text.replace("[[joint]]\n", "[[joint]]\nlimits = [-3.14, 3.14]\n"))
