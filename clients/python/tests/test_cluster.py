"""The sweep example computes the same numbers on a cluster as in one process, even if a worker dies."""

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


class KillingClient:
    """A client that kills one of its workers after all jobs were submitted."""

    def __init__(self, client):
        self.client, self.killed = client, None

    def submit(self, *work, **settings):
        return self.client.submit(*work, **settings)

    def gather(self, jobs):
        self.killed, process = next(iter(self.client.run(os.getpid).items()))
        os.kill(process, signal.SIGKILL)
        distributed.wait(jobs, timeout=600)
        return self.client.gather(jobs)


def test_a_sweep_has_the_same_numbers_although_a_worker_dies(devices, monkeypatch):
    # The workers import the functions of the module `sweep_dask`, so they need its path.
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([EXAMPLES, os.environ.get("PYTHONPATH", "")]))
    text = (devices / "coupled-five-bar.toml").read_text()
    q, normals = sweep.grid(hb.Device.parse(text), points=49, angles=8)
    with sweep.local() as cluster, distributed.Client(cluster) as client:
        killing_client = KillingClient(client)
        found = sweep.on_a_cluster(killing_client, text, q, normals)
        client.wait_for_workers(2, timeout=600)
        assert killing_client.killed not in client.run(os.getpid), "another worker took its place"
    assert len(found) == len(q) > 100
    np.testing.assert_array_equal(found, sweep.on_one_process(text, q, normals))
    assert np.nanmax(found[:, 2]) > 1.2
