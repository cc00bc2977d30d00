"""The local cluster: one number of threads for every library in every worker, and rendering without a GPU said aloud."""

from __future__ import annotations

from dags.cluster import DaskBackend, start_local


def thread_counts() -> dict[str, int]:
    """What each library would use in this worker, as it is set before any task ran."""
    import cv2
    import numba
    import OpenImageIO
    import torch
    import zarr

    return {
        "torch": torch.get_num_threads(),
        "cv2": cv2.getNumThreads(),
        "numba": numba.config.NUMBA_NUM_THREADS,
        "OpenImageIO": OpenImageIO.get_int_attribute("threads"),
        "zarr": zarr.config.get("threading.max_workers"),
        "zarr async": zarr.config.get("async.concurrency"),
    }


def test_every_worker_limits_the_threads_of_every_library() -> None:
    from distributed import Client

    with start_local(workers=2, cpus=1) as cluster, Client(cluster, set_as_default=False) as client:
        client.wait_for_workers(2, timeout=60)
        found = client.run(thread_counts)
    assert len(found) == 2
    for counts in found.values():
        assert counts == {"torch": 1, "cv2": 1, "numba": 1, "OpenImageIO": 1, "zarr": 4, "zarr async": 4}


def test_without_a_gpu_rendering_falls_to_the_cpu_workers_with_a_sentence() -> None:
    backend = DaskBackend(workers=1, window=3)
    try:
        assert any("no worker has a GPU: rendering runs on the CPU workers" in s for s in backend.sentences)
        assert backend.free(gpu=True) == backend.free(gpu=False) == 3
    finally:
        backend.close()
