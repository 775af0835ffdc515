"""Measured ranges on simulated boards: compared with the prediction, interrupted, continued, refused."""

import _thread
import signal
import threading

import numpy as np
import pytest

import haptic_bridge as hb

POSE, NORMAL = [2.6, 1.75], [0.94, -0.34]
# Settings with which the tip comes to rest before every trial, despite friction and encoder steps.
GENTLE = {"rate_hz": 1000.0, "cutoff_hz": 20.0, "kd": [15.0], "feed_forward": "off", "pull_m": 2e-3}


def test_measurement_and_prediction_agree_on_an_ideal_device(five_bar):
    found = hb.measure_range(
        five_bar, NORMAL, q=POSE, kd=[15.0, 4.0], repeats=2, friction="none", ideal_drive=True, counts=2**23, pull_m=1e-4
    )
    np.testing.assert_allclose(found["q"], POSE, atol=1e-5)
    assert found["loop"]["drive"] == "ideal" and found["loop"]["undamped"]
    # Measured deviations: below 0.2 % without the feed-forward, and 1.8 to 2.7 % too low with it.
    for mode, tolerance in [("off", 0.005), ("full", 0.03)]:
        measured = found[mode]
        np.testing.assert_array_equal(measured["kd"], [4.0, 15.0])
        assert measured["repeats"].shape == (2, 2) and measured["why"] == [None, None]
        assert (measured["low"] <= measured["kp"]).all() and (measured["kp"] <= measured["high"]).all()
        predicted = five_bar.range(POSE, NORMAL, kd=measured["kd"], **found["loop"])[mode]["kp"]
        np.testing.assert_allclose(measured["kp"], predicted, rtol=tolerance)
    assert (found["full"]["kp"] > 1.05 * found["off"]["kp"]).all()


def test_ctrl_c_turns_the_motors_off_and_other_threads_run(five_bar):
    # Sets the handler, because a background job of a shell ignores Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    simulation = hb.Simulation(five_bar)
    ticks, over = [0], threading.Event()

    def count():
        while not over.wait(0.002):
            ticks[0] += 1

    counter, timer = threading.Thread(target=count), threading.Timer(0.4, _thread.interrupt_main)
    counter.start()
    timer.start()
    try:
        with simulation.board() as board:
            with pytest.raises(KeyboardInterrupt):
                hb.measure_range(five_bar, [0.6, 0.8], board=board, **GENTLE | {"kd": None}, repeats=100)
            assert board.state == "Disarmed"
    finally:
        over.set()
        timer.cancel()
        counter.join()
        signal.signal(signal.SIGINT, before)
    assert ticks[0] > 20


def test_progress_is_kept_and_the_scene_is_restored(five_bar, tmp_path):
    scene = hb.Scene.parse("[[wall]]\npoint = [0.0, 0.2]\nnormal = [0.0, -1.0]\nstiffness = 1000.0\ndamping = 4.0\n", 2)
    simulation = hb.Simulation(five_bar, scene)
    progress_file = tmp_path / "progress.json"
    calls = []

    def once(done, of):
        calls.append((done, of))
        raise ZeroDivisionError

    with simulation.board() as board:
        with pytest.raises(ZeroDivisionError):
            hb.measure_range(five_bar, [0.6, 0.8], board=board, repeats=2, progress=progress_file, told=once, **GENTLE)
        assert calls == [(1, 2)] and board.state == "Disarmed"
        board.set_gains(0, 900.0, 4.0)
        again = []
        found = hb.measure_range(
            five_bar, [0.6, 0.8], board=board, repeats=2, progress=progress_file, told=lambda *count: again.append(count), **GENTLE
        )
        assert again == [(1, 2), (2, 2)] and found["off"]["repeats"].shape == (1, 2)
        assert "full" not in found and 1e3 < found["off"]["kp"][0] < 1e5
        with pytest.raises(hb.RequestError, match="there is no wall 1"):
            board.set_gains(1, 900.0, 4.0)
        with pytest.raises(hb.RequestError, match="holds another measurement"):
            hb.measure_range(five_bar, [0.0, 1.0], board=board, progress=progress_file, **GENTLE)


@pytest.mark.parametrize(
    ("normal", "more", "words"),
    [
        ([0.0, 0.0], {}, "finite and not zero"),
        ([1.0, 0.0, 0.0], {}, "last dimension must be 2"),
        (np.eye(2)[[0, 1, 0, 1, 0, 1, 0, 1]], {}, "needs further walls"),
        (NORMAL, {"feed_forward": "half"}, "choose among both, all"),
        (NORMAL, {"pull_m": 0.1}, "at most 0.005"),
        (NORMAL, {"kd": [-1.0]}, "not negative"),
        (NORMAL, {"repeats": 0}, "repeats 1 to 100"),
        (NORMAL, {"q": [1.0]}, "2 finite angles"),
        (NORMAL, {"share": [1.0, 1.0]}, "1 positive number"),
        (NORMAL, {"no_feed_forward": [0]}, "must leave a wall"),
    ],
)
def test_invalid_arguments_are_refused(five_bar, normal, more, words):
    with pytest.raises(hb.RequestError, match=words):
        hb.measure_range(five_bar, normal, **more)


def test_impossible_measurements_and_other_devices_are_reported(five_bar, devices):
    with pytest.raises(hb.ImpossibleError, match="the motors are too weak for these encoders"):
        hb.measure_range(five_bar, [0.0, 1.0], rate_hz=20000, cutoff_hz=500)
    with hb.Simulation(hb.Device(devices / "haply-2diy.toml")).board() as board:
        with pytest.raises(hb.ImpossibleError, match="the board holds haply-2diy, the file is coupled-five-bar"):
            hb.measure_range(five_bar, NORMAL, board=board)
        with pytest.raises(hb.RequestError, match="change a simulation"):
            hb.measure_range(five_bar, NORMAL, board=board, grip=True)
    with hb.Simulation(five_bar, strict=True).board() as board, pytest.raises(hb.RequestError, match="agree with yes=True"):
        hb.measure_range(five_bar, NORMAL, board=board)
