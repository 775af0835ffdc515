"""MuJoCo as an independent plant: its linkage for a device file, and the board's wall in its simulation."""

import numpy as np
import pytest

import haptic_bridge as hb

mujoco = pytest.importorskip("mujoco")
pytestmark = pytest.mark.mujoco

ARC_NAMES = ["hapkit-paddle", "upright-hapkit", "two-paddles"]
NAMES = [
    *ARC_NAMES,
    "serial-3r",
    "coupled-five-bar",
    "pantograph-mk2",
    "fictive-five-bar-turret",
    "phantom-premium-1.5",
    "fader",
    "planar-arm",
    "yoke",
    "touch",
    "falcon-like",
]


def place_model(path, q, **options):
    model = mujoco.MjModel.from_xml_string(hb.mjcf.from_device(path, **options))
    data = mujoco.MjData(model)
    for name, angle in hb.mjcf.joint_angles(path, q).items():
        data.joint(name).qpos[0] = angle
    mujoco.mj_forward(model, data)
    return model, data


def reduce_to_joints(model, data, joints):
    """Returns (G, M): the motion of all hinges per motion of the actuated hinges, linkage closed, and the inertia."""
    driven = [model.joint(f"q{joint}").dofadr[0] for joint in range(joints)]
    rest = [dof for dof in range(model.nv) if dof not in driven]
    g = np.zeros((model.nv, joints))
    g[driven, range(joints)] = 1.0
    if rest:
        # The two sites of a constraint move together.
        jacobians = np.zeros((2 * model.neq, 3, model.nv))
        for jacobian, site in zip(jacobians, np.stack([model.eq_obj1id, model.eq_obj2id], axis=1).flat, strict=True):
            mujoco.mj_jacSite(model, data, jacobian, None, site)
        apart = (jacobians[::2] - jacobians[1::2]).reshape(-1, model.nv)
        g[rest] = -np.linalg.lstsq(apart[:, rest], apart[:, driven], rcond=None)[0]
    moved = np.zeros((model.nv, joints))
    for joint in range(joints):
        column = np.zeros(model.nv)
        mujoco.mj_mulM(model, data, column, g[:, joint].copy())
        moved[:, joint] = column
    return g, g.T @ moved


@pytest.mark.parametrize("name", NAMES)
def test_both_models_have_the_same_tip_inertia_and_forces(devices, name):
    path = devices / f"{name}.toml"
    device = hb.Device(path)
    n, d = device.joints, device.task
    rng = np.random.default_rng(3)
    for _ in range(5):
        q = np.asarray(device.home) + rng.uniform(-0.15, 0.15, n)
        model, data = place_model(path, q)
        ours = device.model(q)
        g, mass = reduce_to_joints(model, data, n)
        np.testing.assert_allclose(mass, ours["mass"], rtol=2e-6, atol=1e-6 * np.abs(mass).max())
        if name not in ARC_NAMES:
            np.testing.assert_allclose(data.site("tip").xpos[:d], ours["position"], atol=1e-12)
            jacobian = np.zeros((3, model.nv))
            mujoco.mj_jacSite(model, data, jacobian, None, model.site("tip").id)
            np.testing.assert_allclose(jacobian[:d] @ g, ours["jacobian"], atol=1e-10)
        # Gravity at rest is held by the same torques.
        np.testing.assert_allclose(g.T @ data.qfrc_bias, ours["bias"], atol=1e-8 + 1e-6 * np.abs(ours["bias"]).max())


@pytest.mark.parametrize("name", ["serial-3r", "coupled-five-bar"])
def test_the_board_renders_a_wall_in_mujoco(devices, name):
    """The board's code gets MuJoCo's angles through its encoders, and MuJoCo its torques: 1 N into a wall of 2000 N/m rests
    half a millimetre inside."""
    path = devices / f"{name}.toml"
    device = hb.Device(path)
    period, ramp, steps = 1e-4, 6000, 16000
    model, data = place_model(path, device.home, timestep=period / 2)
    model.dof_frictionloss[:] = 0.0
    normal, stiffness, force = np.array([0.0, -1.0]), 2000.0, 1.0
    surface = data.site("tip").xpos[:2] - 1e-3 * normal
    scene = (
        f"rate_hz = {1 / period}\ncutoff_hz = 300.0\n[[wall]]\npoint = {surface.tolist()}\nnormal = {normal.tolist()}\n"
        f"stiffness = {stiffness}\ndamping = 20.0\nfeed_forward = 'off'\n"
    )
    simulation = hb.Simulation(device, hb.Scene.parse(scene, 2), ideal=True)
    handle = model.site("tip").bodyid[0]
    driven = [model.joint(f"q{joint}").qposadr[0] for joint in range(device.joints)]
    depth = []
    with simulation.board() as board:
        board.arm()
        for step in range(steps):
            data.ctrl[:] = simulation.drive(data.qpos[driven])
            if step < ramp:  # The device is held while the torque ramps up.
                continue
            if step % 100 == 0:
                assert board.look().state == "Armed"
            data.xfrc_applied[handle, :2] = -force * normal
            mujoco.mj_step(model, data, 2)
            depth.append((surface - data.site("tip").xpos[:2]) @ normal)
    rest = np.array(depth[-1000:])
    np.testing.assert_allclose(rest.mean(), force / stiffness, rtol=0.03)
    assert np.ptp(rest) < 1e-4 and max(depth) < 2e-3
