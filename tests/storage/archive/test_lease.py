"""Leases: one holder at a time, ended by time or by a provable death, and never anything to clean up."""

from __future__ import annotations

import json
import os
import pickle
import subprocess
import sys
import threading
import time
from dataclasses import asdict
from pathlib import Path

import pytest

from posegaussian.storage.archive.lease import LENGTH, Holder, Lease, living, read_lease
from posegaussian.storage.model.errors import LeaseHeld, LeaseLost


class Clock:
    """Seconds that pass when told so."""

    def __init__(self) -> None:
        self.now = 1_000_000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "receipts" / "p000001.lease"


def test_a_second_run_is_told_who_holds_it_where_and_since_when(file: Path) -> None:
    with Lease.take(file, "first", "cpu-3"):
        with pytest.raises(
            LeaseHeld, match=rf"run first, worker cpu-3 \(process {os.getpid()} on .*\) since 20.* UTC \(for \d+ s\)"
        ) as error:
            Lease.take(file, "second")
        assert error.value.holder.run == "first"
        again = pickle.loads(pickle.dumps(error.value))
        assert str(again) == str(error.value)
        assert again.holder == error.value.holder, "the error survives the way from a worker to the driver"
    assert not file.exists()
    Lease.take(file, "second").drop()


def test_a_writer_that_slept_past_its_lease_writes_nothing_once_another_took_it(file: Path) -> None:
    clock = Clock()
    sleeper = Lease.take(file, "first", seconds=60, clock=clock)
    sleeper.check()
    clock.now += 59
    with pytest.raises(LeaseHeld):
        Lease.take(file, "second", seconds=60, clock=clock)
    clock.now += 2
    other = Lease.take(file, "second", seconds=60, clock=clock)
    with pytest.raises(LeaseLost, match="was taken over by run second"):
        sleeper.check()
    sleeper.renew()
    other.check()
    sleeper.drop()
    other.check()
    other.drop()
    with pytest.raises(LeaseLost, match="is gone"):
        sleeper.check()


def test_a_writer_that_slept_past_its_lease_goes_on_where_nobody_came(file: Path) -> None:
    clock = Clock()
    lease = Lease.take(file, "first", seconds=60, clock=clock)
    clock.now += 1000
    lease.check()
    with pytest.raises(LeaseHeld):
        Lease.take(file, "second", seconds=60, clock=clock)
    lease.drop()


def test_the_keeper_renews_what_is_held(file: Path) -> None:
    with Lease.take(file, "first", seconds=0.4):
        time.sleep(1.2)
        with pytest.raises(LeaseHeld):
            Lease.take(file, "second")


def dead(file: Path, seconds: float = 3600) -> int:
    """Have a process take the lease and die without a word; returns its pid."""
    code = (
        "import os; from pathlib import Path; from posegaussian.storage.archive.lease import Lease;"
        f" Lease.take(Path({str(file)!r}), 'dead', seconds={seconds}); print(os.getpid(), flush=True); os._exit(9)"
    )
    return int(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False).stdout)


def test_the_lease_of_a_dead_process_is_taken_over_at_once(file: Path) -> None:
    dead(file)
    assert not list(living(file.parent))
    with Lease.take(file, "next") as lease:
        assert [h.run for _, h in living(file.parent)] == ["next"]
        lease.check()


def test_a_dead_process_of_another_host_or_boot_is_waited_for(file: Path) -> None:
    dead(file)
    for change in ({"host": "elsewhere"}, {"boot": "another boot"}):
        holder = {**json.loads(file.read_bytes()), **change}
        file.write_bytes(json.dumps(holder).encode().ljust(LENGTH))
        with pytest.raises(LeaseHeld):
            Lease.take(file, "next")


def from_the_future(file: Path, seconds: float, ahead: float = 7200) -> None:
    """The lease of a machine whose clock is ahead."""
    now = time.time() + ahead
    holder = Holder("0" * 32, "ahead", "main", "elsewhere", "another boot", 7, 1.0, now, now + seconds, "", seconds)
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(json.dumps(asdict(holder)).encode().ljust(LENGTH - 1) + b"\n")


@pytest.mark.parametrize("lives", [False, True])
def test_a_lease_from_the_future_has_ended_when_nobody_renews_it(file: Path, lives: bool) -> None:
    from_the_future(file, 0.4)
    with pytest.raises(LeaseHeld, match=r"run ahead, .* its clock is 7200 s ahead of this one"):
        Lease.take(file, "next")
    for _ in range(3):
        time.sleep(0.2)
        if lives:
            from_the_future(file, 0.4)
    if lives:
        with pytest.raises(LeaseHeld):
            Lease.take(file, "next")
    else:
        Lease.take(file, "next").drop()
        assert list(file.parent.iterdir()) == []


def test_a_lease_whose_clock_is_ahead_by_less_than_it_holds_is_waited_for(file: Path) -> None:
    from_the_future(file, 0.4, ahead=0.3)
    with pytest.raises(LeaseHeld) as held:
        Lease.take(file, "next")
    assert "ahead of" not in str(held.value)
    time.sleep(0.8)
    Lease.take(file, "next").drop()


def test_a_process_number_given_anew_is_another_process(file: Path) -> None:
    lease = Lease.take(file, "first", seconds=3600)
    holder = {**json.loads(file.read_bytes()), "started": lease.holder.started - 100}
    file.write_bytes(json.dumps(holder).encode().ljust(LENGTH))
    Lease.take(file, "second").drop()


def test_a_run_takes_over_from_a_worker_it_lost(file: Path) -> None:
    lost = Lease.take(file, "run", "cpu-0")
    with Lease.take(file, "run", "cpu-1"), pytest.raises(LeaseLost):
        lost.check()


def test_a_lease_that_is_just_being_written_is_held_and_a_torn_one_ends(file: Path) -> None:
    file.parent.mkdir()
    file.write_bytes(b"")
    with pytest.raises(LeaseHeld, match="unknown"):
        Lease.take(file, "second", seconds=60)
    os.utime(file, (time.time() - 61, time.time() - 61))
    Lease.take(file, "second", seconds=60).drop()


def test_last_words_end_a_lease(file: Path) -> None:
    lease = Lease.take(file, "first")
    os.write(lease.last_words(), b"Timeout!\nin the kernel\n")
    lease.renew()
    found = read_lease(file, 60)
    assert found is not None
    assert (found.run, found.ended) == ("first", "Timeout!\nin the kernel\n")
    assert not list(living(file.parent)), "though its process lives"
    Lease.take(file, "second").drop()


def test_of_many_contenders_for_an_ended_lease_one_holds_it_at_a_time(file: Path) -> None:
    """Every contender writes its name under the lease and finds it there a moment later, or learns that it lost."""
    dead(file)
    shared, wins, broken = {"name": ""}, [], []

    def contend(name: str) -> None:
        for _ in range(30):
            try:
                lease = Lease.take(file, name)
            except LeaseHeld:
                continue
            shared["name"] = name
            time.sleep(0.0005)
            if shared["name"] != name:
                broken.append(name)
            lease.drop()
            wins.append(name)

    threads = [threading.Thread(target=contend, args=(f"run{i}",)) for i in range(8)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert not broken
    assert wins
    assert list(file.parent.iterdir()) == [], "nothing is left behind"
