"""One number of threads for every library that would otherwise take all cores in every worker."""

from __future__ import annotations

import os
import sys


def environment(threads: int) -> dict[str, str]:
    """Variables to set before the libraries are imported."""
    n = str(threads)
    names = (
        "OMP_NUM_THREADS",
        "MKL_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "OPENCV_FOR_THREADS_NUM",
        "OPENIMAGEIO_THREADS",
    )
    return {**dict.fromkeys(names, n), "ZARR_ASYNC__CONCURRENCY": "4", "ZARR_THREADING__MAX_WORKERS": "4"}


def allocator() -> dict[str, str]:
    """Variables that make glibc keep what was freed, to set before a worker process is spawned.

    Kernels allocate and free pictures all the time. Dask's own setting gives memory back above 64 KiB at once, and a
    run then spends nearly as much time in page faults as in computing.
    """
    return {"MALLOC_TRIM_THRESHOLD_": str(2**28), "MALLOC_MMAP_THRESHOLD_": str(2**25)}


def limit(threads: int) -> None:
    """Limit the libraries that are imported already, and those that will be through the environment."""
    variables = environment(threads)
    if numba := sys.modules.get("numba"):
        # It reads its variable anew whenever it compiles, and refuses another number once its threads run. No kernel of
        # ours uses them.
        variables["NUMBA_NUM_THREADS"] = str(numba.config.NUMBA_NUM_THREADS)
    os.environ.update(variables)
    if torch := sys.modules.get("torch"):
        torch.set_num_threads(threads)
    if cv2 := sys.modules.get("cv2"):
        cv2.setNumThreads(threads)
    if oiio := sys.modules.get("OpenImageIO"):
        oiio.attribute("threads", threads)
        oiio.attribute("exr_threads", threads)
