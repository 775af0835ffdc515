"""Boards that are simulated in this process, and a board on a port."""

import gc
import os
import subprocess

import numpy as np
import pytest

import haptic_bridge as hb


def wall(stiffness):
    text = "rate_hz = 10000.0\n[[wall]]\npoint = [0.0, 0.2]\nnormal = [0.0, -1.0]\n"
    return hb.Scene.parse(text + f"stiffness = {stiffness}\ndamping = 4.0\nfeed_forward = 'off'\n", 2)


def armed(simulation):
    board = simulation.board()
    board.arm()
    simulation.run(0.6)
    return board


def test_a_force_moves_the_tip_and_ends_with_its_lease(five_bar):
    simulation = hb.Simulation(five_bar)
    with armed(simulation) as board:
        assert board.state == "Armed"
        start = board.look().tip
        state = board.force([0.5, 0.0])
        assert state.taken and state.done == "taken"
        simulation.run(0.01)
        now = board.look()
        np.testing.assert_array_equal(now.force, [0.5, 0, 0])
        assert now.tip[0] > start[0] and now.share == 1.0 and now.age_s > 0
        simulation.run(0.1)
        assert board.look().age_s is None
    with pytest.raises(hb.LinkError, match="closed"):
        board.look()


@pytest.mark.parametrize("how", ["with", "raise", "close", "drop"])
def test_the_motors_go_off_for_any_end_of_the_board(five_bar, how):
    simulation = hb.Simulation(five_bar)
    board = armed(simulation)
    if how == "with":
        with board:
            pass
    elif how == "raise":
        with pytest.raises(ZeroDivisionError), board:
            1 / 0
    elif how == "close":
        board.close()
    else:
        del board
        gc.collect()
    assert simulation.board().state == "Disarmed"


def test_a_contact_holds_the_tip_with_its_stiffness(five_bar):
    simulation = hb.Simulation(five_bar, friction=False, ideal=True)
    with armed(simulation) as board:
        place = board.look().tip
        contact = (place[:2], [-1.0, 0.0], 2000.0, 20.0)
        for _ in range(600):
            state = board.force([1.0, 0.0], contact=contact)
            simulation.run(0.001)
        np.testing.assert_allclose(state.tip[0] - place[0], 1.0 / 2000.0, rtol=0.05)


def test_encoders_without_motors_turn_the_handle(devices):
    text = (devices / "coupled-five-bar.toml").read_text() + "\n[[sensed]]\ncounts_per_turn = 4000\n"
    simulation = hb.Simulation(hb.Device.parse(text))
    simulation.set_sensed_counts([1000, 0, 0])
    simulation.run(0.001)
    with simulation.board() as board:
        state = board.look()
        np.testing.assert_allclose(state.sensed, [np.pi / 2, 0, 0], atol=1e-6)
        np.testing.assert_allclose(state.rotation @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-6)
        assert "sensed0_rad" in board.start_stream()


def test_a_polarity_check_has_ended_when_it_returns(five_bar):
    with hb.Simulation(five_bar).board() as board:
        board.home()
        board.check_polarity()
        assert board.state == "Disarmed"
        board.arm()
        assert board.state == "Armed"


def test_the_fault_of_a_strict_board_is_read_and_cleared(strict_five_bar):
    simulation = hb.Simulation(strict_five_bar, strict=True)
    with simulation.board() as board:
        board.home()
        board.check_polarity()
        board.set_scene()  # homing and polarity check stay valid
        board.arm()
        for _ in range(4):
            simulation.run(0.4)
            assert board.look().state == "Armed"
        simulation.run(0.6)
        state = board.look()
        assert state.state == "Fault" and state.fault.startswith("HostLost (16): ")
        assert board.fault == state.fault
        board.clear()
        board.arm()
        assert board.look().fault is None
        board.force([0.5, 0.0], hold_s=0.1)
        simulation.run(0.1)
        assert np.abs(board.look().qd).max() > 0


def test_invalid_numbers_and_missing_replies_raise(five_bar):
    with armed(hb.Simulation(five_bar)) as board:
        for force in ([np.nan, 0.0], [2000.0, 0.0], [0.0, np.inf]):
            with pytest.raises(hb.RequestError, match="each entry of the force must be at most 1000 N"):
                board.force(force)
        board.wait_for_forces(0.0)
        with pytest.raises(hb.UnansweredError, match="no reply to a force"):
            board.look()
        board.wait_for_forces(0.1)
        assert board.look().state == "Armed"


