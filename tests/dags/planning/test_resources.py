"""Workers of this machine: who sees which device, and how many share one."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from posegaussian.dags.config.settings import RunSettings
from posegaussian.dags.planning import resources
from posegaussian.dags.planning.resources import CPU, GPU, cpu_workers, gpu_workers, local_pools


def machine(monkeypatch: pytest.MonkeyPatch, cores: int, devices: list[str], memory: int | None) -> None:
    """With so many cores, and devices of so many MiB."""
    monkeypatch.setattr(resources.os, "cpu_count", lambda: cores)
    monkeypatch.setattr(resources, "visible_gpus", lambda: devices)
    monkeypatch.setattr(resources, "device_memory", lambda device: memory)


@pytest.mark.parametrize(
    ("cores", "devices", "memory", "seen"),
    [
        (16, ["0"], 80_000, ["0"] * 4),
        (64, ["0"], 80_000, ["0"] * 4),
        (8, ["0"], 80_000, ["0"] * 2),
        (16, ["0"], 24_000, ["0"] * 2),
        (2, ["0"], 80_000, ["0"]),
        (16, ["0"], 16_384, ["0"] * 2),
        (16, ["0"], 6_000, ["0"]),
        (16, ["0"], None, ["0"]),
        (16, ["2", "3"], 80_000, ["2", "3", "2", "3"]),
        (16, [], None, []),
    ],
)
def test_as_many_share_a_device_as_cores_and_its_memory_allow(
    cores: int, devices: list[str], memory: int | None, seen: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of the devices are seen, and a core each goes from the CPU workers to who shares one."""
    machine(monkeypatch, cores, devices, memory)
    assert list(gpu_workers(RunSettings()).values()) == seen
    assert cpu_workers(RunSettings()) == cores - (len(seen) - len(devices))
    pools = local_pools(RunSettings())
    assert (pools[GPU].workers if seen else 0) == len(seen)
    assert cpu_workers(RunSettings(workers=7)) == 7


def test_so_many_as_are_asked_for_share_devices_or_stand_in_for_one(monkeypatch: pytest.MonkeyPatch) -> None:
    machine(monkeypatch, 4, ["0", "1"], 1_000)
    assert gpu_workers(RunSettings(gpus=3)) == {"gpu-0": "0", "gpu-1": "1", "gpu-2": "0"}
    assert gpu_workers(RunSettings(gpus=0)) == {}
    machine(monkeypatch, 4, [], None)
    assert gpu_workers(RunSettings(gpus=2)) == {"gpu-0": "", "gpu-1": ""}
    assert local_pools(RunSettings(gpus=2))[CPU].workers == 4


def test_cores_are_never_all_given_away(monkeypatch: pytest.MonkeyPatch) -> None:
    machine(monkeypatch, 2, ["0"], 80_000)
    assert cpu_workers(RunSettings(gpus=8)) == 1


@pytest.mark.parametrize(("threads", "sharing"), [(2, 2), (4, 1), (16, 1)])
def test_tasks_of_several_threads_leave_fewer_to_share_a_device(
    threads: int, sharing: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine(monkeypatch, 16, ["0"], 80_000)
    run = RunSettings(threads=threads)
    assert len(gpu_workers(run)) == sharing
    assert cpu_workers(run) == 16 // threads - (sharing - 1)


@pytest.mark.parametrize(("told", "memory"), [("81559\n", 81559), ("[N/A]\n", None), ("", None), (None, None)])
def test_memory_is_what_the_driver_tells(told: str | None, memory: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resources, "_nvidia_smi", lambda *words: told)
    assert resources.device_memory("0") == memory


def test_the_driver_is_asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many plans there are: each asks for a process."""
    asked = []

    def run(words: list[str], **how: object) -> SimpleNamespace:
        asked.append(words)
        return SimpleNamespace(stdout="0\n1\n", returncode=0)

    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    monkeypatch.setattr(resources.shutil, "which", lambda name: name)
    monkeypatch.setattr(resources.subprocess, "run", run)
    resources._nvidia_smi.cache_clear()
    assert [resources.visible_gpus() for _ in range(3)] == [["0", "1"]] * 3
    assert len(asked) == 1
    resources._nvidia_smi.cache_clear()


@pytest.mark.parametrize(
    ("hidden", "seen"),
    [("-1", []), ("", []), ("0, 1", ["0", "1"]), ("1,-1,0", ["1"]), ("GPU-8a,MIG-b", ["GPU-8a", "MIG-b"])],
)
def test_no_device_from_the_first_negative_one_on_is_seen(
    hidden: str, seen: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As CUDA reads it: a worker for a device that nobody sees would fail all its tasks."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", hidden)
    assert resources.visible_gpus() == seen
    assert (GPU in local_pools(RunSettings())) == bool(seen)
