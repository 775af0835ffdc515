"""Computes the increase of the stable area of walls by the feed-forward, over poses and normals, on one or more computers.

    python sweep_dask.py devices/coupled-five-bar.toml                   # on two processes of this computer
    python sweep_dask.py devices/coupled-five-bar.toml tcp://HOST:8786   # on a running cluster

The work is distributed in chunks of poses. Another worker repeats the chunk of a killed worker with the same result, because
a chunk depends only on its arguments.
"""

import sys
from contextlib import nullcontext

import numpy as np

import haptic_bridge as hb

CHUNK = 16


def grid(device, points, angles):
    """Returns poses (M A, N) of the reachable workspace, and normals (M A, 2) in all directions at each pose."""
    q = device.map([1.0, 0.0], points=points)["q"]
    around = np.linspace(0.0, np.pi, angles, endpoint=False)
    normals = np.stack([np.cos(around), np.sin(around)], axis=-1)
    return np.repeat(q, angles, axis=0), np.tile(normals, (len(q), 1))


def chunk(device_text, q, normals):
    """Returns (n, 3): Weff, Wrr and the ratio of the areas. Runs on a worker, which needs haptic_bridge but no files."""
    device = hb.Device.parse(device_text)
    found = device.range(q, normals, rate_hz=20_000, cutoff_hz=500, delay=0.5, kd=[], singular="nan")
    return np.stack([found["w_eff"], found["w_rr"], found["area_ratio"]], axis=-1)


def chunks(q, normals):
    return [(q[i : i + CHUNK], normals[i : i + CHUNK]) for i in range(0, len(q), CHUNK)]


def on_one_process(device_text, q, normals):
    return np.concatenate([chunk(device_text, *arguments) for arguments in chunks(q, normals)])


def on_a_cluster(client, device_text, q, normals):
    jobs = [client.submit(chunk, device_text, *arguments, pure=False, retries=3) for arguments in chunks(q, normals)]
    return np.concatenate(client.gather(jobs))


def local():
    from distributed import LocalCluster

    return LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None)


def main(path, address=None):
    from distributed import Client

    with open(path) as file:
        text = file.read()
    q, normals = grid(hb.Device.parse(text), points=100, angles=12)
    # Closes only the local cluster.
    with (nullcontext(address) if address else local()) as cluster, Client(cluster) as client:
        found = on_a_cluster(client, text, q, normals)
    median, most = np.nanquantile(found[:, 2], [0.5, 0.9])
    print(f"{len(q)} walls: with the feed-forward the stable area is {median:.3f} times as large at the median,")
    print(f"and {most:.3f} times or more at a tenth of them")


if __name__ == "__main__":
    main(*sys.argv[1:])
