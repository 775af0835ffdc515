import _thread
import faulthandler
import pathlib
import signal
import threading

import pytest

import haptic_bridge as hb

DEVICES = pathlib.Path(__file__).parents[3] / "devices"


@pytest.fixture
def devices():
    return DEVICES


@pytest.fixture
def five_bar():
    return hb.Device(DEVICES / "coupled-five-bar.toml")


@pytest.fixture
def strict_five_bar():
    """The five-bar with verified motors and joint limits, which a strict board requires."""
    text = (DEVICES / "coupled-five-bar.toml").read_text()
    text = text.replace("[joint.motor]\n", "[joint.motor]\nverified = true\n")
    return hb.Device.parse(text.replace("[[joint]]\n", "[[joint]]\nlimits = [-3.14, 3.14]\n"))


@pytest.fixture
def ctrl_c():
    """Interrupts a call as Ctrl-C does, even if the parent process ignores Ctrl-C. A call that does not end aborts the tests."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    faulthandler.dump_traceback_later(120, exit=True)

    def pressed_during(call):
        threading.Timer(0.2, _thread.interrupt_main).start()
        with pytest.raises(KeyboardInterrupt):
            call()

    yield pressed_during
    faulthandler.cancel_dump_traceback_later()
    signal.signal(signal.SIGINT, before)
