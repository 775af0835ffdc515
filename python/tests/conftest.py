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
