"""Model, range and map: shapes, the paper's relations between the numbers, and refused arguments."""

import json
import pickle
import threading
import time

import numpy as np
import pytest

import haptic_bridge as hb

NORMAL = [0.94, -0.34]
RNG = np.random.default_rng(7)


def poses(device, count):
    return np.asarray(device.home) + RNG.uniform(-0.2, 0.2, (count, device.joints))


@pytest.mark.parametrize("name", ["coupled-five-bar", "phantom-premium-1.5", "serial-3r", "fictive-five-bar-turret"])
def test_the_model_of_many_poses_satisfies_the_equations(devices, name):
    device = hb.Device(devices / f"{name}.toml")
    n, d = device.joints, device.task
    q = poses(device, 12).reshape(3, 4, n)
    normal = RNG.normal(size=(3, 4, d))
    model = device.model(q, normal=normal, force=2.0)
    shapes = {"position": (d,), "jacobian": (d, n), "mass": (n, n), "bias": (n,), "torque": (n,), "w_eff": (), "w_aa": (n - 1, n - 1)}
    for key, tail in shapes.items():
        assert model[key].shape == (3, 4, *tail), key
    unit = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    row = np.einsum("abd,abdn->abn", unit, model["jacobian"])
    mobility = np.einsum("abn,abnm,abm->ab", row, np.linalg.inv(model["mass"]), row)
    np.testing.assert_allclose(model["w_eff"], 1 / mobility, rtol=1e-9)
    np.testing.assert_allclose(model["torque_without_feed_forward"], 2.0 * row, rtol=1e-9, atol=1e-12)
    # The Jacobian is the derivative of the position.
    step = 1e-6
    for joint in range(n):
        ahead, behind = q.copy(), q.copy()
        ahead[..., joint] += step
        behind[..., joint] -= step
        slope = (device.model(ahead)["position"] - device.model(behind)["position"]) / (2 * step)
        np.testing.assert_allclose(model["jacobian"][..., joint], slope, atol=1e-7)
    one = device.model(q[1, 2], normal=normal[1, 2], force=2.0)
    for key, value in one.items():
        np.testing.assert_array_equal(value, model[key][1, 2], err_msg=key)


def test_single_precision_is_close_to_double(five_bar):
    q = poses(five_bar, 5)
    exact, board = five_bar.model(q, normal=NORMAL), five_bar.model(q, normal=NORMAL, precision="f32")
    assert not np.array_equal(exact["mass"], board["mass"])
    np.testing.assert_allclose(board["mass"], exact["mass"], rtol=2e-6)


def test_range_has_the_paper_s_ratio_for_one_and_many_poses(five_bar):
    q = poses(five_bar, 4)
    found = five_bar.range(q, NORMAL, undamped=True, kd=[0.5, 1.0, 2.0], washout_hz=2.0)
    assert found["off"]["kp"].shape == (4, 3) and found["washout"]["area"].shape == (4,)
    np.testing.assert_array_equal(found["off"]["kd"], np.tile([0.5, 1.0, 2.0], (4, 1)))
    np.testing.assert_allclose(found["area_ratio"], (found["w_rr"] / found["w_eff"]) ** 2, rtol=1e-6)
    alone = five_bar.range(q[2], NORMAL, undamped=True, kd=[0.5, 1.0, 2.0], washout_hz=2.0)
    np.testing.assert_array_equal(alone["full"]["kp"], found["full"]["kp"][2])


def test_a_wall_rendered_by_a_computer_is_softer(five_bar):
    found = five_bar.range(five_bar.home, NORMAL, rate_hz=20000, cutoff_hz=500, host_rate_hz=1000)
    assert found["host"]["area"] < 0.03 * found["off"]["area"]


def test_the_map_equals_the_model_at_its_poses(five_bar):
    found = five_bar.map(NORMAL, points=300)
    assert len(found["q"]) > 50
    model = five_bar.model(found["q"], normal=NORMAL)
    np.testing.assert_allclose(found["w_rr"], model["w_rr"], rtol=1e-9)
    np.testing.assert_allclose(found["position"], model["position"], atol=1e-12)
    assert found["eigenvectors"].shape == (len(found["q"]), 2, 2)


def test_poses_may_have_any_memory_layout(five_bar):
    q = poses(five_bar, 6)
    expected = five_bar.model(q)["mass"]
    shifted = np.frombuffer(b"x" + q.tobytes(), dtype=np.uint8)[1:].view(np.float64).reshape(q.shape)
    assert not shifted.flags.aligned
    strided = np.repeat(q, 2, axis=0)[::2]
    for same in (shifted, strided, np.asfortranarray(q), q.tolist()):
        np.testing.assert_array_equal(five_bar.model(same)["mass"], expected)