def test_a_refusal_raises_with_the_board_s_message(five_bar, devices):
    simulation = hb.Simulation(five_bar, strict=True)
    with simulation.board() as board, pytest.raises(hb.RefusedError, match="the board refuses"):
        board.arm()
    with hb.Simulation(five_bar, wall(1000.0)).board() as board:
        board.set_gains(0, 500.0, 2.0)
        with pytest.raises(hb.RequestError, match="no wall 3"):
            board.set_gains(3, 500.0, 2.0)
        with pytest.raises(hb.RequestError, match="`forse` is no field"):
            board.start_stream("forse")
        assert board.force([1.0, 0.0]).done.startswith("not taken: the motors are off")
    for port in ("", "tcp:nowhere"):
        with pytest.raises(hb.RequestError):
            hb.Board(port)
    with pytest.raises(hb.LinkError, match="cannot connect"):
        hb.Board("tcp:127.0.0.1:1")


def test_a_recording_has_every_step_by_name(five_bar, tmp_path):
    with armed(hb.Simulation(five_bar)) as board:
        recording = board.record(0.1, "tip,torque,state", 10)
        assert recording.columns == ["step", "tip_x_m", "tip_y_m", "torque0_n_m", "torque1_n_m", "state", "contacts"]
        # 0.1 s at 20 kHz, every tenth step, are 200 rows, of which the last rows have not arrived yet.
        assert len(recording) > 180 and recording.data.shape == (len(recording), 7)
        assert set(np.diff(recording["step"])) == {10}
        assert board.losses["missing"] == 0 and (recording["state"] == 1).all()
    with pytest.raises(KeyError, match="no column tip"):
        recording["tip"]
    assert "step" in recording and "tip" not in recording and list(dict(recording)) == recording.columns


def test_recordings_of_the_tool_are_read(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# a device\nstep,force_n,state\n1,0.5,Armed\n2,0.25,Fault\n3,0.1")
    recording = hb.read_recording(path)
    np.testing.assert_array_equal(recording.data, [[1, 0.5, 1], [2, 0.25, 3]])
    assert recording.about == ["a device"] and recording.torn
    with pytest.raises(hb.RequestError, match="line 2"):
        path.write_text("step,force_n\n1\n")
        hb.read_recording(path)
    with pytest.raises(hb.RequestError, match="cannot be read"):
        hb.read_recording(tmp_path / "none.csv")


def test_recordings_of_either_format_are_read(tmp_path):
    tool = os.environ.get("HAPTIC_TOOL")
    if not tool:
        pytest.skip("HAPTIC_TOOL must be the path of `haptic`")
    read = []
    for name in ("a.mcap", "a.csv"):
        order = [tool, "record", name, "--port", "sim", "--seconds", "0.01", "--fields", "tip,state"]
        subprocess.run(order, cwd=tmp_path, check=True, capture_output=True)
        read.append(hb.read_recording(tmp_path / name))
    assert read[0].columns == read[1].columns and len(read[0]) > 100 and not read[0].torn
    assert set(np.diff(read[0]["step"])) == {1} and "time_s" in read[0]


def test_a_wall_holds_a_pressing_hand(five_bar):
    simulation = hb.Simulation(five_bar)
    with simulation.board() as board:
        tip = simulation.tip
        # The wall is in front of the tip, so that the board arms.
        scene = hb.Scene.parse(
            f"[[wall]]\npoint = [0.0, {tip[1] + 0.005}]\nnormal = [0.0, -1.0]\nstiffness = 3000.0\ndamping = 10.0\n", 2
        )
        board.load(five_bar, scene)
        board.arm()
        simulation.run(0.6)
        simulation.hand([(0.0, 0.0, 0.0), (0.3, 0.0, 1.5)], push=True)
        for _ in range(8):
            simulation.run(0.05)
            board.look()
        recording = board.record(0.05, "distance,rendered", 20)
        assert -1e-3 < recording["distance_m"][-1] < 0 and recording["rendered_n"][-1] > 1.0


def test_boards_are_listed():
    assert isinstance(hb.boards(), list)


def test_a_board_on_a_port(five_bar):
    """Uses `haptic sim --tcp` if the tool was built."""
    tool = os.environ.get("HAPTIC_TOOL")
    if not tool:
        pytest.skip("HAPTIC_TOOL must be the path of `haptic`")
    with subprocess.Popen([tool, "sim", "--tcp", "0"], stdout=subprocess.PIPE, text=True) as server:
        try:
            port = server.stdout.readline().split()[-1]
            with hb.Board(port) as board:
                board.load(five_bar)
                board.arm()
                assert board.info["board"] == "simulated" and board.state == "Armed"
            with hb.Board(port) as board:
                assert board.state == "Disarmed"
        finally:
            server.terminate()
