"""The example of a sweep: the same numbers on a cluster as in one process, also when a worker dies."""

import os
import pathlib
import signal
import sys

import numpy as np
import pytest

import haptic_bridge as hb

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.cluster

EXAMPLES = str(pathlib.Path(__file__).parents[1] / "examples")
sys.path.insert(0, EXAMPLES)
import sweep_dask as sweep  # noqa: E402


class Unlucky:
    """A client one of whose workers is killed as soon as everything has been handed out."""

    def __init__(self, client):
        self.client, self.killed = client, None

    def submit(self, *work, **settings):
        return self.client.submit(*work, **settings)

    def gather(self, jobs):
        self.killed, process = next(iter(self.client.run(os.getpid).items()))
        os.kill(process, signal.SIGKILL)
        distributed.wait(jobs, timeout=600)
        return self.client.gather(jobs)


def test_a_sweep_has_the_same_numbers_on_a_cluster_whose_workers_die(devices, monkeypatch):
    # A script's own functions travel to the workers by themselves; those of a module are imported there.
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([EXAMPLES, os.environ.get("PYTHONPATH", "")]))
    text = (devices / "coupled-five-bar.toml").read_text()
    q, normals = sweep.grid(hb.Device.parse(text), points=49, angles=8)
    with sweep.local() as cluster, distributed.Client(cluster) as client:
        unlucky = Unlucky(client)
        found = sweep.on_a_cluster(unlucky, text, q, normals)
        client.wait_for_workers(2, timeout=600)
        assert unlucky.killed not in client.run(os.getpid), "another worker took its place"
    assert len(found) == len(q) > 100
    np.testing.assert_array_equal(found, sweep.on_one_process(text, q, normals))
    assert np.nanmax(found[:, 2]) > 1.2