def test_singular_poses_raise_or_become_nan(devices):
    arm = hb.Device(devices / "serial-3r.toml")
    q = [[0.6, 0.9, -0.7], [0.0, 0.0, 0.0]]
    with pytest.raises(hb.ImpossibleError, match="pose 1: serial singularity"):
        arm.model(q)
    model = arm.model(q, singular="nan")
    assert np.isfinite(model["mass"][0]).all() and np.isnan(model["mass"][1]).all()
    with pytest.raises(hb.ImpossibleError, match="singular"):
        arm.range(q[1], [1, 0])
    found = arm.range(q, [1, 0], kd=[1.0], singular="nan")
    assert np.isnan(found["off"]["kp"][1]).all() and found["off"]["kp"][0] > 0


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda d: d.model([0.1]), "q has the shape"),
        (lambda d: d.model([0.1, np.nan]), "finite"),
        (lambda d: d.model([[2.3, 0.8]] * 2, qd=[[0, 0]] * 3), "one for each pose"),
        (lambda d: d.model([2.3, 0.8], precision="f16"), "choose among f64, f32"),
        (lambda d: d.range([2.3, 0.8], [0, 0]), "normal"),
        (lambda d: d.range([2.3, 0.8], NORMAL, cutoff_hz=500), "cutoff of 500 Hz is impossible"),
        (lambda d: d.range([2.3, 0.8], NORMAL, kd=[-1.0]), "damping"),
        (lambda d: d.range([2.3, 0.8], NORMAL, host_delay_s=0.1), "host_rate_hz"),
        (lambda d: d.map([1, 0, 0]), "2 entries"),
        (lambda d: hb.Device.parse("name = 3"), "device.toml"),
        (lambda d: hb.Device("no-such.toml"), "no-such.toml"),
    ],
)
def test_wrong_arguments_are_refused_without_command_options(five_bar, call, words):
    with pytest.raises(hb.RequestError, match=words) as error:
        call(five_bar)
    assert "--" not in str(error.value)


def test_the_lock_is_released_while_poses_are_computed(five_bar):
    """Checks that another thread runs meanwhile, which it could not with the lock held."""
    q = np.tile(five_bar.home, (24, 1))
    ticks, busy = 0, threading.Event()

    def compute():
        five_bar.range(q, NORMAL)
        busy.set()

    thread = threading.Thread(target=compute)
    thread.start()
    while not busy.is_set():
        ticks += 1
        time.sleep(0.001)
    thread.join()
    assert ticks > 20


def test_the_range_equals_the_independent_reference(devices):
    cases = json.loads((devices.parent / "tests/golden/range.json").read_text())["cases"]
    for case in cases[::20]:
        device = hb.Device.parse(case["device"])
        expected = case["expect"]
        kd = [point["kd"] for point in expected["off"]["boundary"]]
        settings = dict(rate_hz=case["rate"], cutoff_hz=case["cutoff"], delay=case["delay"])
        found = device.range(case["q"], case["normal"], kd=kd, **settings)
        kp = [point["kp"] for point in expected["off"]["boundary"]]
        np.testing.assert_allclose(found["off"]["kp"], kp, rtol=1e-4, err_msg=case["id"])
        np.testing.assert_allclose(found["full"]["area"], expected["full"]["area"], rtol=1e-4, err_msg=case["id"])


def test_a_device_is_pickled_with_its_file(five_bar):
    copy = pickle.loads(pickle.dumps(five_bar))
    q = poses(five_bar, 3)
    np.testing.assert_array_equal(copy.model(q)["mass"], five_bar.model(q)["mass"])


@pytest.mark.parametrize(
    "call",
    [
        lambda device: device.range(np.tile(device.home, (1_000_000, 1)), NORMAL),  # takes a quarter of an hour
        lambda device: device.map(NORMAL, points=4_000_000),
        lambda device: hb.Simulation(device).run(1e6),
        lambda device: hb.Simulation(device).board().rows(1e6),
    ],
)
def test_ctrl_c_ends_a_call(five_bar, ctrl_c, call):
    ctrl_c(lambda: call(five_bar))


@pytest.mark.parametrize("count, waits", [(1, False), (64, False), (65, True)])
def test_the_model_of_a_few_poses_is_computed_in_the_caller(five_bar, count, waits):
    """Counts how often the caller yields its processor, which it does only to wait for another thread."""
    resource = pytest.importorskip("resource")
    q = np.tile(five_bar.home, (count, 1))
    before = resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw
    for _ in range(100):
        five_bar.model(q, normal=NORMAL)
    assert (resource.getrusage(resource.RUSAGE_THREAD).ru_nvcsw - before > 50) == waits


def test_a_posture_applies_only_to_a_redundant_arm(devices, five_bar):
    arm = hb.Device(devices / "serial-3r.toml")
    loop = {"rate_hz": 20000, "cutoff_hz": 500, "kd": [8.0]}
    plain = arm.range(arm.home, [0.42, -0.91], **loop)
    held = arm.range(arm.home, [0.42, -0.91], posture=(0.5, 0.03), **loop)
    assert plain["off"]["kp"][0] != held["off"]["kp"][0]
    with pytest.raises(hb.RequestError, match="one posture"):
        five_bar.range(five_bar.home, NORMAL, posture=(0.5, 0.03))
